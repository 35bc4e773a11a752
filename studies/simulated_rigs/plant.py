"""What a rig is to the integrator: balances, terms that add to them, and laws that hold a state.

Every state x_i obeys c_i dx_i/dt = e_i: a mass and the sum of its forces, an area and the sum of its flows; c_i = 1
and e_i a rate for a state that only follows others. A term adds to e; friction that sticks and a tank that is full hold
their state, and change between two modes at events.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

Values = Sequence[float]
#: (t, states, inputs, efforts): adds to the efforts in place.
Term = Callable[[float, Values, Values, list[float]], None]


@dataclass(frozen=True)
class Plant:
    """The equations of one rig: c_i, (states, inputs) -> e_i, and the states that are measured."""

    capacity: tuple[float, ...]
    efforts: Callable[[Values, Values], list[float]]
    shown: tuple[int, ...]


class HoldingLaw(Protocol):
    """A law with modes. ``e()`` gives the efforts without this law."""

    def begin(self, x: Values) -> None:
        """Take the mode of a state at which a run begins."""

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        """Add the law's share in its present mode."""

    def margin(self, x: Values, e: Callable[[], Values]) -> float:
        """Return what is positive while the present mode holds and negative where it does not."""

    def switch(self, x: list[float], e: Callable[[], Values]) -> None:
        """Leave the present mode, and put ``x`` where the next one starts."""


class DryFriction:
    """A level that opposes motion and holds what stands still until it is pushed harder than that.

    ``level`` is a function of direction and speed (not negative); at zero speed it is the push that breaks loose.
    """

    def __init__(self, index: int, level: Callable[[int, float], float]) -> None:
        self._index, self._level = index, level
        self._direction = 0

    def begin(self, x: Values) -> None:
        self._direction = (x[self._index] > 0.0) - (x[self._index] < 0.0)

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        direction = self._direction
        if direction:
            e[self._index] -= direction * self._level(direction, max(direction * x[self._index], 0.0))
        else:
            e[self._index] = 0.0

    def margin(self, x: Values, e: Callable[[], Values]) -> float:
        if self._direction:
            return x[self._index] * self._direction
        push = e()[self._index]
        return self._level(1 if push > 0.0 else -1, 0.0) - abs(push)

    def switch(self, x: list[float], e: Callable[[], Values]) -> None:
        x[self._index] = 0.0
        push = e()[self._index]
        side = 1 if push > 0.0 else -1
        # What stuck is loose now, also where rounding leaves the push just below the level.
        self._direction = side if not self._direction or abs(push) > self._level(side, 0.0) else 0


class Overflow:
    """A storage that cannot rise above a rim; a share of what spills goes to a neighbour (or none)."""

    def __init__(self, index: int, rim: float, neighbour: int | None, share: float) -> None:
        self._index, self._rim, self._neighbour, self._share = index, rim, neighbour, share
        self._full = False

    def begin(self, x: Values) -> None:
        self._full = False

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        if self._full:
            spilled, e[self._index] = e[self._index], 0.0
            if self._neighbour is not None:
                e[self._neighbour] += self._share * spilled

    def margin(self, x: Values, e: Callable[[], Values]) -> float:
        return e()[self._index] if self._full else self._rim - x[self._index]

    def switch(self, x: list[float], e: Callable[[], Values]) -> None:
        x[self._index] = self._rim
        self._full = not self._full
