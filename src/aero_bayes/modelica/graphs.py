"""Graphs: bipartite matching, strongly connected components, what can be reached, and disjoint sets."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Generic, TypeVar

T = TypeVar("T", bound=Hashable)


def reachable(begin: Iterable[T], onward: Callable[[T], Iterable[T]]) -> dict[T, None]:
    """Return what is at the beginning, and all to which ``onward`` leads from there."""
    found = dict.fromkeys(begin)
    waiting = [*found]
    while waiting:
        for new in onward(waiting.pop()):
            if new not in found:
                found[new] = None
                waiting.append(new)
    return found


def assign(options: Sequence[Iterable[T]]) -> dict[T, int]:
    """Give as many as can one of their options each, the first ones first, by augmenting paths.

    Returns, by option, the index of the one that has it."""
    owner: dict[T, int] = {}

    def place(k: int, seen: set[T]) -> bool:
        for option in options[k]:
            if option not in seen:
                seen.add(option)
                if option not in owner or place(owner[option], seen):
                    owner[option] = k
                    return True
        return False

    for k in range(len(options)):
        place(k, set())
    return owner


def components(needs: Sequence[Iterable[int]]) -> list[list[int]]:
    """Strongly connected components, each after those that it needs (Tarjan 1972, without recursion)."""
    index: dict[int, int] = {}
    low: dict[int, int] = {}
    on_stack: set[int] = set()
    stack: list[int] = []
    found: list[list[int]] = []
    for root in range(len(needs)):
        if root in index:
            continue
        work = [(root, iter(needs[root]))]
        index[root] = low[root] = len(index)
        stack.append(root)
        on_stack.add(root)
        while work:
            node, successors = work[-1]
            for s in successors:
                if s not in index:
                    index[s] = low[s] = len(index)
                    stack.append(s)
                    on_stack.add(s)
                    work.append((s, iter(needs[s])))
                    break
                if s in on_stack:
                    low[node] = min(low[node], index[s])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    component = []
                    while True:
                        member = stack.pop()
                        on_stack.discard(member)
                        component.append(member)
                        if member == node:
                            break
                    found.append(component)
    return found


class SignedUnionFind(Generic[T]):
    """Union-find (disjoint sets) of what is equal but for its sign."""

    def __init__(self) -> None:
        self.above: dict[T, tuple[T, int]] = {}

    def find(self, item: T) -> tuple[T, int]:
        """Return the representative of an item, and the sign of the item relative to it."""
        sign = 1
        while item in self.above:
            item, flip = self.above[item]
            sign *= flip
        return item, sign

    def union(self, gone: T, kept: T, sign: int) -> None:
        """Merge two sets: the representative ``gone`` is ``sign`` times the representative ``kept``."""
        self.above[gone] = kept, sign
