"""Initial values of the states."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.errors import InputError
from aero_bayes.modelica.equation_system import EquationSystem
from aero_bayes.modelica.expression import Node
from aero_bayes.modelica.linear_equations import AlgebraicLoop, components, solve_where_linear


def initial_values(
    system: EquationSystem, states: Sequence[str], solved: dict[Node, Node], loops: Sequence[AlgebraicLoop]
) -> tuple[tuple[Node, ...], AlgebraicLoop | None]:
    """Initial value of each state: its start attribute, or what initial equations and other fixed values give.

    Where these are not linear, or hold in an algebraic loop, the start attributes are guesses for the loop returned."""
    b = system.builder
    by_name = {v.name: v for v in system.variables}
    starts = {b.symbol(n): by_name[n].attributes.get("start", b.zero) for n in states}
    memo = dict(solved)
    said = [(r, b.symbols(e)) for e in system.initial_residuals if (r := b.substitute(e, memo)) is not b.zero]
    stated = [r for r, _ in said]
    fixed = [
        b.sub(b.substitute(b.symbol(v.name), memo), v.attributes.get("start", b.zero))
        for v in system.variables
        if v.fixed and v.name not in states
    ]
    in_loops = {u for loop in loops for u in loop.unknowns}
    behind = frozenset[Node]().union(*(b.symbols(r) for loop in loops for r in loop.residuals))
    open_states = [b.symbol(n) for n in reversed(states) if not by_name[n].fixed]
    rows = [*stated, *fixed]
    reach = [b.symbols(r) | behind if b.symbols(r) & in_loops else b.symbols(r) for r in rows]
    # An equation is about the states that it names, the last ones first, before those that it depends on.
    nearest = [sorted(open_states, key=lambda s: s not in own) for _, own in said] + [open_states] * len(fixed)
    owner = _owners(nearest, reach)
    if not set(range(len(stated))) <= set(owner.values()):
        raise InputError(f"model {system.name}: an initial equation determines no state that is free to choose")
    states_of, row_of = list(owner), list(owner.values())
    at = {s: i for i, s in enumerate(states_of)}
    found: dict[Node, Node] = {}
    used: list[Node] = []
    residuals: list[Node] = []
    for block in components([sorted(at[s] for s in reach[k] if s in at) for k in row_of]):
        symbols = [states_of[i] for i in sorted(block)]
        here = [b.substitute(rows[row_of[i]], dict(found)) for i in sorted(block)]
        solution = None
        if not any(b.symbols(r) & (in_loops | set(used)) for r in here):
            solution = solve_where_linear(system, here, symbols)
        if solution is None:
            used += symbols
            residuals += here
        else:
            found.update(zip(symbols, solution, strict=True))
    starts |= found
    unsolved = None
    if residuals:
        more = [loop for loop in loops if any(b.symbols(r) & in_loops for r in residuals)]
        unsolved = AlgebraicLoop(
            (*used, *(u for loop in more for u in loop.unknowns)),
            (*residuals, *(r for loop in more for r in loop.residuals)),
        )
    return tuple(starts[b.symbol(n)] for n in states), unsolved


def _owners(nearest: Sequence[Sequence[Node]], reach: Sequence[frozenset[Node]]) -> dict[Node, int]:
    """Return, for states, the equation that determines each.

    Each equation has at most one, and as many have one as can."""
    owner: dict[Node, int] = {}

    def place(k: int, seen: set[Node]) -> bool:
        for state in nearest[k]:
            if state in reach[k] and state not in seen:
                seen.add(state)
                if state not in owner or place(owner[state], seen):
                    owner[state] = k
                    return True
        return False

    for k in range(len(nearest)):
        place(k, set())
    return owner
