"""Relative motion: the stretch of a spring or a damper between two bodies, or between a body and the ground."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from aero_bayes.export.syntax import Call, Name
from aero_bayes.physics.quantities import SPEEDS, unit_in
from aero_bayes.physics.structure import Structure
from aero_bayes.physics.terms import dimension_of_unit

#: Of a force and of a torque.
FORCES = tuple(dimension_of_unit(unit) for unit in ("N", "N.m"))


@dataclass(frozen=True)
class Stretch:
    """A difference ``x`` of two positions, its rate ``v``, and its ends, classes of :attr:`Structure.apart`."""

    x: str
    v: str
    ends: frozenset[str]


def stretch_of(s: Structure, state: str) -> Stretch | None:
    """The stretch that a state is, or is the rate of; None for a state that is the motion of one body."""
    x = next((x for x, rate in s.rates.items() if rate == state), state)
    rate = s.rates.get(x, "")
    if not rate or dimension_of_unit(unit_in(s, rate)) not in SPEEDS:
        return None
    members = set(s.members(x))
    for e in s.flat.equations:
        match e.left, e.right:
            case Name(name, ()), Call("-", (Name(one), Name(two))) if name in members:
                return Stretch(x, rate, frozenset(s.apart.get(end, end) for end in (one, two)))
    return None


def repeats(s: Structure, state: str, driven: Collection[str]) -> bool:
    """Whether a stretch is that of an earlier state, or against the ground and so the motion of the body itself."""
    own = stretch_of(s, state)
    if own is None:
        return False
    bodies = {s.apart.get(x, x) for x, rate in s.rates.items() if rate in s.states and x != own.x}
    if "" in own.ends and own.ends & bodies:
        return True
    earlier = [stretch_of(s, other) for other in driven if s.states.index(other) < s.states.index(state)]
    return any(other is not None and other.ends == own.ends for other in earlier)
