# aero-bayes: `make` does everything, `make help` lists the rest.
# BLAS threads would fight the simulation workers for the cores.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# Python keeps what it has compiled of the modules that are used, a third of those that are installed; else each process
# compiles them anew.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
RUN    := $(BIN)/aero-bayes

MODEL   ?= $(if $(CONFIG),,Aero.Systems.OneDof)
SEED    ?= 1
WORKERS ?=
DATA    ?=
TEST    ?=
OUT     ?=
CONFIG  ?=
RESUME  ?=
AIM     ?=
DURATION ?=
AMPLIFIER ?=
TRAVEL  ?=

OPTIONS = $(if $(MODEL),--model $(MODEL)) --seed $(SEED) $(if $(WORKERS),--workers $(WORKERS)) \
          $(if $(CONFIG),--config $(CONFIG)) $(if $(RESUME),--resume)
SIMULATED := reports/simulated

.DEFAULT_GOAL := all
.PHONY: all help setup fleet fmu fit posterior loop design report check test test-all test-fast test-long test-platforms test-arm test-coverage lint size bench rig-trial fault-trial real-rigs real-trial coverage coverage-wrong results trust docs dist lock clean

all: setup $(if $(DATA),,$(SIMULATED)/simulated.json) ## Modelica -> FMU -> PSO -> local search -> MCMC -> closed loop -> reports/report.html
	$(RUN) all $(foreach f,$(or $(DATA),$(SIMULATED)/train_1.csv $(SIMULATED)/train_2.csv),--data $(f)) \
	  $(foreach f,$(or $(TEST),$(if $(DATA),,$(SIMULATED)/test_1.csv)),--test $(f)) --out $(or $(OUT),reports) $(OPTIONS)
	@echo "Open the page in a browser: file://$(abspath $(or $(OUT),reports))/report.html"

help: ## what each target does
	@grep -hE '^[a-z -]+:.*##' $(MAKEFILE_LIST) | sort | sed -E 's/:.*## /\t/' | expand -t 16
	@echo; echo "variables: DATA=\"a.csv b.csv\" TEST=c.csv OUT=dir MODEL=Aero.Systems.HalfQuad SEED=1 WORKERS=2 CONFIG=x.toml RESUME=1"

setup: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml requirements.lock $(wildcard src/aero_bayes/simulation/native/*.[ch])
	.ci/install $(PYTHON) $(VENV)
	touch $@
	@$(BIN)/python -c 'import arviz' > /dev/null 2>&1 & # the last import is compiled beside the first simulations

$(VENV)/.tested: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[fleet,test]'
	touch $@

fmu: setup ## build the FMU of MODEL (by default Aero.Systems.OneDof) into OUT
	$(RUN) fmu --model $(MODEL) --out $(or $(OUT),reports/$(lastword $(subst ., ,$(MODEL))).fmu)

$(SIMULATED)/simulated.json: | setup
	$(BIN)/python studies/simulate_aero.py --out $(SIMULATED) --seed $(SEED)

fit posterior: setup $(if $(DATA),,$(SIMULATED)/simulated.json) ## fit, or fit and sample, DATA (default: simulated) into OUT
	$(RUN) $@ $(foreach f,$(or $(DATA),$(SIMULATED)/train_1.csv $(SIMULATED)/train_2.csv),--data $(f)) --out $(or $(OUT),reports/$@) $(OPTIONS)

loop: setup $(if $(DATA),,$(SIMULATED)/simulated.json) ## close the loop on DATA, judged on TEST or a held-out part
	$(RUN) close-loop $(foreach f,$(or $(DATA),$(SIMULATED)/train_1.csv $(SIMULATED)/train_2.csv),--train $(f)) \
	  $(foreach f,$(or $(TEST),$(if $(DATA),,$(SIMULATED)/test_1.csv)),--test $(f)) --out $(or $(OUT),reports/loop) $(OPTIONS)

design: setup $(if $(DATA),,$(SIMULATED)/simulated.json) ## the next experiment: for AIM="D_p K_sp"
	$(RUN) design $(foreach f,$(or $(DATA),$(SIMULATED)/train_1.csv),--data $(f)) --out $(or $(OUT),reports/design) $(OPTIONS) \
	  $(foreach p,$(AIM),--aim $(p)) \
	  $(if $(DURATION),--duration $(DURATION)) $(if $(AMPLIFIER),--amplifier $(AMPLIFIER)) $(foreach t,$(TRAVEL),--travel $(t))

report: setup ## draw the page of OUT again
	$(RUN) report $(or $(OUT),reports)

check: setup ## read, check and summarise DATA
	$(RUN) check $(DATA) $(if $(MODEL),--model $(MODEL)) $(if $(CONFIG),--config $(CONFIG))

test: $(VENV)/.tested ## set up and run the tests
	$(BIN)/python -m pytest -n 2 -m "not long" --durations 10 --junitxml reports/tests.xml

test-long: $(VENV)/.tested ## the studies' tests, and longer tests of what shorter ones test
	$(BIN)/python -m pytest -n 2 -m long --durations 10 --junitxml reports/tests_long.xml

test-all: test test-long ## all tests

test-fast: $(VENV)/.tested ## the tests that take no longer than a minute together
	$(BIN)/python -m pytest -n 2 -m "fast and not slow and not long"

test-platforms: $(VENV)/.tested ## exported FMUs of Windows (Wine) and ARM (qemu-user) give this machine's numbers
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[platforms]'
	$(BIN)/python -m pytest -rs tests/export/test_platforms.py

test-coverage: $(VENV)/.tested ## which lines the tests run -> build/coverage/index.html
	$(BIN)/python -m pip install --quiet --disable-pip-version-check pytest-cov
	$(BIN)/python -m pytest -n 2 --cov=aero_bayes --cov-report=term --cov-report=html:build/coverage

size: ## lines by room; fails above the limits in pyproject.toml
	@$(PYTHON) .ci/size.py

lint: size $(VENV)/.tested ## size, ruff, mypy, and the import contract where import-linter can be had
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy
	@! find tests -name 'test_*.py' -printf '%f: a name of two test files\n' | sort | uniq -d | grep .
	-@$(BIN)/python -m pip install --quiet --disable-pip-version-check 'import-linter>=2' 2>/dev/null
	if [ -x $(BIN)/lint-imports ]; then $(BIN)/lint-imports --no-cache; else echo "import-linter is not here: layers were not checked"; fi

bench: $(VENV)/.tested ## speed, as ratios in one run -> reports/bench.json
	$(BIN)/python benchmarks/bench.py --out reports

STUDY = $(BIN)/python studies/run.py $(subst -,_,$@) --out reports --seed $(SEED) $(if $(WORKERS),--workers $(WORKERS))

rig-trial: setup ## simulated rigs whose model lacks a law -> reports/rig_trial.json (resumable, as all studies)
	$(STUDY)

fault-trial: setup ## complete models, one fault of data, solver or noise -> reports/fault_trial.json (15 minutes a run)
	$(STUDY)

real-rigs: setup ## the loop on recordings of real rigs in ../shared -> reports/real_rigs.json
	$(STUDY)

real-trial: setup ## terms deleted from complete models of real rigs -> reports/real_trial.json (15 minutes a run)
	$(STUDY)

coverage: setup ## intervals where the model is right -> reports/coverage.json (18 minutes a run)
	$(STUDY)

coverage-wrong: setup ## intervals where the model is wrong -> reports/coverage_wrong.json (14 minutes a run)
	$(STUDY)

results: setup ## docs/results.md and the table of README.md from the JSON of studies and bench in reports
	$(BIN)/python studies/results.py --reports reports

trust: ## docs/trust.md from what the tests noted (make test-all)
	$(PYTHON) docs/trust.py docs/trust.md $(wildcard reports/tests.xml reports/tests_long.xml)

fleet: setup ## a small simulated fleet on a local Dask cluster -> reports/fleet (resumable)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[fleet]'
	test -e reports/fleet/simulated/fleet.toml || $(BIN)/python studies/simulate_fleet.py --rigs 12 --out reports/fleet/simulated --seed $(SEED)
	$(RUN) fleet --config $(or $(CONFIG),reports/fleet/simulated/fleet.toml) --out $(or $(OUT),reports/fleet) --dask local --seed $(SEED)

docs: setup ## documentation -> build/docs/index.html
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

dist: setup ## wheels for Linux on x86-64 and ARM64, and the source archive, checked -> build/dist
	.ci/wheels $(BIN)/python

test-arm: ## the wheel and the tests of make test-fast on Debian for ARM64, under qemu-user; as root, with debootstrap and qemu-user-static
	.ci/test-arm

lock: $(VENV)/.tested ## write requirements.lock from what is installed
	$(BIN)/python .ci/lock.py

clean: ## remove what was generated
	rm -rf reports/* build $(VENV)
