"""Integration of a rig: classical Runge-Kutta steps between exactly located events."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import ceil, exp

import numpy as np
from numpy.typing import NDArray

from simulated_rigs.plant import HybridTerm, Plant, Values
from simulated_rigs.signals import Pieces, PiecewiseSignal

FloatArray = NDArray[np.float64]
#: Halvings of a step until an event counts as located.
MAX_HALVINGS = 26
#: First step after a jump of an input that decays exponentially, in its time constants.
FIRST_STEP = 0.4
#: Absolute value of a state above which the rig counts as unstable.
MAX_STATE = 1e9


class RigIntegrator:
    """Integrator of one rig with its laws.

    Parameters
    ----------
    plant : Plant
    laws : sequence of HybridTerm
        In the order in which they add; those that hold a state come last.
    extra : int
        States that the laws bring.
    signals : sequence of PiecewiseSignal
        What the inputs truly are.
    longest : float
        Longest step in s.
    """

    def __init__(
        self, plant: Plant, laws: Sequence[HybridTerm], extra: int, signals: Sequence[PiecewiseSignal], longest: float
    ) -> None:
        self._plant, self._laws, self._signals, self._longest = plant, list(laws), list(signals), longest
        self._switching = [law for law in laws if law.switches]
        self._rates = [1.0 / c for c in (*plant.capacity, *([1.0] * extra))]
        self._blank = [0.0] * extra
        self._all_held = all(signal.held for signal in signals)
        self._pieces: list[Pieces] = []
        self._k = 0
        self._now: Values | None = None

    def run(self, grid: FloatArray, start: Sequence[float], slopes: FloatArray | None = None) -> FloatArray:
        """Integrate to ``grid`` (increasing, s; holds every break of the signals): states, shape (n, states).

        ``slopes``, shape (n - 1, 2, states), is filled with the rates at the beginning and end of every interval.
        Raises OverflowError for a rig that runs away.
        """
        out = np.empty((grid.size, len(start)))
        x = list(start)
        out[0] = x
        self._pieces = [signal.pieces(grid) for signal in self._signals]
        held = list(zip(*(piece.base for piece in self._pieces), strict=True))
        times = grid.tolist()
        for k in range(len(times) - 1):
            t, end = times[k], times[k + 1]
            self._k, self._now = k, held[k] if self._all_held else None
            if self._switching:
                self._settle(t, x, first=k == 0)
            if slopes is not None:
                slopes[k, 0] = self._slopes(t, x)
            for h in self._steps(k, t, end):
                x = self._advance(t, x, h, 0)
                t += h
            if slopes is not None:
                slopes[k, 1] = self._slopes(end, x)
            if not all(abs(value) < MAX_STATE for value in x):
                raise OverflowError("a simulated rig runs away")
            out[k + 1] = x
        return out

    def _steps(self, k: int, t: float, end: float) -> list[float]:
        """Step lengths that fill an interval, graded where an input still decays."""
        length, longest = end - t, self._longest
        decaying = [piece for piece in self._pieces if piece.rate and piece.decay[k]]
        if not decaying:
            count = max(1, ceil(length / longest - 1e-6))
            return [length / count] * count
        piece = max(decaying, key=lambda piece: piece.rate)
        steps, since = [], t - piece.start[k]
        while length > 0.0:
            h = min(longest, FIRST_STEP / piece.rate * exp(min(0.2 * piece.rate * since, 50.0)))
            h = length if length < 1.2 * h else h
            steps.append(h)
            length, since = length - h, since + h
        return steps

    def _efforts(self, t: float, x: Values, without: HybridTerm | None = None) -> list[float]:
        u = self._now if self._now is not None else [piece.at(self._k, t) for piece in self._pieces]
        e = self._plant.efforts(x, u) + self._blank
        for law in self._laws:
            if law is not without:
                law.add(t, x, u, e)
        return e

    def _slopes(self, t: float, x: Values) -> list[float]:
        return [a * b for a, b in zip(self._efforts(t, x), self._rates, strict=True)]

    def _step(self, t: float, x: list[float], h: float) -> list[float]:
        half = 0.5 * h
        a = self._slopes(t, x)
        b = self._slopes(t + half, [p + half * q for p, q in zip(x, a, strict=True)])
        c = self._slopes(t + half, [p + half * q for p, q in zip(x, b, strict=True)])
        d = self._slopes(t + h, [p + h * q for p, q in zip(x, c, strict=True)])
        sixth = h / 6.0
        return [p + sixth * (k1 + 2.0 * (k2 + k3) + k4) for p, k1, k2, k3, k4 in zip(x, a, b, c, d, strict=True)]

    def _advance(self, t: float, x: list[float], h: float, depth: int) -> list[float]:
        """Take one step, halved until every change of mode is at the end of a piece."""
        new = self._step(t, x, h)
        if not self._switching or not self._wrong(t + h, new):
            return new
        if depth >= MAX_HALVINGS:
            self._settle(t + h, new)
            return new
        half = 0.5 * h
        return self._advance(t + half, self._advance(t, x, half, depth + 1), half, depth + 1)

    def _wrong(self, t: float, x: Values) -> bool:
        return any(law.wrong(x, partial(self._efforts, t, x, law)) for law in self._switching)

    def _settle(self, t: float, x: list[float], first: bool = False) -> None:
        """Give every law whose mode no longer holds (at the start: every law) the one that does."""
        for law in self._switching:
            efforts = partial(self._efforts, t, x, law)
            if first or law.wrong(x, efforts):
                law.enter(x, efforts)
