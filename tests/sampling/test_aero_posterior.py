"""The whole way on the AERO FMU: truths of the simulated bench are found again, and real data is judged fairly."""

from __future__ import annotations

import json
from pathlib import Path

import arviz as az
import h5py
import numpy as np
import pytest
from aero_recordings import read_aero

from aero_bayes.data import Recording
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.posterior import Posterior
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.sample import sample
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model
from simulated_rigs.aero import Truth, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.kinds import AERO
from simulated_rigs.sensors import SensorNoise, white

REAL = Path(__file__).parents[3] / "shared" / "data" / "aero_step_16v5_1khz.csv"
FREE = ("R_a", "c_m", "J_r", "k_d", "k_t", "D_p", "K_sp")
TRUTH = AERO.parameters | {
    "R_a": 8.9, "c_m": 0.040, "J_r": 4.4e-6, "k_d": 2.6e-8, "k_t": 2.7e-7, "D_p": 0.0078, "K_sp": 0.035,
}  # fmt: skip
#: What the package holds since only a sum (of moments of inertia) or a product (thrust by lever) is seen.
STANDS_WITH = {"J_r": "J_s held", "k_t": "D_t held"}
SETTINGS = FitSettings(pso=SwarmSettings(particles=24, iterations=40))


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Model]:
    folder = tmp_path_factory.mktemp("fmu")
    return {
        name: Model.load(export_fmu(f"Aero.Systems.{name}", folder / f"{name}.fmu", compiler="embedded"))
        for name in ("OneDof", "HalfQuad")
    }


def recording(truth: Truth, sensors: dict[str, SensorNoise] | None = None) -> Recording:
    rng = np.random.default_rng(31)
    return simulate_recording(truth, paper_step(), sensors or white(1.0), rng, duration=30.0, rate_hz=50.0)


@pytest.fixture(scope="module")
def found(models: dict[str, Model]) -> Fit:
    return fit(recording(Truth((), 0.006, TRUTH)), models["OneDof"], settings=SETTINGS, workers=1)


@pytest.fixture(scope="module")
def posterior(found: Fit) -> Posterior:
    return sample(found, settings=SampleSettings(max_steps=1000, ess=500, predictive=40), workers=1)


def test_the_truth_lies_where_the_laplace_approximation_says(found: Fit) -> None:
    assert found.reason.converged
    for name in FREE:
        estimate = found[name]
        assert estimate.status is (Status.WEAK if name in STANDS_WITH else Status.IDENTIFIED)
        assert STANDS_WITH.get(name, "") in estimate.note
        assert abs(estimate.value - TRUTH[name]) < 4.9 * estimate.sd, name
    assert abs(found["input_delay"].value - 0.006) < 4.9 * found["input_delay"].sd
    assert found.noise["omega_m"].kind == "white"
    assert found.noise["theta"].sd == pytest.approx(2e-3, rel=0.1)
    assert found.warnings == ()
    assert found["J_p"].status is Status.FIXED
    assert found.failures["completed"] > 0


@pytest.mark.long
def test_posterior_agrees_with_laplace_and_is_written_whole(posterior: Posterior, tmp_path: Path) -> None:
    assert posterior.converged
    assert posterior.r_hat_max <= 1.01
    assert posterior.steps >= 10 * posterior.tau
    assert posterior.ess_bulk_min >= 1000.0
    for name in FREE:
        one, two = posterior.fit[name], posterior[name]
        assert two.sd == pytest.approx(one.sd, rel=0.25), name
        assert abs(two.value - one.value) < 0.35 * one.sd, name
    written = json.loads(json.dumps(posterior.to_dict()))
    assert written["mcmc"]["ensembles"] == 4
    assert written["parameters"]["R_a"]["q05"] < written["parameters"]["R_a"]["q95"]
    path = posterior.save(tmp_path / "posterior.nc")
    assert path.stat().st_size < 5e6
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
    data = az.from_netcdf(path)
    with h5py.File(path) as file:
        for group in ("posterior", "log_likelihood", "posterior_predictive", "observed_data", "sample_stats"):
            assert group in file, group
    np.testing.assert_allclose(data["posterior"]["R_a"].values.ravel(), posterior.samples("R_a"))


def test_predictive_band_holds_its_share_of_the_readings(posterior: Posterior) -> None:
    band = posterior.predictive[0]
    measured = posterior.calibration.data.measured[0]
    share = np.mean((measured > band.lower) & (measured < band.upper), axis=0)
    np.testing.assert_allclose(share, 0.9, atol=0.04)


@pytest.mark.long
@pytest.mark.skipif(not REAL.exists(), reason="the measured recordings are not here")
def test_real_step_recording(models: dict[str, Model]) -> None:
    found = fit(read_aero(REAL), models["HalfQuad"], settings=SETTINGS, workers=1)
    assert all(share >= 0.88 for share in found.predict(read_aero(REAL), draws=30).coverage.values())
    assert found.rms["theta"] < 0.0108
    assert found.noise["theta"].model_error
    assert 9.0 < found["R_a"].value < 10.5
    assert 0.003 < found["input_delay"].value < 0.006
    assert found["L_a"].sd is None
