"""Mistakes that people make on the command line: one line that names file, key or column, and says what to do.

All bad input is a row of one table, in a copy of the cart's folder with an FMU and a recording of the AERO."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copytree, ignore_patterns

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main
from aero_bayes.modelica.compilers import export_fmu

pytestmark = pytest.mark.fast

CART = Path(__file__).parents[2] / "examples" / "cart"
FIT = "fit --config rig.toml --data train.csv --out out --quiet"
LOOP = "close-loop --config rig.toml --train train.csv --out out --quiet"
AERO = "fit --model OneDof.fmu --data aero.csv --out out --quiet"
TWO = "model A\nend A;\nmodel B\nend B;\n"


@dataclass(frozen=True)
class Mistake:
    """What is typed in a copy of the folder, what was replaced in which file, and what the answer has.

    In place of nothing stands the whole file."""

    words: tuple[str, ...]
    typed: str = FIT
    replaced: dict[str, tuple[str, str]] = field(default_factory=dict)


def toml(old: str, new: str, *words: str) -> Mistake:
    return Mistake(words, replaced={"rig.toml": (old, new)})


def loop(added: str, *words: str) -> Mistake:
    return Mistake(words, LOOP, {"rig.toml": ("[fit]", added)})


def quiet(volts: float = 1.0) -> str:
    """A quiet, plausible recording of the AERO; its voltage times a factor."""
    time = np.arange(0.0, 10.0, 0.02)
    rows = np.column_stack([time, 12.0 * volts * (time > 1.0), 0.1 * np.sin(1.3 * time)])
    return "\n".join(["time,V_m,theta", *(",".join(f"{x:.6g}" for x in row) for row in rows), ""])


def typed(command: str, *words: str) -> Mistake:
    return Mistake(words, command if "--out" in command else f"{command} --out out --quiet")


MISTAKES = {
    "a start outside its bounds": toml(
        "k = {free = true}", "k = {free = true, lower = 60}", "rig.toml, line 10: k: start 50 N/m", "60",
    ),
    "bounds the wrong way round": toml(
        "k = {free = true}", "k = {free = true, lower = 60, upper = 40}", "rig.toml, line 10: k: lower bound 60", "40",
    ),
    "a prior the wrong way round": toml(
        "k = {free = true}", 'k = {free = true, prior = {kind = "uniform", lower = 9, upper = 1}}', "10: k: uniform",
    ),
    "a prior without its numbers": toml(
        "k = {free = true}", 'k = {free = true, prior = {kind = "normal", mean = 9}}', "k.prior", "mean and sd",
    ),
    "a parameter that the model has not": toml(
        "k = {free = true}", "K = {free = true}", "rig.toml, line 10: model Rig has no parameter K", "did you mean k?",
    ),
    "a word for a number": toml("k = {free = true}", 'k = {value = "fifty"}', "rig.toml", "parameters.k.value"),
    "a section misspelt": toml("[parameters]", "[parameter]", "rig.toml", "'parameter' does not exist", "parameters"),
    "a number below zero": toml("[fit]", "[fit.pso]\nparticles = -1\n[fit]", "fit.pso.particles", "-1"),
    "a choice that is none": toml('"estimated"', '"free"', "fit.initial_states", "'free'"),
    "no TOML": toml("[parameters]", "[parameters", "rig.toml", "not valid TOML", "line"),
    "no draws of an earlier experiment": toml(
        "[model]", 'priors_from = "first/posterior.nc"\n[model]', "first/posterior.nc: is no posterior",
    ),
    "nothing free": toml("{free = true}", "{free = false}", "no parameters to fit", "[parameters.d] with free = true"),
    "a class that the file has not": toml('"Rig"', '"Rgi"', "no such class in Rig.mo, found Rig; did you mean"),
    "a source that is no Modelica": toml('["Rig.mo"]', '["train.csv"]', "train.csv: expected a Modelica file (.mo)"),
    "an input left out": toml('["F"]', "[]", "train.csv: the input F of model Rig has no column", "[data] constants"),
    "an output that the model has not": toml('["position"]', '["positon"]', "no output", "did you mean position?"),
    "a column renamed": Mistake(
        ("train.csv", "row 1: no column F, found time, Force, position"),
        replaced={"train.csv": ("time,F,", "time,Force,")},
    ),
    "no such recording": typed("fit --config rig.toml --data trian.csv", "trian.csv: no such file", "mean train.csv?"),
    "no such configuration": typed("fit --config rig --data train.csv", "rig: no such file; did you mean rig.toml?"),
    "the same recording twice": typed("fit --config rig.toml --data train.csv --data train.csv", "given twice"),
    "two recordings of one name": Mistake(
        ("other/train.csv", "different names"), f"{FIT} --data other/train.csv", {"other/train.csv": ("", quiet())},
    ),
    "no configuration": typed("fit --data train.csv", "no model", "--config rig.toml"),
    "an FMU that is not there": typed("fit --config rig.toml --model Rig.fmu --data train.csv", "no such file"),
    "a law that is none": loop('[loop]\nlaws = ["coulomb"]\n[fit]', "coulomb"),
    "an effect for a law": loop('[loop]\nlaws = ["gain@F"]\n[fit]', "did you mean 'gain'?"),
    "a port that is none": loop('[loop]\nports = ["speed"]\n[fit]', "port 'speed'"),
    "an effect that is none": loop('[loop]\nexclude = ["ofset"]\n[fit]', "did you mean 'offset'?"),
    "an effect at no port": loop('[loop]\nrequire = ["gain@w"]\n[fit]', "did you mean 'gain@"),
    "a loop by least squares": loop('[fit]\ncost = "eq6"', "cost"),
    "a loop by the swarm": loop('[fit]\nmethod = "pso"', "method"),
    "a loop with process noise that is given": loop("[noise.process]\nposition = 0.1\n[fit]", "process"),
    "a loop with the other engine": loop('[solver]\nengine = "fmpy"\n[fit]', "fmpy"),
    "a voltage in mV": Mistake(("aero", "V_m", "V"), AERO, {"aero.csv": ("", quiet(volts=1000.0))}),
    "half an FMU": typed("fit --model half.fmu --data aero.csv", "half.fmu"),
    "an FMU whose binary is no library": typed("fit --model binary.fmu --data aero.csv", "binary"),
    "no FMU": Mistake(("Rig.fmu",), "init Rig.fmu train.csv --out new.toml", {"Rig.fmu": ("", "PK")}),
    "a file that is written already": typed("init Rig.mo train.csv --out rig.toml", "rig.toml: exists already"),
    "two models in a file": Mistake(
        ("Rig.mo: say which model", "--model: A, B"), "init Rig.mo train.csv --out new.toml", {"Rig.mo": ("", TWO)},
    ),
    "a class without its file": typed("fmu --model Rig --out out/Rig.fmu", "Rig: no such class; name its file"),
    "bounds of the model the wrong way round": Mistake(
        ("error: Rig.mo:3: ", "k: min = 90"), "fmu --model Rig --source Rig.mo --out out/Rig.fmu",
        {"Rig.mo": ('k(unit = "N/m", min = 0)', 'k(unit = "N/m", min = 90, max = 10)')},
    ),
    "a semicolon forgotten": Mistake(
        ("Rig.mo:12: unexpected", "end of line 10"), FIT, {"Rig.mo": ("der(s) = v;", "der(s) = v")},
    ),
    "a page of nothing": Mistake(("out", "result.json"), "report out"),
    "a recording that no model is named for": Mistake(("no model", "--config rig.toml"), "check train.csv"),
}  # fmt: skip


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(copytree(CART, tmp_path_factory.mktemp("rig") / "cart", ignore=ignore_patterns("out*", "*.ipynb")))
    (folder / "aero.csv").write_text(quiet(), "utf-8")
    whole = export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu")
    (folder / "half.fmu").write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with zipfile.ZipFile(whole) as source, zipfile.ZipFile(folder / "binary.fmu", "w") as target:
        for item in source.infolist():
            binary = item.filename.endswith(".so")
            target.writestr(item, b"not a library" if binary else source.read(item.filename))
    return folder


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_gets_one_line(name: str, rig: Path, tmp_path: Path):
    mistake, folder = MISTAKES[name], Path(copytree(rig, tmp_path / "cart"))
    for file, (old, new) in mistake.replaced.items():
        text = (folder / file).read_text("utf-8") if old else ""
        assert old in text
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(text.replace(old, new) if old else new, "utf-8")
    before = {path for path in folder.rglob("*") if path.is_file()}
    with contextlib.chdir(folder):
        done = CliRunner().invoke(main, mistake.typed.split())
    assert done.exit_code == 2, done.output
    (line,) = done.stderr.strip().splitlines()
    for words in mistake.words:
        assert words in line
    written = {path for path in folder.rglob("*") if path.is_file() and (path.suffix != ".fmu" or path in before)}
    assert written == before, "something was half-written"


@pytest.mark.parametrize("earlier", [True, False])
def test_a_refused_run_says_whose_result_is_in_its_folder(earlier: bool, tmp_path: Path) -> None:
    if earlier:
        (tmp_path / "result.json").write_text("{}")
    refused = CliRunner().invoke(main, ["fit", "--data", "none.csv", "--model", "Rig", "--out", str(tmp_path)])
    assert (refused.exit_code, len(refused.stderr.splitlines())) == (2, 1)
    assert (str(tmp_path / "result.json") in refused.stderr) == earlier


def test_the_installed_command_ends_with_status_2(tmp_path: Path) -> None:
    command = [Path(sys.executable).with_name("aero-bayes"), "check", str(tmp_path / "none.csv")]
    finished = subprocess.run(command, capture_output=True, text=True)
    assert finished.returncode == 2
    assert finished.stderr.count("\n") == 1
