"""Intervals of one recording's parameters: those of the program, of least squares, and of an MCMC under white noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import emcee
import numpy as np
from numpy.random import Generator

from aero_bayes import Posterior
from aero_bayes.arrays import FloatArray
from aero_bayes.estimate import Fit
from aero_bayes.estimate.target import JointTarget, NoiseLayout, Target
from aero_bayes.simulation import open_simulator

#: Half a central interval of 50 and 90 % of a Gaussian, in standard deviations.
HALF_50, HALF_90 = 0.6744897501960817, 1.6448536269514722
#: Steps of the ensemble sampler that are thrown away and that are kept; its walkers start in Laplace's Gaussian.
BURN_IN, STEPS = 20, 50


@dataclass(frozen=True)
class Intervals:
    """An estimate with its central intervals of 50 and 90 %, in SI units."""

    estimate: float
    half: tuple[float, float]
    most: tuple[float, float]

    def to_list(self) -> list[float]:
        return [self.estimate, *self.half, *self.most]


def intervals_of_fit(fit: Fit) -> dict[str, Intervals]:
    """Return the intervals that ``fit`` reports; parameters without an interval are left out."""
    shown = [name for name, estimate in fit.parameters.items() if estimate.q05 is not None]
    found = gaussian(fit, fit.laplace.covariance)
    return {name: found[name] for name in shown if name in found}


def least_squares_intervals(fit: Fit) -> dict[str, Intervals]:
    """Compute the intervals of a fit under white noise with the covariance that ``curve_fit`` gives.

    ``(J'J)^-1`` times the variance.

    Residuals are in units of their root mean square, output by output.
    """
    slopes = fit.optimum.whitened.slopes
    return gaussian(fit, np.linalg.pinv(slopes @ slopes.T, hermitian=True))


def gaussian(fit: Fit, covariance: FloatArray) -> dict[str, Intervals]:
    """Compute intervals of a Gaussian about the estimate in search coordinates, the free columns first."""
    items = [fit.calibration.parameters.items[j] for j in fit.free]
    found = {}
    for k, item in enumerate(items):
        sd = float(np.sqrt(covariance[k, k]))
        at = fit.laplace.mean[k] + sd * np.array([0.0, -HALF_50, HALF_50, -HALF_90, HALF_90])
        x = (np.exp(at) if item.scale == "log" else at * (item.upper - item.lower)).tolist()
        found[item.name] = Intervals(x[0], (x[1], x[2]), (x[3], x[4]))
    return found


def white_posterior_intervals(fit: Fit, rng: Generator) -> Mapping[str, Intervals]:
    """Compute quantiles of an MCMC posterior (emcee's stretch moves) whose likelihood takes all noise for white."""
    noise = {output: replace(n, model_error=False) for output, n in fit.noise.items()}
    with open_simulator(fit.calibration.problem(), workers=0) as simulator:
        target = Target(fit.calibration, simulator, fit.values, fit.free)
        joint = JointTarget(target, NoiseLayout.of(fit.calibration.data, noise))
        slopes = fit.optimum.whitened.slopes
        covariance = np.zeros((joint.dimension, joint.dimension))
        own = len(fit.free)
        covariance[:own, :own] = np.linalg.pinv(slopes @ slopes.T, hermitian=True)
        counts = [sum(s.sampling.size for s in fit.series if s.output == output) for output in fit.outputs]
        covariance[range(own, joint.dimension), range(own, joint.dimension)] = 0.5 / np.array(counts)
        mean = np.concatenate([fit.laplace.mean[:own], joint.layout.pack(noise)])
        walkers = 2 * joint.dimension + 2
        begin = rng.multivariate_normal(mean, covariance, size=walkers)
        sampler = emcee.EnsembleSampler(walkers, joint.dimension, joint, vectorize=True)
        sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
        sampler.run_mcmc(begin, BURN_IN + STEPS)
        points = sampler.get_chain(discard=BURN_IN, flat=True)[:, :own]
    values = target.parameters.from_search(points)
    return {name: quantiles(column) for name, column in zip(target.parameters.names, values.T, strict=True)}


def intervals_of_draws(posterior: Posterior) -> dict[str, Intervals]:
    """Compute quantiles of the draws of a posterior, for parameters that have an interval."""
    shown = [name for name, estimate in posterior.parameters.items() if estimate.q05 is not None]
    return {name: quantiles(posterior.samples(name)) for name in shown if name in posterior.names}


def quantiles(draws: FloatArray) -> Intervals:
    """Compute median and central intervals of draws (n,)."""
    q = np.quantile(draws, [0.5, 0.25, 0.75, 0.05, 0.95]).tolist()
    return Intervals(q[0], (q[1], q[2]), (q[3], q[4]))
