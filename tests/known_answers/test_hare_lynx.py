"""The posterior of the Lotka-Volterra model of hares and lynxes, against means as Stan has them.

Data, model and priors are those of posteriordb's ``hudson_lynx_hare-lotka_volterra`` (Carpenter, 2018; pelts of the
Hudson's Bay Company, 1900-1920). Its published means come from 10,000 draws of Stan.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, NoiseModel, Normal
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.log_posterior import JointLogPosterior, LogPosterior, NoiseLayout
from aero_bayes.estimate.mcmc import run_chain
from aero_bayes.estimate.moves import WarpedStudentT
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import ParameterTarget, StartTarget
from aero_bayes.simulation.model import Model

HARE = (30, 47.2, 70.2, 77.4, 36.3, 20.6, 18.1, 21.4, 22, 25.4, 27.1, 40.3, 57, 76.6, 52.3, 19.5, 11.2, 7.6, 14.6, 16.2)
HARE = (*HARE, 24.7)
LYNX = (4, 6.1, 9.8, 35.2, 59.4, 41.7, 19, 13, 8.3, 9.1, 7.4, 8, 12.3, 19.5, 45.7, 51.1, 29.7, 15.8, 9.7, 10.1, 8.6)
YEARS = np.arange(21.0)
#: Means of alpha, beta, gamma, delta, both populations at the start and both sigmas, and their errors.
PUBLISHED = (0.5468645, 0.02774729, 0.8000954, 0.02408592, 34.03522, 5.935897, 0.2480569, 0.2510169)
PUBLISHED_ERROR = (6.2627e-4, 4.1160e-5, 8.8460e-4, 3.5005e-5, 0.029308, 5.3387e-3, 4.3934e-4, 4.3953e-4)


def test_means_are_those_of_stan(tmp_path, trust):
    """The project's own sampler through an FMU."""
    source = Path(__file__).parent / "models" / "HareLynx.mo"
    model = Model.load(export_fmu("HareLynx", tmp_path / "HareLynx.fmu", sources=[source]))
    pelts = {"log_hare": np.log(HARE), "log_lynx": np.log(LYNX)}
    rates = [("alpha", 1.0, 0.5), ("beta", 0.05, 0.05), ("gamma", 1.0, 0.5), ("delta", 0.05, 0.05)]
    first = [0.5, 0.03, 0.8, 0.02]
    items = [
        Parameter(n, "1", v, 1e-4, 10.0, Normal(m, s), "log", n, ParameterTarget(n))
        for (n, m, s), v in zip(rates, first, strict=True)
    ]
    items += [
        Parameter(state, "1", v, -3.0, 8.0, Normal(np.log(10.0), 1.0), "linear", state, StartTarget(state))
        for state, v in zip([s.name for s in model.states], np.log([30.0, 4.0]), strict=True)
    ]
    calibration = calibrate(
        [Recording("pelts", YEARS, {}, pelts)], model, ParameterSet(tuple(items)),
        noise=NoiseModel("white"), settings=CalibrationSettings(delay="none"),
    )  # fmt: skip
    settings = FitSettings(method="local", staged=False)
    found = fit_calibration(calibration, lambda p: open_simulator(p, workers=0), settings)
    with open_simulator(calibration.problem(), workers=0) as simulator:
        layout = replace(NoiseLayout.of(calibration.data, found.noise), centre=np.full((2, 3), -1.0), sigma=1.0)
        density = JointLogPosterior(LogPosterior(calibration, simulator, found.values, found.free), layout)
        proposal = WarpedStudentT.of(found.laplace.mean, found.laplace.covariance, 8.0)
        chain = run_chain(density, proposal, SampleSettings(ess=2000.0, max_steps=6000, max_minutes=15.0), seed=5)
    assert chain.converged, chain.reason
    points = chain.points.reshape(-1, 8)
    values = calibration.parameters.from_search(points[:, :6])
    values[:, 4:] = np.exp(values[:, 4:])
    draws, ess = np.hstack([values, np.exp(points[:, 6:])]), np.array([d.ess_bulk for d in chain.diagnoses])
    sd = draws.std(axis=0)
    trust("stan", np.max(np.abs(draws.mean(axis=0) - PUBLISHED) / sd))
    allowed = 0.03 * sd + 4.0 * np.hypot(sd / np.sqrt(ess), PUBLISHED_ERROR)
    assert np.all(np.abs(draws.mean(axis=0) - PUBLISHED) < allowed)
