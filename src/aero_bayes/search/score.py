"""The one score of all structures under comparison: log-evidence under one noise, less a penalty for each term.

The noise is that of the best structure so far, per output. Where a residual is what a sensor leaves, it is the sensor's
noise as estimated. Where structure is left, structures are fitted by least squares, and a series of ``n`` readings
counts for ``n / tau`` independent ones, where ``tau`` is the residual's integrated autocorrelation time: the likelihood
counts to the power ``1 / tau`` (a coarsened posterior: Miller and Dunson, 2019, JASA 114, 1113; composite likelihood:
Varin, Reid and Firth, 2011, Statistica Sinica 21, 5). So do the weights of several outputs among each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.check.residual_tests import ResidualReport, check_residuals
from aero_bayes.estimate.local_fit import LocalFitSettings, fit_noise
from aero_bayes.search.models import FitNoise, FittedModel
from aero_bayes.sensors.noise import NoiseKind, OutputNoise
from aero_bayes.sensors.whiteness import residual_correlation_time

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CommonNoise:
    """The noise under which structures are compared.

    Parameters
    ----------
    noise : FitNoise
    structured : tuple of str
        Outputs whose residual sensors do not explain.
    reports : tuple of ResidualReport
        Of the residual that the noise was taken from, under the noise as estimated.
    """

    noise: FitNoise
    structured: tuple[str, ...]
    reports: tuple[ResidualReport, ...]

    @property
    def adequate(self) -> bool:
        """Whether the best structure leaves only noise in every output."""
        return not self.structured

    @property
    def exact(self) -> bool:
        """Whether nothing but rounding is left: no term could explain more."""
        return all(report.exact for report in self.reports)


def common_noise(fitted: FittedModel, floors: Mapping[tuple[str, str], float]) -> CommonNoise:
    """The noise of a fit, for all structures that are compared with it.

    Parameters
    ----------
    fitted : FittedModel
    floors : mapping of (recording, output) to float
        FitNoise floors of the readings, in the output's unit, where they are known.
    """
    objective, optimum = fitted.model.objective, fitted.optimum
    calibration, parts = objective.calibration, _by_output(fitted)
    white: dict[str, NoiseKind] = {o: "white" for o in parts if calibration.noise.kind(o) == "white"}
    floors_of = {o: max(calibration.floors.get(o, 0.0), 1e-7 * _range(fitted, o)) for o in parts}
    # The correlation time of sensor noise is limited; slower residuals are model error.
    estimated = fit_noise(objective, optimum.evaluation.residual, LocalFitSettings(kinds=white, floors=floors_of))
    reports = check_residuals(calibration, objective.series, replace(optimum, noise=estimated), floors)
    left = {r.output for r in reports if r.verdict == "structured"}
    residuals = {output: [r for _, r in own] for output, own in parts.items()}
    counts = {output: sum(r.size for r in rs) for output, rs in residuals.items()}
    times_of = {o: residual_correlation_time(rs) if o in left else 1.0 for o, rs in residuals.items()}
    shortest = min(times_of.values())
    noise = dict(estimated)
    for output in left:
        square = sum(float(r @ r) for r in residuals[output]) / counts[output]
        noise[output] = OutputNoise(max(math.sqrt(square * times_of[output] / shortest), 1e-300))
    return CommonNoise(FitNoise(noise, shortest), tuple(o for o in parts if o in left), reports)


def _by_output(fitted: FittedModel) -> dict[str, list[tuple[int, FloatArray]]]:
    found: dict[str, list[tuple[int, FloatArray]]] = {}
    for k, series in enumerate(fitted.model.objective.series):
        found.setdefault(series.output, []).append((k, fitted.optimum.evaluation.residual[k]))
    return found


def _range(fitted: FittedModel, output: str) -> float:
    calibration = fitted.model.objective.calibration
    return float(calibration.scale[calibration.outputs.index(output)])


@dataclass(frozen=True)
class Penalty:
    """Penalty on log-evidence for the number of candidates that were tried (multiple comparisons).

    Parameters
    ----------
    candidates : int
        Terms that were offered; each term costs the logarithm of their number.
    margin : float
        Further cost of each term.
    extra : tuple of str
        Terms with twice the margin: a refinement adds detail, and a curve fits almost anything.
    parameters : int
        Parameters that may be freed; each freed one costs the logarithm of their number and the margin.
    """

    candidates: int
    margin: float
    extra: frozenset[str]
    parameters: int = 1

    @property
    def price_of_term(self) -> float:
        """Penalty of one ordinary term."""
        return math.log(max(self.candidates, 1)) + self.margin

    def of_term(self, id_: str) -> float:
        """Penalty of one term."""
        return self.price_of_term + (self.margin if id_ in self.extra else 0.0)

    def score(self, fitted: FittedModel) -> float:
        """Log-evidence less the penalty.

        A parameter of the first model that ends on a bound costs the margin, since the model
        expects it to act.
        """
        freed = len(fitted.structure.freed) * (math.log(max(self.parameters, 1)) + self.margin)
        off = self.margin * fitted.parameters_on_bound
        return fitted.log_evidence - sum(self.of_term(t) for t in fitted.terms) - freed - off
