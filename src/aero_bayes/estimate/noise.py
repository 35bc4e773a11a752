"""The noise model of an output: white noise plus an Ornstein-Uhlenbeck process.

The white part describes the sensor. The Ornstein-Uhlenbeck process, a stationary Gauss-Markov process of first order,
describes slow errors of the sensor or of the model. :mod:`aero_bayes.estimate.noise_estimation` estimates both, and
weighs residuals by them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError

NoiseKind = Literal["white", "ou", "auto"]
#: What a user may declare of an output's noise.
DeclaredNoise = Literal["auto", "white", "ou", "relative", "student", "rounded"]

#: Relative difference of two time steps above which the sampling counts as uneven.
_MAX_STEP_DEVIATION = 1e-3


@dataclass(frozen=True)
class OutputNoise:
    """Noise of one output."""

    sd_white: float
    sd_ou: float = 0.0
    tau: float = 0.0
    white_identified: bool = True
    model_error: bool = False

    @property
    def kind(self) -> Literal["white", "ou"]:
        """``ou`` if there is a correlated part."""
        return "ou" if self.sd_ou > 0.0 and self.tau > 0.0 else "white"

    @property
    def sd(self) -> float:
        """Standard deviation of a single reading."""
        return math.hypot(self.sd_white, self.sd_ou)

    def rho(self, interval: float) -> float:
        """Compute the correlation of two readings that are ``interval`` seconds apart."""
        if self.kind == "white":
            return 0.0
        return (self.sd_ou / self.sd) ** 2 * math.exp(-interval / self.tau)

    @property
    def estimated(self) -> tuple[bool, bool, bool]:
        """Which of ``sd_white``, ``sd_ou`` and ``tau`` the data determine."""
        correlated = self.kind == "ou" and not self.model_error
        return (self.white_identified and not self.model_error, correlated, correlated)

    def as_row(self) -> tuple[float, float, float]:
        """Return ``(sd_white, sd_ou, tau)``, as a simulator takes them."""
        return (self.sd_white, self.sd_ou, self.tau)


@dataclass(frozen=True)
class NoiseModel:
    """Which noise each output may have, and which the states have.

    Parameters
    ----------
    default : {"auto", "white", "ou", "relative", "student", "rounded"}
        Of outputs that ``outputs`` does not name; ``auto`` lets the data choose. ``relative`` has the standard
        deviation ``a + b |y|``, ``student`` has heavy tails, ``rounded`` is white, at least as large as the rounding.
    outputs : tuple of (str, kind)
    sd : mapping of str to float, or to a mapping of str to float
        Standard deviation of white noise by output, in its unit, where it is known; one value, or one a recording by
        its name.
    process : mapping of str to float or "estimated"
        Process noise by state: its diffusion in the state's unit over the square root of a second. Each of these states
        gains ``diffusion dW``, with W a Wiener process of its own; the noise of all readings is then white.
    initial_sd : mapping of str to float
        With process noise, how far a state's initial value may be off the model's own: its standard deviation. Other
        states start as without process noise.

    Examples
    --------
    >>> NoiseModel(process={"v": "estimated"}).kind("position")
    'white'
    """

    default: DeclaredNoise = "auto"
    outputs: tuple[tuple[str, DeclaredNoise], ...] = ()
    sd: Mapping[str, float | Mapping[str, float]] = field(default_factory=dict)
    process: Mapping[str, float | Literal["estimated"]] = field(default_factory=dict)
    initial_sd: Mapping[str, float] = field(default_factory=dict)

    def kind(self, output: str) -> NoiseKind:
        """Return the correlation over time that an output's noise may have."""
        declared = self.declared(output)
        if self.process or output in self.sd or declared == "rounded":
            return "white"
        return declared if declared in ("white", "ou") else "auto"

    def spread_kind(self, output: str) -> Literal["auto", "constant", "relative", "student"]:
        """Return how the noise of an output may differ from reading to reading."""
        declared = self.declared(output)
        if self.process or output in self.sd or declared in ("white", "ou", "rounded"):
            return "constant"
        return declared if declared in ("relative", "student") else "auto"

    def sd_by_recording(self, output: str, recordings: Sequence[str]) -> list[float] | None:
        """Return the known standard deviation of an output in each recording; None where it is not declared."""
        known = self.sd.get(output)
        if not isinstance(known, Mapping):
            return None if known is None else [known] * len(recordings)
        for name in recordings:
            if name not in known:
                raise InputError(f"[noise.{output}] sd: no value for recording {name}; there are {', '.join(known)}")
        return [known[name] for name in recordings]

    def declared(self, output: str) -> DeclaredNoise:
        """Return what was declared of an output's noise."""
        return dict(self.outputs).get(output, self.default)


@dataclass(frozen=True, eq=False)
class SampleTimes:
    """When one output of one recording was read."""

    index: NDArray[np.int_]
    time: FloatArray
    interval: float
    even: bool
    spread: FloatArray | None = None

    @classmethod
    def of(cls, time: FloatArray, values: FloatArray, spread: FloatArray | None = None) -> SampleTimes:
        """Take times (n,) at which ``values`` (n,) are not NaN, with the relative spread (n,) of their noise."""
        index = np.flatnonzero(np.isfinite(values))
        seen, own = time[index], None if spread is None else spread[index]
        if seen.size < 2:
            return cls(index, seen, 1.0, True, own)
        steps = np.diff(seen)
        interval = float(np.median(steps))
        slack = max(_MAX_STEP_DEVIATION * interval, 1e-9 * abs(float(seen[-1])))
        return cls(index, seen, interval, bool(np.all(np.abs(steps - interval) <= slack)), own)

    @property
    def size(self) -> int:
        """Number of readings."""
        return int(self.index.size)

    def equalised(self, rows: FloatArray) -> FloatArray:
        """Divide rows (k, n), or one (n,), by the relative spread of each reading: their noise is then even."""
        return rows if self.spread is None else rows / self.spread

    @property
    def duration(self) -> float:
        """Time in s from the first to the last reading."""
        return float(self.time[-1] - self.time[0]) if self.size else 0.0
