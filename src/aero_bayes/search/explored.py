"""Input and result of a search over structures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from aero_bayes.parallel import Task
from aero_bayes.search.common_noise import CommonNoise
from aero_bayes.search.comparison import Comparison
from aero_bayes.search.models import FittedModel
from aero_bayes.search.structure import Structure

R = TypeVar("R")


class Mapper(Protocol):
    """Does independent tasks; None in place of the result of those that were not begun because the time was up."""

    def __call__(self, tasks: Sequence[Task[R]], told: Callable[[float], object]) -> list[R | None]: ...


def one_by_one(tasks: Sequence[Task[R]], told: Callable[[float], object]) -> list[R | None]:
    """Do tasks one after the other; ``told`` is the share that is done."""
    found: list[R | None] = []
    for k, task in enumerate(tasks):
        found.append(task.work())
        told((k + 1) / len(tasks))
    return found


@dataclass(frozen=True, eq=False)
class Library:
    """What may be added to a model."""

    groups: Sequence[Sequence[str]]
    refines: Mapping[str, str]
    curves: tuple[str, ...]

    @property
    def terms(self) -> tuple[str, ...]:
        return tuple(id_ for group in self.groups for id_ in group)

    def group_of(self, id_: str) -> tuple[str, ...]:
        return next(tuple(group) for group in self.groups if id_ in group)


@dataclass(frozen=True, eq=False)
class SearchControl:
    """How a search is run: its time limit, the map over independent fits, and the report of its progress.

    ``time_is_up`` says whether the time limit has passed. ``map`` does independent tasks, perhaps in parallel, with the
    same results. ``report`` is called with what is being done and its share."""

    time_is_up: Callable[[], bool] = lambda: False
    map: Mapper = one_by_one
    report: Callable[[str, float], object] = lambda what, share: None


@dataclass(frozen=True, eq=False)
class SearchResult:
    """All that a search found: every structure fitted under one noise, and the best of them.

    ``order`` holds the left-out errors of all by one Newton step. ``ports`` is the port of each term, ``curves`` those
    that are learned."""

    fits: Mapping[Structure, FittedModel]
    best: FittedModel
    order: Comparison
    noise: CommonNoise
    floors: Mapping[tuple[str, str], float]
    ports: Mapping[str, str]
    refines: Mapping[str, str]
    curves: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    ended: str = ""

    def laws_in_place_of(self, term: str, rest: Structure, among: Iterable[Structure]) -> list[Structure]:
        """Structures that have, beside the terms of another, one listed law at the port of a term."""
        port = self.ports.get(term)

        def is_law_there(structure: Structure) -> bool:
            new = structure.new_terms(rest) if structure.contains(rest) else ()
            return len(new) == 1 and new[0] not in self.curves and self.ports.get(new[0]) == port

        return [s for s in among if is_law_there(s)]

    @property
    def ranked(self) -> list[FittedModel]:
        """All fits, the one with the least left-out error first."""
        return [self.fits[s] for s in self.order.ranked]

    @property
    def first_model(self) -> FittedModel:
        """The best fit without any term."""
        return next(f for f in self.ranked if not f.terms)
