"""Statistics of a fit: its errors, likelihood, criterion and simulations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate import cost as costs
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.laplace import Laplace
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import Outcome

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """An optimum with its residuals, and the statistics that follow; :class:`Fit` describes the fields."""

    calibration: Calibration
    optimum: Optimum
    laplace: Laplace
    residuals: tuple[FloatArray, ...]
    outcomes: Mapping[Outcome, int]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that were fitted, length m."""
        return self.calibration.outputs

    @property
    def noise(self) -> Mapping[str, OutputNoise]:
        """Noise of each output."""
        return self.optimum.noise

    @property
    def covariance(self) -> FloatArray:
        """Of the free columns, then of the noise, in search coordinates."""
        return self.laplace.covariance

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm of the likelihood at the fit."""
        return self.optimum.log_likelihood

    @property
    def reason(self) -> Stop:
        """Why the search ended."""
        return self.optimum.reason

    @property
    def cost_eq6(self) -> float:
        """Sum of squared errors (the paper's Eq. 6)."""
        return costs.eq6(self.residuals)

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square error by output over all recordings."""
        return costs.rms_overall(self.residuals, self.outputs)

    @property
    def rms_by_recording(self) -> Mapping[str, Mapping[str, float]]:
        """Root mean square error in the output's SI unit, by recording and output."""
        return costs.rms_table(self.residuals, self.calibration.names, self.outputs)

    @property
    def bic(self) -> float:
        """Bayesian information criterion, free and noise parameters counted (smaller is better)."""
        return -2.0 * self.log_likelihood + len(self.laplace.mean) * float(np.log(self.calibration.counts.sum()))

    @property
    def failures(self) -> dict[str, int]:
        """Simulations by how they ended."""
        return {outcome.key: count for outcome, count in self.outcomes.items()}
