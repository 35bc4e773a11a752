"""What a rig is to the integrator: balances, and laws that add to them or constrain them.

Every state x_i obeys c_i dx_i/dt = e_i: a mass and the sum of its forces, an area and the sum of its flows; c_i = 1
and e_i a rate for a state that only follows others. A law adds to e_i, holds its state (friction that sticks, a tank
that is full) or brings states of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

Values = Sequence[float]


@dataclass(frozen=True)
class Plant:
    """The equations of one rig with its parameters in them.

    Parameters
    ----------
    capacity : tuple of float
        c_i of every state.
    efforts : callable
        (states, inputs) -> e_i of every state.
    shown : tuple of int
        The states that are measured.
    """

    capacity: tuple[float, ...]
    efforts: Callable[[Values, Values], list[float]]
    shown: tuple[int, ...]


class HybridTerm:
    """A term with a mode that changes at events; the formulas hold within one mode and are smooth there."""

    #: Whether the law has modes at all.
    switches = False

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        """Add the law's share to the efforts ``e``."""

    def wrong(self, x: Values, e: Callable[[], Values]) -> bool:
        """Return whether the present mode no longer holds; ``e()`` gives the efforts without this law."""
        return False

    def enter(self, x: list[float], e: Callable[[], Values]) -> None:
        """Take the mode that holds at ``x``, and put ``x`` where that mode starts."""


class SmoothTerm(HybridTerm):
    """A smooth term: ``add(t, x, u, e)``."""

    def __init__(self, add: Callable[[float, Values, Values, list[float]], None]) -> None:
        self._add = add

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        self._add(t, x, u, e)


class PiecewiseTerm(HybridTerm):
    """A term that is smooth in each of three regions: below, within and above a band of some quantity.

    Parameters
    ----------
    quantity : callable
        State -> the quantity.
    half_width : float
        Half the band's width; 0 where the formula changes with the sign.
    add : callable
        (region, t, x, u, e), region being -1, 0 or 1.
    slack : float
        How far the quantity may stand on the wrong side before it is an event.
    """

    switches = True

    def __init__(
        self,
        quantity: Callable[[Values], float],
        half_width: float,
        add: Callable[[int, float, Values, Values, list[float]], None],
        slack: float,
    ) -> None:
        self._quantity, self._half_width, self._add, self._slack = quantity, half_width, add, slack
        self._region = 0

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        self._add(self._region, t, x, u, e)

    def wrong(self, x: Values, e: Callable[[], Values]) -> bool:
        value = self._quantity(x)
        if self._region:
            return value * self._region < self._half_width - self._slack
        return abs(value) > self._half_width + self._slack

    def enter(self, x: list[float], e: Callable[[], Values]) -> None:
        value = self._quantity(x)
        self._region = 0 if abs(value) <= self._half_width else 1 if value > 0.0 else -1


class DryFriction(HybridTerm):
    """A level that opposes motion and holds what stands still until pushed harder than that.

    Parameters
    ----------
    index : int
        The state it acts on.
    level : callable
        (direction, speed) -> level, speed not negative; at zero speed the push that breaks it loose.
    slack : float
        How far the state may stand on the wrong side of zero before it is an event.
    """

    switches = True

    def __init__(self, index: int, level: Callable[[int, float], float], slack: float) -> None:
        self._index, self._level, self._slack = index, level, slack
        self._direction = 0

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        direction = self._direction
        if direction:
            # Where rounding has left the wrong sign the speed counts as zero.
            e[self._index] -= direction * self._level(direction, max(direction * x[self._index], 0.0))
        else:
            e[self._index] = 0.0

    def wrong(self, x: Values, e: Callable[[], Values]) -> bool:
        if self._direction:
            return x[self._index] * self._direction < -self._slack
        push = e()[self._index]
        return abs(push) > self._level(1 if push > 0.0 else -1, 0.0)

    def enter(self, x: list[float], e: Callable[[], Values]) -> None:
        speed = x[self._index]
        if abs(speed) > 10.0 * self._slack and speed * self._direction >= 0.0:
            self._direction = 1 if speed > 0.0 else -1
            return
        x[self._index] = 0.0
        push = e()[self._index]
        direction = 1 if push > 0.0 else -1
        self._direction = direction if abs(push) > self._level(direction, 0.0) else 0


class Overflow(HybridTerm):
    """A storage that cannot rise above a rim; a share of what spills goes to a neighbour (or none)."""

    switches = True

    def __init__(self, index: int, rim: float, neighbour: int | None, share: float, slack: float) -> None:
        self._index, self._rim, self._neighbour, self._share, self._slack = index, rim, neighbour, share, slack
        self._full = False

    def add(self, t: float, x: Values, u: Values, e: list[float]) -> None:
        if self._full:
            spilled, e[self._index] = e[self._index], 0.0
            if self._neighbour is not None:
                e[self._neighbour] += self._share * spilled

    def wrong(self, x: Values, e: Callable[[], Values]) -> bool:
        if self._full:
            return e()[self._index] < 0.0
        return x[self._index] > self._rim + self._slack

    def enter(self, x: list[float], e: Callable[[], Values]) -> None:
        if x[self._index] >= self._rim - self._slack:
            x[self._index] = self._rim
            self._full = e()[self._index] >= 0.0
        else:
            self._full = False
