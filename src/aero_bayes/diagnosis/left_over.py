"""What a fit leaves, tested once for all checks of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from aero_bayes.check.residual_tests import ResidualReport, check_residuals, structured_residuals
from aero_bayes.data import noise_floors
from aero_bayes.estimate.result import Fit


@dataclass(frozen=True, eq=False)
class LeftOver:
    """The residuals of a fit with their tests."""

    fit: Fit

    @cached_property
    def floors(self) -> dict[tuple[str, str], float]:
        """Noise floors by recording and output, where they are known."""
        return noise_floors(self.fit.calibration.data.recordings, self.fit.calibration.data.outputs)

    @cached_property
    def reports(self) -> tuple[ResidualReport, ...]:
        """One for each output of each recording."""
        return tuple(check_residuals(self.fit.calibration, self.fit.series, self.fit.optimum, self.floors))

    @property
    def structured(self) -> list[ResidualReport]:
        """Those that are more than noise."""
        return list(structured_residuals(self.reports))
