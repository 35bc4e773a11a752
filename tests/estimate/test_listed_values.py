"""Parameters that no search can move: each listed value is fitted, and the likeliest is reported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from facts import refusal

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.estimate.calibrated_model import combinations
from aero_bayes.estimate.parameters import ParameterSpec, parameters_from_model

MODEL = """
model Coil
  type Law = enumeration(Linear, Square);
  parameter Real R(min = 0.1) = 2;
  parameter Real gain = 1;
  parameter Real tau = gain / (R + 1);
  parameter Integer n(min = 1) = 1;
  parameter Boolean offset = true;
  parameter Law law = Law.Linear;
  input Real u;
  output Real i(start = 0, fixed = true);
protected
  Real c[n];
equation
  for k in 1:n loop
    c[k] = u;
  end for;
  der(i) = gain * sum(c) - R * (if law == Law.Linear then i else i * abs(i)) + (if offset then 1 else 0);
end Coil;
"""
QUICK = aero_bayes.FitSettings(method="local")
KNOWN = {"offset": {"values": [False]}, "law": {"values": ["Square"]}}


@pytest.fixture(scope="module")
def coil(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("coil") / "Coil.mo"
    file.write_text(MODEL)
    return file


@pytest.fixture(scope="module")
def model(coil: Path) -> aero_bayes.Model:
    return aero_bayes.load_model(coil)


@pytest.fixture(scope="module")
def table() -> dict[str, np.ndarray]:
    """Readings of n = 3, no offset, a square law and R = 1.7, integrated apart from the package."""
    time = np.linspace(0.0, 6.0, 301)
    u = np.where(time < 2.0, 1.0, np.where(time < 4.0, 0.2, 2.0))
    i, x, fine = np.zeros_like(time), 0.0, 40
    for k in range(1, time.size):
        for _ in range(fine):
            x += (3.0 * u[k - 1] - 1.7 * x * abs(x)) * 0.02 / fine
        i[k] = x
    return {"time": time, "u": u, "i": i + np.random.default_rng(4).normal(0.0, 0.01, time.size)}


def recording_of(table: dict[str, np.ndarray]) -> aero_bayes.Recording:
    return aero_bayes.Recording("made", table["time"], {"u": table["u"]}, {"i": table["i"]}, {"u": "", "i": ""})


def test_whole_number_switch_and_enumeration(model: aero_bayes.Model, table: dict[str, np.ndarray], tmp_path: Path):
    offset = ParameterSpec(values=(True, False))
    listed = {"n": {"values": [1, 3]}, "offset": offset, "law": {"values": ["Linear", "Square"]}}
    found = aero_bayes.fit(
        recording_of(table), model, parameters={"R": (0.1, 20.0), **listed}, settings=QUICK, workers=0
    )
    assert found.trials[0].values == {"n": 3, "offset": False, "law": "Square"}
    assert found["R"].value == pytest.approx(1.7, rel=0.02)
    assert len(found.trials) == 8
    assert found.trials[0].share > 0.999
    assert sum(t.share for t in found.trials) == pytest.approx(1.0)
    assert np.all(np.diff([t.worse_by for t in found.trials]) >= 0.0)
    assert float(found["n"]) == 3.0
    assert found["n"].q05 is None
    # The written model has the values, and runs as the fit does.
    written = aero_bayes.load_model("Coil_fitted", sources=[model.source.files[0], found.calibrated.write(tmp_path)])
    again = aero_bayes.fit(recording_of(table), written, parameters={"R": (0.1, 20.0)}, settings=QUICK, workers=0)
    assert again.rms["i"] == pytest.approx(found.rms["i"], rel=1e-3)


def test_values_that_do_as_well_share_the_probability(model: aero_bayes.Model, table: dict[str, np.ndarray]):
    # gain * n is all that matters: with the gain free, each n fits alike.
    chosen = {"R": (0.1, 20.0), "gain": (0.1, 10.0), "n": {"values": [1, 2]}} | KNOWN
    found = aero_bayes.fit(recording_of(table), model, parameters=chosen, settings=QUICK, workers=0)
    assert [t.share for t in found.trials] == pytest.approx([0.5, 0.5], abs=0.1)


#: Listed values, or the name of a parameter to search, and what is said in the one line that refuses them.
REFUSED: list[tuple[dict[str, list[object]] | str, tuple[str, ...]]] = [
    ({"n": [0, 1]}, ("n: value 0", "min 1")),
    ({"n": [1.5]}, ("value 1.5", "Integer")),
    ({"offset": [1]}, ("value 1", "[true, false]")),
    ({"law": ["Cubic"]}, ("Cubic", '["Linear", "Square"]')),
    ({"R": [True]}, ("R", "no number")),
    ({"m": [1, 2]}, ("no parameter m",)),
    ({"n": list(range(1, 30))}, ("29 combinations", "24")),
    ({"n": []}, ("0 combinations",)),
    ("tau", ("tau = gain / (R + 1)", "R and gain")),
    ("n", ("Integer",)),
    ("r", ("has no parameter r", "R")),
]


@pytest.mark.parametrize(("asked", "words"), REFUSED)
def test_refusals(model: aero_bayes.Model, asked: dict[str, list[object]] | str, words: tuple[str, ...]):
    def ask() -> object:
        return parameters_from_model(model, [asked]) if isinstance(asked, str) else combinations(model, asked)

    refusal(ask, *words)


def test_command(coil: Path, table: dict[str, np.ndarray], tmp_path: Path):
    data, config = tmp_path / "made.csv", tmp_path / "coil.toml"
    np.savetxt(data, np.column_stack(list(table.values())), delimiter=",", header=",".join(table), comments="")
    listed = "n = {values = [2, 3]}\noffset = {values = [false]}\nlaw = {values = ['Square']}\n"
    config.write_text(
        f"[model]\nname = 'Coil'\nsources = ['{coil}']\n[parameters]\nR = {{free = true}}\n{listed}"
        "[fit]\nmethod = 'local'\n[prediction]\nmax_seconds = 0\n"
    )
    options = ["--config", str(config), "--workers", "1", "--quiet"]
    out = tmp_path / "out"
    ran = CliRunner().invoke(main, ["fit", "--data", str(data), *options, "--out", str(out)])
    assert ran.exit_code == 0, ran.output
    result = json.loads((out / "result.json").read_text())
    assert [row["values"]["n"] for row in result["fit"]["values"]] == [3, 2]
    assert result["fit"]["values"][0]["values"]["offset"] is False
    assert result["parameters"]["n"]["value"] == 3
    assert "n = 3" in ran.output
    assert "n = 2" in ran.output
    assert "Listed values" in (out / "report.html").read_text()
    # The loop holds what the fit chose.
    loop = CliRunner().invoke(main, ["close-loop", "--train", str(data), *options, "--out", str(tmp_path / "loop")])
    assert loop.exit_code == 0, loop.output
    assert "n = 3, offset = false, law = Square is reported" in loop.output
    result = json.loads((tmp_path / "loop" / "result.json").read_text())
    assert result["loop"]["outcome"] == "adequate"
    assert result["parameters"]["R"]["value"] == pytest.approx(1.7, rel=0.02)
    assert "n = 3" in (tmp_path / "loop" / "Coil_chosen.mo").read_text()
