"""Evidence of a fitted model: Laplace's approximation, and importance sampling from it, which says if it holds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from aero_bayes.inference.importance import Weighted, importance_sample
from aero_bayes.inference.moves import HeavyTail
from aero_bayes.inference.result import Fit
from aero_bayes.inference.target import JointTarget, NoiseLayout, Target
from aero_bayes.simulation.interface import Simulator

FloatArray = NDArray[np.float64]


def laplace_evidence(fit: Fit) -> float:
    """Log-evidence of a fit, noise parameters integrated out with the rest (MacKay, 2003, chapter 27)."""
    layout = NoiseLayout.of(fit.calibration, fit.noise)
    noise = fit.laplace.mean[fit.laplace.parameters :]
    determinant = float(np.linalg.slogdet(fit.laplace.covariance)[1])
    volume = 0.5 * (len(fit.laplace.mean) * math.log(2.0 * math.pi) + determinant)
    return fit.log_posterior + float(layout.log_prior(noise[None])[0]) + volume


def joint_target(fit: Fit, simulator: Simulator) -> JointTarget:
    """Log-posterior over the free and the noise parameters of a fit."""
    target = Target(fit.calibration, simulator, fit.values, fit.free)
    return JointTarget(target, NoiseLayout.of(fit.calibration, fit.noise))


def importance_posterior(
    fit: Fit, simulator: Simulator, size: int, rng: np.random.Generator, *, rounds: int = 2, dof: float = 8.0
) -> Weighted:
    """Posterior of a fit by importance sampling from its Laplace approximation.

    Parameters
    ----------
    fit : Fit
    simulator : Simulator
        Of the fit's own calibration.
    size : int
        Draws of the last round.
    rng : Generator
    rounds : int
        The earlier rounds, each of a quarter of the draws, refit the proposal to the weighted draws.
    dof : float
        Degrees of freedom of the Student proposal.

    Returns
    -------
    Weighted
        Points are search coordinates of the free parameters, then logarithms of the noise parameters. Trust it only
        where ``reliable``; otherwise sample.
    """
    density = joint_target(fit, simulator)
    proposal = HeavyTail.of(fit.laplace.mean, fit.laplace.covariance, dof)
    for _ in range(rounds - 1):
        pilot = importance_sample(density, proposal, max(size // 4, 100), rng)
        if pilot.ess > 5.0 * density.dimension:
            proposal = HeavyTail.of(pilot.mean, pilot.covariance, dof)
    return importance_sample(density, proposal, size, rng)
