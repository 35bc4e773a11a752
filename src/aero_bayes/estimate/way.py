"""How a search makes its steps on ground whose shape is partly known: on one side of a kink, straight or bent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: What a coordinate may be off a kink to stand at it, as a share of the way to the next.
BESIDE = 1e-3
#: Length of a Newton step in a logarithm from which it matters whether steps are straight in the logarithm or in its
#: value, and the share of its promise that a step must keep for the next one to be made in the same way.
FAR, GOOD = 0.3, 0.75

#: Bounds (p,) of the surroundings of a point (p,) in which the ground is smooth.
Walls = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class Shape:
    """What is known of a ground beforehand.

    Parameters
    ----------
    walls : callable, optional
        Where it has kinks. After a step beyond them was refused, steps end there at the latest, until one leaves the
        kink that the search stood at.
    logs : ndarray of bool, shape (p,), optional
        Coordinates that are logarithms: where a valley is curved in them it may be straight in their values.
    """

    walls: Walls | None = None
    logs: NDArray[np.bool_] | None = None


class Way:
    """How a step is made: inside the box, on one side of a kink, straight in the coordinates or in the values."""

    def __init__(self, low: FloatArray, high: FloatArray, shape: Shape) -> None:
        self.low, self.high, self.shape = low, high, shape
        self._logs = shape.logs if shape.logs is not None else np.zeros(low.size, dtype=bool)
        self._confined = self._straight = self._turned = False

    def _near(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.shape.walls(point) if self.shape.walls is not None else (self.low, self.high)

    @property
    def _bent(self) -> NDArray[np.bool_]:
        return self._logs & self._straight

    def room(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far a step may go from a point."""
        low, high = self.low - point, self.high - point
        if self._confined:
            near = self._near(point)
            low, high = np.maximum(low, near[0] - point), np.minimum(high, near[1] - point)
        bent = self._bent
        low[bent], high[bent] = np.expm1(low[bent]), np.expm1(high[bent])
        return low, high

    def ahead(self, point: FloatArray, step: FloatArray) -> FloatArray:
        """Where a step leads to."""
        bent, there = self._bent, point + step
        there[bent] = point[bent] + np.log1p(step[bent])
        return np.clip(there, self.low, self.high)

    def turns(self, point: FloatArray, refused: FloatArray, newton: FloatArray) -> bool:
        """Whether, a step having been refused, there is another way to make it."""
        low, high = self._near(point)
        if not self._confined and np.any((refused < low) | (refused > high)):
            self._confined = True
            return True
        if self._turned or not self._is_far(newton):
            return False
        self._straight, self._turned = not self._straight, True
        return True

    def went(self, point: FloatArray, there: FloatArray, newton: FloatArray, ratio: float) -> None:
        """A step was taken, and kept so much of its promise."""
        self._turned = False
        self._confined = self._confined and self._stays(point, there)
        if ratio < GOOD and self._is_far(newton):
            self._straight = not self._straight

    def _is_far(self, newton: FloatArray) -> bool:
        """Whether the way to the bottom is so far that the two ways differ."""
        return bool(np.any(np.abs(newton[self._logs]) > FAR))

    def _stays(self, point: FloatArray, there: FloatArray) -> bool:
        """Whether a step went along a kink."""
        low, high = self._near(point)
        walled = np.isfinite(low)
        x, low, high = there[walled], low[walled], high[walled]
        little = BESIDE * (high - low)
        beside = (x <= low + little) | (x >= high - little)
        return bool(np.any(beside & (np.abs(x - point[walled]) <= little)))
