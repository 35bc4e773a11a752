"""Evidence of a fitted model: Laplace's approximation, and importance sampling from it, which says if it holds."""

from __future__ import annotations

import math

import numpy as np

from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.target import NoiseLayout
from aero_bayes.sampling.importance import WeightedSample, adaptive_importance_sample
from aero_bayes.sampling.moves import WarpedStudentT
from aero_bayes.simulation.interface import Simulator

#: Pareto k of the importance weights below which no further round is made.
MAX_PARETO_K = 0.6


def laplace_evidence(fit: Fit) -> float:
    """Compute the log-evidence of a fit, noise parameters integrated out with the rest (MacKay, 2003, chapter 27)."""
    layout = NoiseLayout.of(fit.calibration.data, fit.noise)
    noise = fit.laplace.mean[fit.laplace.parameters :]
    determinant = float(np.linalg.slogdet(fit.laplace.covariance)[1])
    volume = 0.5 * (len(fit.laplace.mean) * math.log(2.0 * math.pi) + determinant)
    return fit.log_posterior + float(layout.log_prior(noise[None])[0]) + volume


def importance_posterior(
    fit: Fit, simulator: Simulator, size: int, rng: np.random.Generator, *, rounds: int = 8, dof: float = 8.0
) -> WeightedSample:
    """Sample the posterior of a fit by importance from its Laplace approximation, improved from round to round."""
    first = WarpedStudentT.of(fit.laplace.mean, fit.laplace.covariance, dof)

    def enough(found: WeightedSample) -> bool:
        return found.pareto_k < MAX_PARETO_K and found.ess > 0.2 * size

    return adaptive_importance_sample(
        fit.joint_target(simulator), first, -(-size // 2), rng, enough=enough, rounds=rounds
    )
