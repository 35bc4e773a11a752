"""Initial values of the states."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.errors import InputError
from aero_bayes.export.expression import Node
from aero_bayes.export.linear import linear_solve
from aero_bayes.export.loops import Loop
from aero_bayes.export.translate import System


def initial_values(
    system: System, states: Sequence[str], solved: dict[Node, Node], loops: Sequence[Loop]
) -> tuple[tuple[Node, ...], Loop | None]:
    """Initial value of each state: its start attribute, or what initial equations and other fixed values give.

    Where these are not linear, or hold in an algebraic loop, the start attributes are guesses for the loop returned.
    """
    b = system.builder
    by_name = {v.name: v for v in system.variables}
    starts = {b.symbol(n): by_name[n].attributes.get("start", b.zero) for n in states}
    memo = dict(solved)
    stated = [r for r in (b.substitute(e, memo) for e in system.initial_residuals) if r is not b.zero]
    fixed = [
        b.sub(b.substitute(b.symbol(v.name), memo), v.attributes.get("start", b.zero))
        for v in system.variables
        if v.fixed and v.name not in states
    ]
    in_loops = {u for loop in loops for u in loop.unknowns}
    behind = frozenset[Node]().union(*(b.symbols(r) for loop in loops for r in loop.residuals))
    open_states = [b.symbol(n) for n in states if not by_name[n].fixed]
    rows = [*stated, *fixed]
    reach = [b.symbols(r) | behind if b.symbols(r) & in_loops else b.symbols(r) for r in rows]
    owner: dict[Node, int] = {}

    def place(k: int, seen: set[Node]) -> bool:
        for state in open_states:
            if state in reach[k] and state not in seen:
                seen.add(state)
                if state not in owner or place(owner[state], seen):
                    owner[state] = k
                    return True
        return False

    for k in range(len(rows)):
        if not place(k, set()) and k < len(stated):
            raise InputError(f"model {system.name}: an initial equation determines no state that is free to choose")
    used, residuals = list(owner), [rows[k] for k in owner.values()]
    unsolved = None
    if residuals:
        matrix = [[b.derivative(r, s) for s in used] for r in residuals]
        solution = None
        if not any(b.symbols(a) & set(used) for row in matrix for a in row) and not any(
            b.symbols(r) & in_loops for r in residuals
        ):
            right = [b.neg(b.substitute(r, {s: b.zero for s in used})) for r in residuals]
            solution = linear_solve(system, matrix, right, used)
        if solution is not None:
            starts.update(zip(used, solution, strict=True))
        else:
            more = [loop for loop in loops if any(b.symbols(r) & in_loops for r in residuals)]
            unsolved = Loop(
                (*used, *(u for loop in more for u in loop.unknowns)),
                (*residuals, *(r for loop in more for r in loop.residuals)),
            )
    return tuple(starts[b.symbol(n)] for n in states), unsolved
