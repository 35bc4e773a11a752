"""Both ways to the objective agree: reduced inside the engine, and as whitened residuals with slopes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, LogNormal, Normal
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import ParameterTarget, SolverSettings

pytestmark = pytest.mark.fast

RINGING = """
model Ringing "A damped oscillator"
  parameter Real w(min = 0.1, max = 50) = 6 "Angular frequency";
  parameter Real d(min = 0, max = 10) = 0.4 "Damping";
  parameter Real c(min = -10, max = 10) = 0.2 "Offset of the second output";
  output Real x = s;
  output Real y = 3 * v + c;
  Real s(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(s) = v;
  der(v) = -w * w * s - d * v;
end Ringing;
"""
NOISES = {
    "white": OutputNoise(0.1),
    "brief": OutputNoise(0.1, 0.3, 0.05),
    "slow": OutputNoise(0.3, 0.1, 2.0),
    "faint": OutputNoise(0.2, 0.05, 0.004),
}
REL = 1e-9


def recordings(sampling: str) -> list[Recording]:
    rng = np.random.default_rng(7)
    found = []
    for name, n in (("a", 300), ("b", 200)):
        time = np.sort(rng.uniform(0.0, 3.0, n)) if sampling == "uneven" else np.arange(n) * 0.01
        outputs = {"x": np.cos(6.0 * time), "y": -18.0 * np.sin(6.0 * time)}
        outputs = {o: y + 0.3 * rng.standard_normal(n) for o, y in outputs.items()}
        if sampling == "gaps":
            outputs["x"][40:90] = np.nan
            outputs["x"][n - 30 :: 7] = np.nan
            outputs["y"][rng.random(n) < 0.3] = np.nan
        found.append(Recording(name, time, {}, outputs))
    return found


@pytest.fixture(scope="module")
def objectives(exported):
    """An objective for each sampling."""
    parameters = ParameterSet(
        (
            Parameter("w", "1", 5.7, 0.1, 50.0, LogNormal(6.0, 0.3), "log", "", ParameterTarget("w")),
            Parameter("d", "1", 0.5, 0.0, 10.0, Normal(0.4, 1.0), "linear", "", ParameterTarget("d")),
            Parameter("c", "1", 0.1, -10.0, 10.0, Normal(0.0, 1.0), "linear", "", ParameterTarget("c")),
        )
    )
    settings = CalibrationSettings(delay="none", may_start_at_rest=(), solver=SolverSettings(1e-8, 1e-8))
    opened = {}
    for sampling in ("even", "gaps", "uneven"):
        calibration = calibrate(recordings(sampling), exported(RINGING), parameters, settings=settings)
        opened[sampling] = Objective(calibration, open_simulator(calibration.problem(), workers=0))
    yield opened
    for objective in opened.values():
        objective.simulator.close()


@pytest.mark.parametrize("kind", NOISES)
@pytest.mark.parametrize("sampling", ["even", "gaps", "uneven"])
def test_engine_and_whitened_residuals_agree(objectives, sampling, kind):
    objective, noise = objectives[sampling], {"x": NOISES[kind], "y": NOISES["brief" if kind == "white" else "white"]}
    parameters = objective.parameters
    x = parameters.to_search(parameters.start)
    values = parameters.from_search(x)[None]
    active = (0, 1, 2)

    plain = objective.evaluate(x)
    by_recording = objective.log_likelihood(values, objective.noise_rows(noise))[0]
    assert objective.whiten(plain, noise).log_likelihood == pytest.approx(by_recording.sum(), rel=REL)
    other = Objective(objective.calibration, SimpleNamespace(simulate=objective.simulator.simulate))  # of any engine
    assert other.log_likelihood(values, other.noise_rows(noise))[0] == pytest.approx(by_recording, rel=REL)

    score = objective.whiten(objective.evaluate(x, active), noise).score
    step = 1e-5 * np.eye(3)
    moved = parameters.from_search(np.concatenate([x + step, x - step]))
    up, down = np.split(objective.log_likelihood(moved, objective.noise_rows(noise)).sum(axis=1), 2)
    np.testing.assert_allclose(score, (up - down) / 2e-5, rtol=1e-4, atol=1e-4 * np.linalg.norm(score))


def test_outputs_that_a_part_leaves_out_do_not_count(objectives):
    """A part of one output has the likelihood of that output alone."""
    whole = objectives["gaps"]
    part = whole.with_outputs(["y"])
    x = whole.parameters.to_search(whole.parameters.start)
    noise = {"x": NOISES["slow"], "y": NOISES["brief"]}
    assert part.readings == np.isfinite(np.concatenate(whole.calibration.data.measured)[:, 1]).sum()
    alone = [
        objective.whiten(objective.evaluate(x), noise).log_likelihood for objective in (whole.with_outputs(["x"]), part)
    ]
    assert sum(alone) == pytest.approx(whole.whiten(whole.evaluate(x), noise).log_likelihood, rel=REL)
    assert part.simulations == whole.simulations
