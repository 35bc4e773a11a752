"""Integration of a rig: classical Runge-Kutta steps between exactly located events."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import ceil

import numpy as np
from numpy.typing import NDArray

from aero_bayes.bench.rigs.plant import Law, Plant, Values
from aero_bayes.bench.rigs.signals import Pieces, Signal

FloatArray = NDArray[np.float64]
#: Halvings of a step until an event counts as located.
DEPTH = 26


class Integrator:
    """One rig with its laws.

    Parameters
    ----------
    plant : Plant
    laws : sequence of Law
        In the order in which they add; those that hold a state come last.
    extra : int
        States that the laws bring.
    signals : sequence of Signal
        What the inputs truly are.
    longest : float
        Longest step in s.
    """

    def __init__(
        self, plant: Plant, laws: Sequence[Law], extra: int, signals: Sequence[Signal], longest: float
    ) -> None:
        self._plant, self._laws, self._signals, self._longest = plant, list(laws), list(signals), longest
        self._switching = [law for law in laws if law.switches]
        self._rates = [1.0 / c for c in (*plant.capacity, *([1.0] * extra))]
        self._blank = [0.0] * extra
        self._all_held = all(signal.held for signal in signals)
        self._pieces: list[Pieces] = []
        self._k = 0
        self._now: Values | None = None

    def run(self, grid: FloatArray, start: Sequence[float]) -> FloatArray:
        """States at ``grid`` (increasing, s; holds every break of the signals), shape (n, states)."""
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
            count = max(1, ceil((end - t) / self._longest - 1e-6))
            h = (end - t) / count
            for j in range(count):
                x = self._advance(t + j * h, x, h, 0)
            out[k + 1] = x
        return out

    def _efforts(self, t: float, x: Values, without: Law | None = None) -> list[float]:
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
        """One step, halved until every change of mode is at the end of a piece."""
        new = self._step(t, x, h)
        if not self._switching or not self._wrong(t + h, new):
            return new
        if depth >= DEPTH:
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
