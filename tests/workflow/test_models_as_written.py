"""Models as users write them: tables, records, derivatives of inputs, algorithm sections, FMUs without units."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.errors import InputError
from aero_bayes.modelica.compilers import export_fmu

CASES = Path(os.environ.get("AERO_BAYES_CASES", Path(__file__).parents[2].parent / "shared" / "cases"))
cases = pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}")
pytestmark = pytest.mark.fast

SLED = """model Sled
  parameter Real m(min = 0.1, max = 10) = 2;
  parameter Real d(min = 0.01, max = 10) = 0.5;
  input Real F;
  output Real v(start = 0, fixed = true);
equation
  m * der(v) = F - d * v;
end Sled;
"""
LIMITED = """model Limited
  parameter Real top = 2;
  input Real u;
  output Real x(start = 0, fixed = true);
  Real c;
algorithm
  c := 2 * u;
  if c > top then
    c := top;
  end if;
equation
  der(x) = c - x;
end Limited;
"""


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [*map(str, arguments)])


def fitted(config: Path, data: Path, out: Path) -> dict[str, Any]:
    done = run("fit", "--workers", "1", "--quiet", "--config", config, "--data", data, "--out", out)
    assert done.exit_code == 0, done.output
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    assert [row["cause"] for row in result["diagnosis"] if row["found"]] == []
    return result["parameters"]


@cases
@pytest.mark.parametrize(("folder", "model", "line"), [("43_derivative_of_input", "Meter", 9)])
def test_43_the_derivative_of_an_input_is_named(folder: str, model: str, line: int) -> None:
    with pytest.raises(InputError, match=rf"^{model}.mo:{line}: .*derivative of 'E' is not known"):
        aero_bayes.load_model(CASES / folder / f"{model}.mo")


@cases
def test_49_values_of_a_table_are_free_and_its_break_points_held(tmp_path: Path) -> None:
    folder = CASES / "49_table_values"
    written = run("init", folder / "Map.mo", folder / "run.csv", "--model", "MapIf", "--out", tmp_path / "rig.toml")
    assert written.exit_code == 0, written.output
    found = fitted(tmp_path / "rig.toml", folder / "run.csv", tmp_path / "out")
    values = [found[f"e[{k}]"]["value"] for k in range(1, 7)]
    assert values == pytest.approx([3.02, 3.47, 3.61, 3.69, 3.88, 4.17], abs=0.005)
    assert found["R"]["value"] == pytest.approx(0.045, rel=0.03)


@cases
@pytest.mark.parametrize(
    ("config", "data", "truth", "share"),
    [("rig.toml", "run.csv", {"tank.data.V": 0.12, "tank.data.U[3]": 3.5}, 0.01),
     ("element.toml", "element.csv", {"s.a[2]": 2.7}, 0.01)],
)  # fmt: skip
def test_51_a_written_model_with_arrays_inside_can_be_loaded(
    config: str, data: str, truth: dict[str, float], share: float, tmp_path: Path
) -> None:
    folder = CASES / "51_records_and_options"
    found = fitted(folder / config, folder / data, tmp_path)
    (written,) = tmp_path.glob("*_fitted.mo")
    again = aero_bayes.load_model(written, sources=list(folder.glob("*.mo")))
    for name, value in truth.items():
        assert found[name]["value"] == pytest.approx(value, rel=share)
        assert again.parameter(name).start == pytest.approx(found[name]["value"], rel=1e-9)


PARTLY_COMPUTED = """package P
  model Lag
    parameter Real a[3](each min = 0.01, each max = 100) = {1, 1, 1};
    input Real u;
    output Real x(start = 0, fixed = true);
  equation
    der(x) = a[1] * u - a[2] * x;
  end Lag;
  model Rig
    parameter Real p(min = 0.01, max = 100) = 2;
    Lag lag(a = {-(1 - 2 * p) + 1, 2, 3});
    input Real u;
    output Real y = lag.x;
  equation
    lag.u = u;
  end Rig;
end P;
"""


def test_an_array_with_an_element_that_is_computed_is_written_whole(tmp_path: Path) -> None:
    (tmp_path / "P.mo").write_text(PARTLY_COMPUTED)
    model = aero_bayes.load_model("P.Rig", sources=[tmp_path / "P.mo"])
    time, u = np.arange(200) * 0.05, np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, 10), 20)
    y, decay = np.zeros(200), np.exp(-2.5 * 0.05)
    for n in range(199):
        y[n + 1] = y[n] * decay + 4.0 / 2.5 * u[n] * (1.0 - decay)
    fit = aero_bayes.fit(
        aero_bayes.Recording("run", time, {"u": u}, {"y": y}), model, parameters=["lag.a[2]"], workers=0
    )
    (tmp_path / "Rig_fitted.mo").write_text(fit.to_modelica())
    again = aero_bayes.load_model("Rig_fitted", sources=[tmp_path / "Rig_fitted.mo", tmp_path / "P.mo"])
    assert again.parameter("lag.a[2]").start == pytest.approx(2.5, rel=1e-3)
    assert again.parameter("lag.a[3]").start == 3.0
    inputs = aero_bayes.Recording("run", time, {"u": u}, {"y": y})
    refit = aero_bayes.fit(inputs, again, parameters=["p"], workers=0)
    assert refit["p"].value == pytest.approx(2.0, rel=1e-3)  # the first element still follows p


def test_an_algorithm_section_that_is_not_read_is_told_by_its_line(tmp_path: Path) -> None:
    (tmp_path / "Limited.mo").write_text(LIMITED)
    with pytest.raises(InputError, match=r"^Limited.mo:6: .*into a function"):
        aero_bayes.load_model(tmp_path / "Limited.mo")


@pytest.fixture(scope="module")
def sled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sled")
    (folder / "Sled.mo").write_text(SLED)
    export_fmu("Sled", folder / "Sled.fmu", sources=[folder / "Sled.mo"])
    rng = np.random.default_rng(3)
    force, speed = np.repeat(rng.uniform(-2.0, 2.0, 20), 20), np.zeros(400)
    for n in range(399):
        rest = force[n] / 0.8
        speed[n + 1] = rest + (speed[n] - rest) * np.exp(-0.1 * 0.8 / 1.5)
    rows = np.column_stack([np.arange(400) * 0.1, force, speed + 0.001 * rng.normal(size=400)])
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="time,F,v", comments="")
    return folder


def test_init_reads_an_fmu_and_says_that_it_has_no_units(sled: Path, tmp_path: Path) -> None:
    written = run("init", sled / "Sled.fmu", sled / "run.csv", "--out", tmp_path / "rig.toml")
    assert written.exit_code == 0, written.output
    assert "no unit of F, v" in written.stderr
    found = fitted(tmp_path / "rig.toml", sled / "run.csv", tmp_path / "out")
    # without a force in absolute terms both are known: the input is in the same unit as the model's
    assert found["m"]["value"] == pytest.approx(1.5, rel=0.01)
    assert found["d"]["value"] == pytest.approx(0.8, rel=0.01)


def test_units_that_are_given_open_the_ports_of_motion(sled: Path, tmp_path: Path) -> None:
    assert run("init", sled / "Sled.fmu", sled / "run.csv", "--out", tmp_path / "rig.toml").exit_code == 0
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "units.toml").write_text(text.replace("[data]", 'units = {F = "N", v = "m/s"}\n[data]', 1))
    (tmp_path / "wrong.toml").write_text(text.replace("[data]", 'units = {G = "N"}\n[data]', 1))
    tomllib.loads((tmp_path / "units.toml").read_text())

    def kinds(name: str) -> set[str]:
        done = run("ports", "--json", "--config", tmp_path / name)
        assert done.exit_code == 0, done.output
        return {row["kind"] for row in json.loads(done.stdout)}

    assert kinds("units.toml") - kinds("rig.toml") == {"motion"}
    wrong = run("ports", "--config", tmp_path / "wrong.toml")
    assert wrong.exit_code == 2
    assert len(wrong.stderr.splitlines()) == 1
