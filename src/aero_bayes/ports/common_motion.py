"""Variables that differ by a constant and a sign only, such as the positions of both ends of a rigid mass."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from aero_bayes.export.flat import FlatEquation
from aero_bayes.language.syntax import Call, Name, names_in, summands

#: For each variable its representative and relative sign. The representative of a constant is the empty name.
SignedRepresentatives = Mapping[str, tuple[str, int]]


class SignedUnionFind:
    """Union-find (disjoint sets) of names that are equal but for their sign."""

    def __init__(self) -> None:
        self._above: dict[str, tuple[str, int]] = {}

    def find(self, name: str) -> tuple[str, int]:
        """Return the representative of a name, and the sign of the name relative to it."""
        sign = 1
        while name in self._above:
            name, flip = self._above[name]
            sign *= flip
        return name, sign

    def union(self, gone: str, kept: str, sign: int) -> None:
        """Merge two sets: the representative ``gone`` is ``sign`` times the representative ``kept``."""
        self._above[gone] = kept, sign


def moving_together(equations: Sequence[FlatEquation], free: Collection[str]) -> dict[str, tuple[str, int]]:
    """Find variables whose sum or difference is constant. ``free`` are the variables that are not constants."""
    known = SignedUnionFind()
    sums = [s for e in equations if (s := _sum(e, free)) is not None]
    grown = True
    while grown:
        grown = False
        for terms in sums:
            left: dict[str, int] = {}
            for sign, name in terms:
                base, flip = known.find(name)
                left[base] = left.get(base, 0) + sign * flip
            moving = [(name, k) for name, k in left.items() if name and k]
            if len(moving) == 1:
                known.union(moving[0][0], "", 1)
                grown = True
            elif len(moving) == 2 and {abs(k) for _, k in moving} == {1}:
                (one, k), (two, m) = moving
                known.union(two, one, -k * m)
                grown = True
    return {name: known.find(name) for name in free}


def distances(equations: Sequence[FlatEquation], moving: SignedRepresentatives) -> dict[str, frozenset[str]]:
    """Return, for each variable that an equation defines as the difference or sum of two others, these two."""
    found: dict[str, frozenset[str]] = {}
    for e in equations:
        terms = _sum(e, moving.keys()) if isinstance(e.left, Name) else None
        if terms is not None and isinstance(e.left, Name):
            ends = frozenset(moving[name][0] for _, name in terms if name != e.left.name) - {""}
            if len(ends) == 2:
                found.setdefault(e.left.name, ends)
    return found


def _sum(e: FlatEquation, free: Collection[str]) -> list[tuple[int, str]] | None:
    """Return the variables of an equation with their signs, if it is a sum of variables and constants."""
    found: list[tuple[int, str]] = []
    for sign, tree in summands(Call("-", (e.left, e.right))):
        match tree:
            case Name(name, ()) if name in free:
                found.append((sign, name))
            case _ if names_in(tree) & {*free, "time"} or (isinstance(tree, Name) and tree.subscripts):
                return None
    return found
