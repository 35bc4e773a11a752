"""The posterior of the Lotka-Volterra model of hares and lynxes, against two independent references.

Data, model and priors are those of posteriordb's ``hudson_lynx_hare-lotka_volterra`` (Carpenter, 2018; pelts of the
Hudson's Bay Company, 1900-1920). Its published means come from 10,000 draws of Stan. Quantiles are compared with
importance sampling over a Runge-Kutta integration written here.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import approx_fprime, minimize

from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, NoiseModel, Normal
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.mcmc import run_chain
from aero_bayes.estimate.moves import WarpedStudentT
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.target import JointTarget, NoiseLayout, Target
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
LEVELS = np.array([0.05, 0.25, 0.5, 0.75, 0.95])


def populations(x: np.ndarray, steps: int = 8) -> np.ndarray:
    """Logarithms of both populations every year by the classical Runge-Kutta method: (n, 8) to (21, 2, n)."""
    alpha, beta, gamma, delta = np.exp(x[:, :4]).T

    def slope(z):
        return np.stack([alpha - beta * np.exp(z[1]), delta * np.exp(z[0]) - gamma])

    z = x[:, 4:6].T.copy()
    out, h = [z.copy()], 1.0 / steps  # good to 1e-5 at the mode
    for _ in YEARS[1:]:
        for _ in range(steps):
            k1 = slope(z)
            k2 = slope(z + 0.5 * h * k1)
            k3 = slope(z + 0.5 * h * k2)
            z = z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(z + h * k3))
        out.append(z.copy())
    return np.stack(out)


def log_posterior(x: np.ndarray) -> np.ndarray:
    """Stan's density over the logarithms of all eight parameters, (n, 8) to (n,), up to a constant."""
    with np.errstate(over="ignore", invalid="ignore"):
        rest = (np.log([HARE, LYNX]).T[:, :, None] - populations(x)) / np.exp(x[:, 6:8]).T
        data = -0.5 * np.sum(rest**2, axis=(0, 1)) - 21.0 * x[:, 6:8].sum(axis=1)
    theta = np.exp(x[:, :4])
    rates = -0.5 * (((theta[:, [0, 2]] - 1.0) / 0.5) ** 2 + ((theta[:, [1, 3]] - 0.05) / 0.05) ** 2).sum(axis=1)
    starts = -0.5 * ((x[:, 4:6] - np.log(10.0)) ** 2).sum(axis=1)
    sigmas = -0.5 * ((x[:, 6:8] + 1.0) ** 2).sum(axis=1)
    total = data + rates + x[:, :4].sum(axis=1) + starts + sigmas
    return np.where(np.isfinite(total), total, -np.inf)


def importance_draws(size: int) -> np.ndarray:
    """Draws of the posterior by resampling a Student proposal about the mode, (size, 8) on log axes."""
    start = np.log([0.5, 0.03, 0.8, 0.02, 33.0, 6.0, 0.3, 0.3])
    mode = minimize(lambda x: -log_posterior(x[None])[0], start, method="BFGS").x

    def gradient(x):
        return approx_fprime(x, lambda v: -log_posterior(v[None])[0], 1e-6)

    hessian = np.stack([(gradient(mode + e) - gradient(mode - e)) / 2e-3 for e in 1e-3 * np.eye(8)])
    factor = np.linalg.cholesky(np.linalg.inv(0.5 * (hessian + hessian.T)))
    rng, dof = np.random.default_rng(7), 7.0
    normal = rng.standard_normal((size, 8))
    scale = np.sqrt(dof / rng.chisquare(dof, size))
    x = mode + 1.1 * scale[:, None] * normal @ factor.T
    log_proposal = -0.5 * (dof + 8.0) * np.log1p(np.sum((scale[:, None] * normal) ** 2, axis=1) / dof)
    weight = log_posterior(x) - log_proposal
    weight = np.exp(weight - weight.max())
    assert weight.sum() ** 2 / (weight**2).sum() > 0.3 * size
    return x[rng.choice(size, size, p=weight / weight.sum())]


@pytest.fixture(scope="module")
def posterior(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the project's own sampler through an FMU, (n, 8) in natural units, and effective sizes."""
    source = Path(__file__).parent / "models" / "HareLynx.mo"
    model = Model.load(export_fmu("HareLynx", tmp_path_factory.mktemp("fmu") / "HareLynx.fmu", sources=[source]))
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
        density = JointTarget(Target(calibration, simulator, found.values, found.free), layout)
        proposal = WarpedStudentT.of(found.laplace.mean, found.laplace.covariance, 8.0)
        chain = run_chain(density, proposal, SampleSettings(ess=2000.0, max_steps=6000, max_minutes=15.0), seed=5)
    assert chain.converged, chain.reason
    points = chain.points.reshape(-1, 8)
    values = calibration.parameters.from_search(points[:, :6])
    values[:, 4:] = np.exp(values[:, 4:])
    return np.hstack([values, np.exp(points[:, 6:])]), np.array([d.ess_bulk for d in chain.diagnoses])


def test_means_are_those_of_stan(posterior, trust):
    draws, ess = posterior
    sd = draws.std(axis=0)
    trust("stan", np.max(np.abs(draws.mean(axis=0) - PUBLISHED) / sd))
    allowed = 0.03 * sd + 4.0 * np.hypot(sd / np.sqrt(ess), PUBLISHED_ERROR)
    assert np.all(np.abs(draws.mean(axis=0) - PUBLISHED) < allowed)


def test_means_and_quantiles_are_those_of_importance_sampling(posterior):
    draws, ess = posterior
    reference = np.exp(importance_draws(40_000))
    sd = reference.std(axis=0)
    error = 4.0 * np.sqrt(1.0 / ess + 1.0 / 13_000)
    assert np.all(np.abs(draws.mean(axis=0) - reference.mean(axis=0)) < (0.03 + error) * sd)
    mine, theirs = np.quantile(draws, LEVELS, axis=0), np.quantile(reference, LEVELS, axis=0)
    below = np.stack([(reference <= q).mean(axis=0) for q in mine])
    assert np.all(np.abs(below - LEVELS[:, None]) < 0.01 + error * np.sqrt(LEVELS * (1.0 - LEVELS))[:, None])
    assert np.all(np.abs(mine[1:4] - theirs[1:4]) < (0.03 + 1.3 * error) * sd)
