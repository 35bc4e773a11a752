"""What a law of a simulated rig is: how its parameters are drawn, and how it is put into the rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from numpy.random import Generator

from simulated_rigs.assembly import Assembly

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Scale:
    """What happens at a place without the law.

    ``spread`` to ``mean`` are of the signal there, ``effort`` is the standard deviation of what changes the state,
    ``time`` how long (s) the signal takes to change by its spread, ``duration`` the recording's length in s;
    ``position`` and ``farthest`` are standard deviation and largest size of the state whose derivative this is, and
    ``difference`` is the standard deviation of the difference to the neighbour (0 where there is none).
    """

    spread: float
    largest: float
    lowest: float
    highest: float
    mean: float
    effort: float
    time: float
    duration: float
    position: float = 0.0
    farthest: float = 0.0
    difference: float = 0.0


#: (generator, size, scale) -> parameters; whatever else it draws is independent of the size.
Draw = Callable[[Generator, float, Scale], dict[str, float]]
#: (assembly, name of the place, parameters) puts the law there.
Install = Callable[[Assembly, str, Parameters], None]


@dataclass(frozen=True)
class LawKind:
    """One law at an ``input``, ``output``, ``balance`` or ``coupling``, and the largest size that makes sense."""

    id: str
    place: str
    draw: Draw
    install: Install
    most: float = 100.0


def listed(family: str, id: str, draw: Draw, install: Install, most: float = 100.0) -> tuple[str, LawKind]:
    """Enter a law under the kind of its place: ``input``, ``output``, ``coupling``, or the family of a balance."""
    place = family if family in ("input", "output", "coupling") else "balance"
    return family, LawKind(id, place, draw, install, most)


def random_sign(rng: Generator) -> float:
    """Draw 1 or -1, each with probability one half."""
    return 1.0 if rng.random() < 0.5 else -1.0
