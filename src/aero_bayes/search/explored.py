"""What a search over structures is given and what it gives back, as plain objects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.ahead import Task
from aero_bayes.search.models import FittedModel
from aero_bayes.search.score import CommonNoise, Price
from aero_bayes.search.structure import Structure

#: Does tasks of which some are asked for next, and says how far it is.
Precompute = Callable[[Sequence[Task], Callable[[float], None]], None]


@dataclass(frozen=True, eq=False)
class Library:
    """What may be added to a model.

    Parameters
    ----------
    groups : sequence of sequences of str
        Terms that are best simulated on one model.
    refines : mapping of str to str
        For each term that refines another, that one.
    curves : tuple of str
        Terms that learn a curve.
    """

    groups: Sequence[Sequence[str]]
    refines: Mapping[str, str]
    curves: tuple[str, ...]

    @property
    def terms(self) -> tuple[str, ...]:
        return tuple(id_ for group in self.groups for id_ in group)

    def group_of(self, id_: str) -> tuple[str, ...]:
        return next(tuple(group) for group in self.groups if id_ in group)


@dataclass(frozen=True, eq=False)
class Work:
    """Where a search works: the time that it has, helpers, and who is told.

    ``late`` says whether the time is up; ``ahead`` gives helpers tasks that are asked for next, on which no result
    depends; ``tell`` is told what is being done and how far it is.
    """

    late: Callable[[], bool] = lambda: False
    ahead: Precompute = lambda tasks, told: None
    tell: Callable[[str, float], None] = lambda what, share: None


def ranked(fits: Iterable[FittedModel], price: Price) -> list[FittedModel]:
    """Fitted models by their score, best first; equal ones by their terms."""
    return sorted(fits, key=lambda f: (-price.score(f), f.structure.terms))


@dataclass(frozen=True, eq=False)
class Explored:
    """All that a search found: every structure fitted, scored under one noise.

    ``promised`` are the gains that the starts of structures promised which were not worth a fit; ``ports`` the port of
    each term.
    ``skipped`` are terms with which the model cannot be simulated; ``ended`` is what was being done when the time was
    up, empty where the search came to its end.
    """

    fits: Mapping[Structure, FittedModel]
    noise: CommonNoise
    price: Price
    floors: Mapping[tuple[str, str], float]
    promised: Mapping[Structure, float]
    ports: Mapping[str, str]
    refines: Mapping[str, str]
    skipped: tuple[str, ...] = ()
    ended: str = ""

    def score(self, structure: Structure) -> float:
        return self.price.score(self.fits[structure])

    @property
    def ranked(self) -> list[FittedModel]:
        """All fits, best first."""
        return ranked(self.fits.values(), self.price)

    @property
    def best(self) -> FittedModel:
        return self.ranked[0]

    @property
    def first_model(self) -> FittedModel:
        """The best fit without any term."""
        return next(f for f in self.ranked if not f.terms)
