"""Draws of a posterior, and the statistics that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Status, status_of
from aero_bayes.estimate.parameter_estimates import Estimate
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.predictive import Predictive
from aero_bayes.estimate.result import Fit
from aero_bayes.sampling.diagnostics import Convergence
from aero_bayes.sensors.noise import OutputNoise


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Draws with their convergence, and the statistics that follow; :class:`Posterior` describes the fields."""

    fit: Fit
    names: tuple[str, ...]
    draws: FloatArray
    log_posterior: FloatArray
    predictive: tuple[Predictive, ...]
    diagnoses: Mapping[str, Convergence]
    converged: bool
    reason: str
    seed: int

    @property
    def calibration(self) -> Calibration:
        """What was fitted to what."""
        return self.fit.calibration

    @property
    def tau(self) -> float:
        """Longest autocorrelation time in steps."""
        return max(d.tau for d in self.diagnoses.values())

    @property
    def r_hat_max(self) -> float:
        """Largest rank-normalised R-hat of any parameter; at most 1.01 is asked for."""
        return max(d.r_hat for d in self.diagnoses.values())

    @property
    def ess_bulk_min(self) -> float:
        """Fewest effective draws for the middle of any parameter."""
        return min(d.ess_bulk for d in self.diagnoses.values())

    @property
    def ess_tail_min(self) -> float:
        """Fewest effective draws for the tails of any parameter."""
        return min(d.ess_tail for d in self.diagnoses.values())

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know before trusting an interval."""
        unfinished = () if self.converged else (f"The sampling has not converged: {self.reason}.",)
        return unfinished + self.fit.warnings

    def samples(self, name: str) -> FloatArray:
        """Return draws of one parameter by ``name`` over all ensembles, in its SI unit, shape (ensembles * draws,)."""
        return self.draws[:, :, self.names.index(name)].ravel()

    @cached_property
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter: median, standard deviation, quantiles; the model's fixed ones included."""
        estimates = dict(self.fit.parameters)
        prior_sd = self.calibration.parameters.prior_sd()
        for column, item in enumerate(self.calibration.parameters):
            if item.name in self.names and estimates[item.name].status is not Status.AT_BOUND:
                estimates[item.name] = self._marginal(estimates[item.name], item, float(prior_sd[column]))
        return estimates

    def _marginal(self, estimate: Estimate, item: Parameter, prior_sd: float) -> Estimate:
        """Estimate a parameter from its draws; its prior has a standard deviation in search coordinates."""
        x = self.samples(item.name)
        axis = np.log(x) if item.scale == "log" else x / (item.upper - item.lower)
        status = self.fit.identifiability.capped(item.name, status_of(float(np.std(axis)) / prior_sd))
        q05, q50, q95 = np.quantile(x, [0.05, 0.5, 0.95]).tolist()
        if status is Status.UNIDENTIFIED:
            note = "the data says no more of it than the prior"
            return replace(estimate, value=q50, status=status, sd=None, q05=None, q50=None, q95=None, note=note)
        # Between two modes the median is a value that fits nothing: the reported one stays.
        value, note = (estimate.value, "the interval is that of all answers") if self.fit.modes else (q50, "")
        return replace(estimate, value=value, status=status, sd=float(np.std(x)), q05=q05, q50=q50, q95=q95, note=note)

    @property
    def noise(self) -> dict[str, OutputNoise]:
        """Noise of each output at the posterior's median."""
        found = {}
        for output, held in self.fit.noise.items():
            parts = {p: f"noise.{output}.{p}" for p in ("sd_white", "sd_ou", "tau")}
            middle = {p: float(np.median(self.samples(n))) for p, n in parts.items() if n in self.names}
            found[output] = OutputNoise(**{**held.__dict__, **middle})
        return found
