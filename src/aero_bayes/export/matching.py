"""Bipartite matching of equations and unknowns, and their order by strongly connected components."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from aero_bayes.export.expression import Builder, Node


def match(b: Builder, equations: Sequence[Node], unknowns: Sequence[Node]) -> tuple[list[int], list[int], list[int]]:
    """Give each equation an unknown (index), by augmenting paths.

    Where one is left without: the equations of the smallest set that is one unknown short, and its unknowns."""
    index = {u: i for i, u in enumerate(unknowns)}
    incidence = [sorted(index[s] for s in b.symbols(e) if s in index) for e in equations]
    owner: list[int | None] = [None] * len(unknowns)
    for start in range(len(equations)):
        came_from: dict[int, tuple[int, int | None]] = {}
        queue: deque[tuple[int, int | None]] = deque([(start, None)])
        reached = {start}
        end = None
        while queue and end is None:
            equation, via = queue.popleft()
            for u in incidence[equation]:
                if u not in came_from:
                    came_from[u] = (equation, via)
                    holder = owner[u]
                    if holder is None:
                        end = u
                        break
                    queue.append((holder, u))
                    reached.add(holder)
        if end is None:
            return [], sorted(reached), sorted(came_from)
        step: int | None = end
        while step is not None:
            equation, via = came_from[step]
            owner[step] = equation
            step = via
    matched = [0] * len(equations)
    for u, holder in enumerate(owner):
        if holder is not None:
            matched[holder] = u
    return matched, [], []


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
