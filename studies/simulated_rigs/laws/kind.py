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

    Parameters
    ----------
    spread, largest, lowest, highest, mean : float
        Of the signal there (input, output or state): standard deviation, largest absolute value, range, mean.
    effort : float
        Standard deviation of what changes the state.
    time : float
        How long the signal takes to change by its spread, in s.
    duration : float
        Length of the recording in s.
    position, farthest : float
        Standard deviation and largest absolute value of the state whose derivative this is (0 where there is none).
    difference : float
        Standard deviation of the difference to the neighbour.
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


Draw = Callable[[Generator, float, Scale], dict[str, float]]
Install = Callable[[Assembly, str, Parameters, float], None]


@dataclass(frozen=True)
class LawKind:
    """One law.

    Parameters
    ----------
    id, place : str
        ``place`` is ``input``, ``output``, ``balance`` or ``coupling``.
    draw : callable
        (generator, size, scale) -> parameters; whatever else it draws is independent of the size.
    install : callable
        (assembly, name of the place, parameters, slack) puts it there; ``slack`` is how far the signal there may be
        on the wrong side of an event.
    most : float
        The largest size that makes sense.
    """

    id: str
    place: str
    draw: Draw
    install: Install
    most: float = 100.0


def random_sign(rng: Generator) -> float:
    """Draw 1 or -1, each with probability one half."""
    return 1.0 if rng.random() < 0.5 else -1.0
