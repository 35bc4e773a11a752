"""FMUs whose reset does not bring them back to their start, and FMUs that nothing brings back."""

from __future__ import annotations

import numpy as np
import pytest
from runs import ran

import aero_bayes
from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import ParameterSpec, parameters_from_model
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, Trajectories
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool

TIME = np.linspace(0.0, 2.0, 41)
JUMP = (InputSignal("u", np.array([0.0, 0.7]), np.array([1.0, -1.0])),)
# x' = b u - k x, x(0) = g, or 1 where g is 0, y = 2 x + 3 u
TARGETS = {"KEPT_START": (ParameterTarget("k"), ParameterTarget("g"))}
OTHERS = (ParameterTarget("k"), ParameterTarget("b"))
VALUES = np.array([[1.3, 0.7], [1.3, 0.7], [0.9, 0.5], [1.1, 2.0], [1.3, 0.7]])
STEPS = ("STEPS",)


def simulated(model: Model, pool: WorkerPool, define: str):
    experiments = tuple(Experiment(TIME[:n], ("x", "y"), JUMP) for n in (41, 21))
    problem = Problem(model, experiments, (TARGETS.get(define, OTHERS),) * 2)
    return ran(problem, pool, VALUES)


def same(a: Trajectories, b: Trajectories) -> None:
    """Runs of an odd FMU, all of which succeeded, and of the plain one."""
    assert np.all(b.outcomes == Outcome.OK)
    for one, other in zip(a.outputs, b.outputs, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("define", ["IDLE_RESET", "KEPT_START", "COUNTED"])
@pytest.mark.parametrize("version", [(), ("FMI3",)])
def test_co_simulation_that_a_reset_does_not_bring_back(test_fmu, pool, define, version):
    plain, odd = (
        simulated(test_fmu("Dahlquist", defines=(*STEPS, *version, *d)), pool, define) for d in ((), (define,))
    )
    same(plain, odd)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("defines", [("COUNTED",), ("IDLE_RESET", "ONCE"), (*STEPS, "COUNTED_BESIDE")])
def test_equal_runs_that_differ_are_refused(test_fmu, pool, defines):
    found = simulated(test_fmu("Dahlquist", defines=defines), pool, "")
    assert set(found.outcomes[2:].ravel()) == {Outcome.NOT_REPEATABLE}
    assert "equal runs" in Outcome.NOT_REPEATABLE.text


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_fit_says_why_it_cannot_be_made(test_fmu):
    model = test_fmu("Dahlquist", defines=(*STEPS, "COUNTED_BESIDE"))
    recording = Recording("run", TIME, {"u": np.ones(41)}, {"x": np.exp(-TIME)})
    free = parameters_from_model(model, overrides={name: ParameterSpec(lower=0.1, upper=10.0) for name in ("k", "b")})
    with pytest.raises(CannotFinishError, match=Outcome.NOT_REPEATABLE.text):
        aero_bayes.fit(recording, model, parameters=free, settings=FitSettings(method="local"), workers=1)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_co_simulation_once_a_process(test_fmu, pool):
    """A reset that does all is used; where it does not, every process does one run."""
    plain, reset, idle = (
        simulated(test_fmu("Dahlquist", defines=(*STEPS, *d)), pool, "")
        for d in ((), ("ONCE",), ("ONCE", "IDLE_RESET"))
    )
    same(plain, reset)
    same(plain, idle)


@pytest.mark.parametrize("steps", [(), STEPS])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_reset_that_does_all_is_used(test_fmu, pool, tmp_path, steps):
    """One comparison, then no instance more: the FMU counts them in a file of its worker's folder."""
    model = test_fmu("Dahlquist", defines=(*steps, "TALLY"))
    values = np.linspace(0.5, 1.5, 60).reshape(30, 2)
    problem = Problem(model, (Experiment(TIME, ("x",)),), (OTHERS,))
    with open_simulator(problem, workers=1) as simulator:
        simulator.simulate(values)
        (counted,) = simulator.pool.folder.glob("*/instances")
        before = counted.stat().st_size
        simulator.simulate(values)
        assert counted.stat().st_size == before
    # Model Exchange: to look at the model, for the first run and for the comparison; co-simulation: for each number
    # of steps that is tried, for the first run and for the comparison
    assert before <= (9 if steps else 3)
