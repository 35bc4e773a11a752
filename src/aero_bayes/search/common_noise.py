"""The noise under which all structures of a search are fitted and compared: that of the best so far, per output.

Where a residual is what a sensor leaves, it is the sensor's noise as estimated. Where structure is left, structures are
fitted by least squares, each output in units of the error that is left in it. So to first order a gain in
log-likelihood is the fall of the sum over outputs of the logarithm of the squared error, by which structures are
compared. A series of ``n`` readings then counts for ``n / tau`` independent ones, where ``tau`` is the residual's
integrated autocorrelation time (composite likelihood: Varin, Reid and Firth, 2011, Statistica Sinica 21, 5): so do the
accuracy of a fit and the width of an interval.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from aero_bayes.arrays import FloatArray
from aero_bayes.check.residual_tests import ResidualReport, check_residuals
from aero_bayes.estimate.local_fit import LocalFitSettings, fit_noise
from aero_bayes.search.models import FitNoise, FittedModel
from aero_bayes.sensors.noise import NoiseKind, OutputNoise
from aero_bayes.sensors.whiteness import residual_correlation_time


@dataclass(frozen=True, eq=False)
class CommonNoise:
    """The noise under which structures are compared."""

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
    """Return the noise of a fit, for all structures that are compared with it."""
    objective, optimum = fitted.model.objective, fitted.optimum
    calibration, parts = objective.calibration, _by_output(fitted)
    white: dict[str, NoiseKind] = {o: "white" for o in parts if calibration.noise.kind(o) == "white"}
    floors_of = {o: max(calibration.data.floors.get(o, 0.0), 1e-7 * _range(fitted, o)) for o in parts}
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
        noise[output] = OutputNoise(max(math.sqrt(square), 1e-300))
    return CommonNoise(FitNoise(noise, shortest), tuple(o for o in parts if o in left), reports)


def _by_output(fitted: FittedModel) -> dict[str, list[tuple[int, FloatArray]]]:
    found: dict[str, list[tuple[int, FloatArray]]] = {}
    for k, series in enumerate(fitted.model.objective.series):
        found.setdefault(series.output, []).append((k, fitted.optimum.evaluation.residual[k]))
    return found


def _range(fitted: FittedModel, output: str) -> float:
    calibration = fitted.model.objective.calibration
    return float(calibration.data.scale[calibration.data.outputs.index(output)])
