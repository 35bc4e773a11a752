"""Models as users write them: arrays with computed elements, algorithm sections, FMUs without units."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import vessel
from click.testing import CliRunner, Result

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.errors import InputError
from aero_bayes.modelica.compilers import export_fmu

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
    recording = aero_bayes.Recording("run", time, {"u": u}, {"y": vessel.levels(u, 4.0, 2.5, 0.05)})
    fit = aero_bayes.fit(recording, model, parameters=["lag.a[2]"], workers=0)
    (tmp_path / "Rig_fitted.mo").write_text(fit.to_modelica())
    again = aero_bayes.load_model("Rig_fitted", sources=[tmp_path / "Rig_fitted.mo", tmp_path / "P.mo"])
    assert again.parameter("lag.a[2]").start == pytest.approx(2.5, rel=1e-3)
    assert again.parameter("lag.a[3]").start == 3.0
    refit = aero_bayes.fit(recording, again, parameters=["p"], workers=0)
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
    vessel.record(folder / "run.csv", "time,F,v", gain=1.0 / 1.5, k=0.8 / 1.5, sd=0.001)
    return folder


def test_init_reads_an_fmu_and_says_that_it_has_no_units(sled: Path, tmp_path: Path) -> None:
    written = run("init", sled / "Sled.fmu", sled / "run.csv", "--out", tmp_path / "rig.toml")
    assert written.exit_code == 0, written.output
    assert "no unit of F, v" in written.stderr
    done = run("fit", "--config", tmp_path / "rig.toml", "--data", sled / "run.csv", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "result.json").read_text())["parameters"]
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
