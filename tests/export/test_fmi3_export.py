"""FMI 3.0 beside FMI 2.0: the same model under both standards, in FMPy and in the engine."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.validation import validate_fmu

from aero_bayes.cli import main
from aero_bayes.errors import InputError
from aero_bayes.modelica import export_fmu
from aero_bayes.simulation import (
    Experiment,
    InputSignal,
    Model,
    ParameterTarget,
    Problem,
    SolverSettings,
    open_simulator,
)

pytestmark = pytest.mark.fast

SOURCE = """
model Ball "A ball that bounces, driven, read twice"
  parameter Real g(unit = "m/s2", min = 0) = 9.81;
  parameter Real e = 0.7;
  parameter Real twice = 2 * e;
  input Real u(unit = "m/s2");
  output Real h(unit = "m", start = 1, fixed = true);
  output Real again = h;
  output Real energy = g * h + 0.5 * v ^ 2;
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = u - g;
  when h < 0 then
    reinit(v, -e * pre(v));
  end when;
end Ball;
"""


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("ball")
    source = folder / "Ball.mo"
    source.write_text(SOURCE)
    two = export_fmu("Ball", folder / "two.fmu", sources=[source])
    asked = ["fmu", "--fmi", "3", "--model", "Ball", "--source", source, "--out", folder / "three.fmu"]
    done = CliRunner().invoke(main, list(map(str, asked)), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return two, folder / "three.fmu"


def test_it_is_valid_and_says_the_same(both: tuple[Path, Path]) -> None:
    two, three = map(Model.load, both)
    assert validate_fmu(str(three.path)) == []
    assert (two.fmi_version, three.fmi_version) == (2, 3)
    assert [v.name for v in three.states] == [v.name for v in two.states]
    assert {v.name: v.start for v in three.parameters} == {v.name: v.start for v in two.parameters}
    assert {v.name for v in three.outputs} == {"h", "again", "energy"}
    assert three.copied_state("again") == two.copied_state("again") == two.state_index("h")
    assert three.jacobian_pattern == two.jacobian_pattern
    assert three.event_indicators == two.event_indicators == 1


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_fmpy_runs_both_alike(both: tuple[Path, Path], kind: str) -> None:
    drive = np.array([(0.0, 0.5), (2.0, -0.5)], dtype=[("time", float), ("u", float)])
    found = [
        fmpy.simulate_fmu(
            str(path), fmi_type=kind, stop_time=1.5, output_interval=0.01, relative_tolerance=1e-9, input=drive,
            output=["h", "again", "energy"], start_values={"e": 0.6},
        )
        for path in both
    ]  # fmt: skip
    for name in ("h", "again", "energy"):
        assert found[1][name] == pytest.approx(found[0][name], abs=1e-12), name
    assert np.ptp(found[1]["energy"]) > 1.0


def test_the_engine_runs_both_alike(both: tuple[Path, Path]) -> None:
    t = np.linspace(0.0, 1.5, 151)
    experiment = Experiment(t, ("h", "again", "energy"), (InputSignal("u", t, np.sin(t)),))
    targets = ((ParameterTarget("g"), ParameterTarget("e")),)
    curves = []
    for path in both:
        problem = Problem(Model.load(path), (experiment,), targets, settings=SolverSettings(1e-9, 1e-9, 10000, 9.0))
        with open_simulator(problem) as simulator:
            curves.append(simulator.simulate(np.array([[9.5, 0.6]]), active=range(2)))
    assert curves[1].outputs[0] == pytest.approx(curves[0].outputs[0], abs=1e-12)
    # across a bounce the engine takes differences of runs
    assert curves[1].sensitivities[0] == pytest.approx(curves[0].sensitivities[0], abs=1e-4)


def test_only_the_embedded_exporter_writes_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="embedded exporter only"):
        export_fmu("Ball", tmp_path / "x.fmu", compiler="omc", fmi=3)
    with pytest.raises(InputError, match="expected 2 or 3"):
        export_fmu("Ball", tmp_path / "x.fmu", fmi=1)
