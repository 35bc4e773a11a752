"""Mistakes that people make on the command line: one line that names file, key or column, and says what to do."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest
from click.testing import CliRunner

from aero_bayes.cli import main

CART = Path(__file__).parents[2] / "examples" / "cart"
FIT = "fit --config rig.toml --data train.csv --out out --quiet"
TWO = "model A\nend A;\nmodel B\nend B;\n"


@dataclass(frozen=True)
class Mistake:
    """What is typed in a copy of the cart's folder, what was replaced in which file, and what the answer has."""

    words: tuple[str, ...]
    typed: str = FIT
    replaced: dict[str, tuple[str, str]] = field(default_factory=dict)


def toml(old: str, new: str, *words: str) -> Mistake:
    return Mistake(words, replaced={"rig.toml": (old, new)})


def data(old: str, new: str, *words: str) -> Mistake:
    return Mistake(("train.csv", *words), replaced={"train.csv": (old, new)})


def typed(command: str, *words: str) -> Mistake:
    return Mistake(words, command if "--out" in command else f"{command} --out out --quiet")


MISTAKES = {
    "a start outside its bounds": toml(
        "k = {free = true}", "k = {free = true, lower = 60}", "rig.toml, line 10: k: start 50 N/m", "60",
    ),
    "bounds the wrong way round": toml(
        "k = {free = true}", "k = {free = true, lower = 60, upper = 40}", "rig.toml, line 10: k: lower bound 60", "40",
    ),
    "a negative upper bound": toml(
        "d = {free = true}", "d = {free = true, lower = 0, upper = -0.001, value = 0}", "line 11: d: lower bound 0",
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
    "a key misspelt": toml("initial_states", "initial_state", "fit.initial_state", "initial_states"),
    "a choice that is none": toml('"estimated"', '"free"', "fit.initial_states", "'free'"),
    "no TOML": toml("[parameters]", "[parameters", "rig.toml", "not valid TOML", "line"),
    "nothing free": toml("{free = true}", "{free = false}", "no parameters to fit", "[parameters.d] with free = true"),
    "a class that the file has not": toml('"Rig"', '"Rgi"', "no such class in Rig.mo, found Rig; did you mean"),
    "a source that is not there": toml('["Rig.mo"]', '["Rgi.mo"]', "Rgi.mo: no such file"),
    "a source that is no Modelica": toml('["Rig.mo"]', '["train.csv"]', "train.csv: expected a Modelica file (.mo)"),
    "an input that the model has not": toml('["F"]', '["f"]', "no column f", "did you mean F?"),
    "an input left out": toml('["F"]', "[]", "train.csv: the input F of model Rig has no column", "[data] constants"),
    "an output that the model has not": toml('["position"]', '["positon"]', "no output", "did you mean position?"),
    "a column that is mapped to nothing": toml(
        "[parameters]", '[data.columns.F]\nsource = "force"\n[parameters]', "no column force, found time, F, position",
    ),
    "a unit that is none": toml(
        "[parameters]", '[data.columns.F]\nunit = "newtons"\n[parameters]', "column F: unknown unit 'newtons'",
        "did you mean N?",
    ),
    "a unit of another kind": toml(
        "[parameters]", '[data.columns.F]\nunit = "mm"\n[parameters]', "column F: unit mm cannot become N",
    ),
    "a column mapped that nobody asked for": toml(
        "[parameters]", '[data.columns.speed]\nunit = "m/s"\n[parameters]', "speed is not a column of the model",
    ),
    "a column renamed": data("time,F,", "time,Force,", "row 1: no column F, found time, Force, position"),
    "a column in capitals": data("position", "Position", "no output column", "found time, F, Position; did you mean"),
    "no header": data("time,F,position\n", "", "row 1: holds numbers, expected a header"),
    "text in a column": data("0.0,0.0,", "0.0,off,", "row 2, column F", "'off' is not a number"),
    "times that repeat": data("\n0.02,", "\n0.0,", "row 3, column time: repeats"),
    "a hole in the input": data("\n0.02,0.0,", "\n0.02,,", "row 3, column F: missing"),
    "a missing cell": data("\n0.02,0.0,", "\n0.02,", "row 3: 2 cells, expected 3"),
    "no such recording": typed("fit --config rig.toml --data trian.csv", "trian.csv: no such file", "mean train.csv?"),
    "no such configuration": typed("fit --config rig --data train.csv", "rig: no such file; did you mean rig.toml?"),
    "the same recording twice": typed("fit --config rig.toml --data train.csv --data train.csv", "given twice"),
    "no configuration": typed("fit --data train.csv", "no model", "--config rig.toml"),
    "an FMU that is not there": typed("fit --config rig.toml --model Rig.fmu --data train.csv", "no such file"),
    "a law that is none": Mistake(
        ("coulomb",), "close-loop --config rig.toml --train train.csv --out out --quiet",
        {"rig.toml": ("[fit]", '[loop]\nlaws = ["coulomb"]\n[fit]')},
    ),
    "a port that is none": Mistake(
        ("speed",), "close-loop --config rig.toml --train train.csv --out out --quiet",
        {"rig.toml": ("[fit]", '[loop]\nports = ["speed"]\n[fit]')},
    ),
    "a file that is written already": typed("init Rig.mo train.csv --out rig.toml", "rig.toml: exists already"),
    "no model to begin with": typed("init Rgi.mo train.csv --out new.toml", "Rgi.mo: no such file"),
    "two models in a file": Mistake(
        ("Rig.mo: say which model", "--model: A, B"), "init Rig.mo train.csv --out new.toml", {"Rig.mo": ("", TWO)},
    ),
    "a class for the exporter": typed("fmu --model Rgi --source Rig.mo --out out/Rig.fmu", "no such class in Rig.mo"),
    "a class without its file": typed("fmu --model Rig --out out/Rig.fmu", "Rig: no such class; name its file"),
    "a semicolon forgotten": Mistake(
        ("Rig.mo:12: unexpected", "end of line 10"), FIT, {"Rig.mo": ("der(s) = v;", "der(s) = v")},
    ),
    "a page of nothing": Mistake(("out", "result.json"), "report out"),
    "a recording that no model is named for": Mistake(("no model", "--config rig.toml"), "check train.csv"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_gets_one_line(name: str, tmp_path: Path):
    mistake, folder = MISTAKES[name], Path(copytree(CART, tmp_path / "cart", ignore=ignore_patterns("out*", "*.ipynb")))
    for file, (old, new) in mistake.replaced.items():
        text = (folder / file).read_text("utf-8")
        assert old in text
        (folder / file).write_text(text.replace(old, new) if old else new, "utf-8")
    before = {path for path in folder.rglob("*") if path.is_file()}
    with contextlib.chdir(folder):
        done = CliRunner().invoke(main, mistake.typed.split())
    assert done.exit_code == 2, done.output
    (line,) = done.stderr.strip().splitlines()
    for words in mistake.words:
        assert words in line
    written = {path for path in folder.rglob("*") if path.is_file() and path.suffix != ".fmu"}
    assert written == before, "something was half-written"


def test_there_are_forty():
    assert len(MISTAKES) >= 40
