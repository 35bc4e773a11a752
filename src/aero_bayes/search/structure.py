"""The structure of a model: its terms beside the first model, free parameters, reading of inputs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Structure:
    """An immutable set of choices; the empty one is the first model itself.

    Parameters
    ----------
    terms : tuple of str
        Ids ``law@port``, sorted.
    freed : tuple of str
        Parameters of the first model that are free beside those of the configuration, sorted.
    other_interpolation : bool
        Whether inputs have the other interpolation: linear in place of zero-order hold, or the reverse.
    """

    terms: tuple[str, ...] = ()
    freed: tuple[str, ...] = ()
    other_interpolation: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(sorted(set(self.terms))))
        object.__setattr__(self, "freed", tuple(sorted(set(self.freed))))

    def __len__(self) -> int:
        return len(self.terms)

    def plus(self, *terms: str) -> Structure:
        """Return the structure with further terms."""
        return replace(self, terms=(*self.terms, *terms))

    def minus(self, *terms: str) -> Structure:
        """Return the structure without some terms."""
        return replace(self, terms=tuple(t for t in self.terms if t not in terms))

    def new_terms(self, beside: Structure) -> tuple[str, ...]:
        """Terms that another structure does not have."""
        return tuple(t for t in self.terms if t not in beside.terms)

    def same_setting(self, other: Structure) -> bool:
        """Return whether all but the terms is the same."""
        return replace(self, terms=()) == replace(other, terms=())

    def contains(self, other: Structure) -> bool:
        """Return whether it has all terms of another structure, and perhaps more."""
        return self.same_setting(other) and set(other.terms) <= set(self.terms)

    def contains_terms(self, other: Structure) -> bool:
        """Return whether it does, as :meth:`contains`, for any freed parameters and interpolation."""
        return set(other.terms) <= set(self.terms)


def law_of(term: str) -> str:
    """Return the law of a term, which is named ``law@port``; empty where it has none."""
    return term.rpartition("@")[0]


def by_size(structures: Iterable[Structure]) -> dict[int, list[Structure]]:
    """Structures by their number of terms."""
    found: dict[int, list[Structure]] = {}
    for structure in structures:
        found.setdefault(len(structure), []).append(structure)
    return found
