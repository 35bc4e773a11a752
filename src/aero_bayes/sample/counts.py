"""The posterior with the exact likelihood of an encoder's counts in place of the Gaussian one."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import InputError
from aero_bayes.estimate.target import JointTarget
from aero_bayes.sensors.counts import interval_log_density

FloatArray = NDArray[np.float64]
_LOG_2PI = math.log(2.0 * math.pi)
#: Draws simulated at once, so that trajectories stay within memory.
BATCH = 64


class EncoderDensity:
    """Log-posterior in which outputs in ``steps`` (quanta by name) have the exact likelihood of their counts.

    The noise's white standard deviation is then that before rounding. Outputs with correlated noise cannot be treated
    so: their counts are no longer independent.

    Raises
    ------
    InputError
        For an output that was not fitted, or whose noise is correlated.
    """

    def __init__(self, joint: JointTarget, steps: Mapping[str, float]) -> None:
        self.joint, self.steps = joint, steps
        self.names = joint.names
        outputs = joint.target.calibration.outputs
        for name in steps:
            if name not in outputs:
                raise InputError(f"{name} was not fitted; the fit has {', '.join(outputs)}")
            if f"noise.{name}.sd_ou" in joint.names or f"noise.{name}.sd_white" not in joint.names:
                raise InputError(f"{name}: counts have an exact likelihood only where the noise is white")

    @property
    def dimension(self) -> int:
        return self.joint.dimension

    def __call__(self, points: FloatArray) -> FloatArray:
        """Log-posterior, shape (n,), at points (n, d)."""
        points = np.asarray(points, dtype=np.float64)
        total = self.joint(points)
        for first in range(0, len(points), BATCH):
            part = np.arange(first, min(first + BATCH, len(points)))
            part = part[np.isfinite(total[part])]
            if part.size:
                total[part] += self._difference(points[part])
        return total

    def _difference(self, points: FloatArray) -> FloatArray:
        """Exact minus Gaussian log-likelihood of the counted outputs, shape (n,)."""
        target = self.joint.target
        f = len(target.free)
        result = target.simulator.simulate(target.values(points[:, :f]))
        total = np.zeros(len(points))
        for name, step in self.steps.items():
            column = target.calibration.outputs.index(name)
            sd = np.exp(points[:, self.names.index(f"noise.{name}.sd_white")])[:, None]
            for measured, outputs in zip(target.calibration.measured, result.outputs, strict=True):
                reading, predicted = measured[None, :, column], outputs[:, :, column]
                z = (reading - predicted) / sd
                gaussian = np.where(np.isfinite(z), -0.5 * (z**2 + _LOG_2PI) - np.log(sd), 0.0)
                total += np.sum(interval_log_density(reading, predicted, sd, step) - gaussian, axis=1)
        return np.where(np.isnan(total), -np.inf, total)
