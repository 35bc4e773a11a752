"""The model with all values of a fit: as Modelica for other tools, and as an FMU that moves as the fit does."""

from __future__ import annotations

import re
from pathlib import Path

import fmpy
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Layout
from aero_bayes.estimate import ParameterSpec, parameters_from_model
from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.simulation.interface import SolverSettings
from aero_bayes.simulation.model import ModelicaSource

CART = Path(__file__).parents[2] / "examples" / "cart"
ROOM = """
model Wall
  parameter Real C(unit = "J/K") = 100;
  parameter Real R[2](each unit = "K/W") = {1, 2};
  Real T(start = 300, fixed = true);
  input Real q;
equation
  C * der(T) = q - (T - 290) / R[1] - (T - 290) / R[2];
end Wall;
model Room
  parameter Real g = 1;
  Wall walls[2](R = {{1, 2}, {3, 4}});
  Wall other;
  input Real u;
  output Real y = walls[1].T + walls[2].T + other.T;
equation
  walls[1].q = g * u;
  walls[2].q = u;
  other.q = u;
end Room;
"""


@pytest.fixture(scope="module")
def recording() -> aero_bayes.Recording:
    return aero_bayes.read_recording(CART / "train.csv", layout=Layout.of(["F"], ["position"]))


@pytest.fixture(scope="module")
def loop(recording: aero_bayes.Recording, tmp_path_factory: pytest.TempPathFactory) -> aero_bayes.LoopResult:
    settings = aero_bayes.LoopSettings(
        parameters=("k", "d"),
        laws=("coulomb_friction",),
        solver=SolverSettings(1e-8, 1e-8),
        fit=aero_bayes.FitSettings(method="local", fixed={"m": 1.25}),
    )
    folder = tmp_path_factory.mktemp("loop")
    found = aero_bayes.close_loop([recording], model=CART / "Rig.mo", settings=settings, workers=0, out_dir=folder)
    assert [path.name for path in folder.glob("*.mo")] == ["Rig_coulomb_friction.mo"]  # no models that were only tried
    return found


def trajectory(fmu: Path, recording: aero_bayes.Recording, start: float) -> np.ndarray:
    """What FMPy makes of an FMU as it stands, but for where the recording starts."""
    rows = list(zip(recording.time, recording.inputs["F"], strict=True))
    given = np.array(rows, dtype=[("time", float), ("F", float)])
    # the input holds from a sample to the next
    before = [(np.nextafter(t, 0.0), f) for (t, _), (_, f) in zip(rows[1:], rows[:-1], strict=True)]
    given = np.sort(np.concatenate([given, np.array(before, dtype=given.dtype)]), order="time")
    found = fmpy.simulate_fmu(
        str(fmu), start_time=0.0, stop_time=recording.time[-1], input=given, start_values={"position": start},
        output=["position"], output_interval=recording.interval, relative_tolerance=1e-10,
    )  # fmt: skip
    return np.interp(recording.time, found["time"], found["position"])


@pytest.mark.long
def test_both_give_the_loops_own_trajectory(
    loop: aero_bayes.LoopResult, recording: aero_bayes.Recording, tmp_path: Path
):
    assert loop.calibrated is not None
    written = loop.calibrated.write(tmp_path / "written")
    sources = [CART / "Rig.mo", *(tmp_path / "written").glob("*.mo")]
    exported = loop.export_fmu(tmp_path / "exported.fmu")
    compiled = aero_bayes.export_fmu(loop.calibrated.name, tmp_path / "compiled.fmu", sources=sources)
    start = 0.0  # the model fixes it, and the first reading agrees
    own = loop.predicted_after.fitted["train", "position"]
    for fmu in (exported, compiled):
        assert np.abs(trajectory(fmu, recording, start) - own).max() < 1e-6 * np.ptp(own)
    lines = written.read_text("utf-8").splitlines()
    k = next(line for line in lines if "k = " in line)
    q05, q95 = loop["k"].q05, loop["k"].q95
    assert f"// {q05:.6g} to {q95:.6g} N/m" in k
    assert "m = 1.25  // held" in "\n".join(lines)
    assert re.search(r"\btrain\.csv\b.*\b20\d\d-", lines[2])


def test_components_and_arrays_are_set_as_modelica_has_it(tmp_path: Path):
    """An array is set as a whole, so that the elements that were not fitted are there too."""
    (tmp_path / "Room.mo").write_text(ROOM)
    values = {"g": 2.0, "other.C": 33.0, "walls[1].C": 50.0, "walls[2].C": 44.0, "other.R[1]": 1.0, "other.R[2]": 9.0}
    found = CalibratedModel(ModelicaSource("Room", (tmp_path / "Room.mo",)), values, {"walls[2].C": "40 to 48 J/K"})
    assert found.text.split("Room(")[1] == (
        "\n    g = 2,\n    other(\n      C = 33,\n      R = {1, 9}\n    ),\n    walls(\n"
        "      C = {50, 44}  // 40 to 48 J/K\n    )\n  );\nend Room_fitted;\n"
    )
    model = aero_bayes.load_model(found.export_fmu(tmp_path / "Room_fitted.fmu"))
    assert {name: model.parameter(name).start for name in values} == values
    assert model.parameter("walls[1].R[2]").start == 2.0


def test_a_fit_of_an_fmu_says_where_its_values_are(recording: aero_bayes.Recording, tmp_path: Path):
    fmu = aero_bayes.export_fmu("Rig", tmp_path / "Rig.fmu", sources=CART / "Rig.mo")
    model = aero_bayes.load_model(fmu)
    free = parameters_from_model(model, overrides={"k": ParameterSpec()})
    fit = aero_bayes.fit(recording, model, parameters=free, settings=aero_bayes.FitSettings("local"), workers=0)
    with pytest.raises(aero_bayes.InputError, match=r"Rig.fmu: .*Modelica source.*to_frame"):
        fit.export_fmu(tmp_path / "fitted.fmu")
    again = aero_bayes.load_model(CART / "Rig.mo")
    fit = aero_bayes.fit(recording, again, parameters=free, settings=aero_bayes.FitSettings("local"), workers=0)
    fitted = aero_bayes.load_model(fit.export_fmu(str(tmp_path / "fitted.fmu")))
    assert fitted.parameter("k").start == pytest.approx(fit["k"].value, rel=1e-11)


ZONES = """
model Zones
  model Zone
    parameter Real C(unit = "J/K", min = 1) = 100;
    Real T(unit = "K", start = 300, fixed = true);
    input Real q;
  equation
    C * der(T) = q;
  end Zone;
  parameter Real g = 1;
  parameter Real k[2] = {1, 2};
  Zone z[2](each C = g * 100);
  input Real u;
  output Real y = z[1].T + z[2].T;
equation
  z[1].q = k[1] * u;
  z[2].q = k[2] * u;
end Zones;
"""


@pytest.mark.parametrize("second", [150.0, 170.0])
def test_components_that_are_declared_with_each(tmp_path: Path, second: float):
    """An array in the place of `each` does not compile everywhere."""
    (tmp_path / "Zones.mo").write_text(ZONES)
    values = {"z[1].C": 150.0, "z[2].C": second, "k[1]": 3.0, "k[2]": 4.0}
    written = CalibratedModel(ModelicaSource("Zones", (tmp_path / "Zones.mo",)), values)
    fmu = aero_bayes.load_model(written.export_fmu(tmp_path / "fitted.fmu"))
    assert fmu.name == "Zones_fitted"
    assert {name: fmu.parameter(name).start for name in values} == values
