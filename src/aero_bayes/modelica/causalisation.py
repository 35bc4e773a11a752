"""Residuals -> explicit equations: which variables are states, in what order to solve, and each one's expression.

Equations and unknowns are matched, sorted into blocks (Tarjan), and each block is solved symbolically where it is
linear; else what is left of it is solved by Newton's method when the model runs. Where equations say something about
states only, one of them is expressed by the others and its derivative follows by differentiation (index reduction).

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from aero_bayes.errors import InputError
from aero_bayes.modelica.discrete import DiscretePart, solve_discrete
from aero_bayes.modelica.equation_system import EquationSystem
from aero_bayes.modelica.expression import Builder, Node, topological_order
from aero_bayes.modelica.graphs import SignedUnionFind, assign, components, reachable
from aero_bayes.modelica.linear_equations import AlgebraicLoop, eliminate, match, solve_where_linear


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
    owner = assign([[s for s in near if s in own] for near, own in zip(nearest, reach, strict=True)])
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


_SELECT = ("never", "avoid", "default", "prefer", "always")


@dataclass(frozen=True)
class ExplicitModel:
    """``der(states) = rates``; every other variable's expression in ``solved``.

    ``starts`` are in terms of parameters, and of other states where initial equations tie them together. Unknowns of
    ``loops`` are symbols; ``discrete`` is in terms of states, these, and of what is constant between events."""

    system: EquationSystem
    states: tuple[str, ...]
    rates: tuple[Node, ...]
    solved: dict[str, Node]
    starts: tuple[Node, ...]
    loops: tuple[AlgebraicLoop, ...]
    discrete: DiscretePart
    initial: AlgebraicLoop | None = None

    def time_of_change(self, difference: Node) -> tuple[Node, Node] | None:
        """When a relation between time and parameters changes, and its slope, where both are known in advance."""
        b, time = self.system.builder, self.system.time
        parameters = {b.symbol(p.name) for p in self.system.parameters}
        slope = b.derivative(difference, time)
        if time in b.symbols(difference) <= parameters | {time} and b.symbols(slope) <= parameters:
            return b.neg(b.div(b.substitute(difference, {time: b.zero}), slope)), slope
        return None

    @property
    def indicators(self) -> int:
        """Number of event indicators."""
        known = sum(self.time_of_change(r.difference) is not None for r in self.discrete.relations)
        return len(self.discrete.relations) - known + 2 * len(self.discrete.roundings)

    def compared(self) -> frozenset[str]:
        """Return the parameters on which conditions depend: break points and thresholds, not the values between."""
        solved = (*self.rates, *self.solved.values(), *self.starts, *self.loop_and_event_expressions)
        conditions = [n.args[0] for n in topological_order(solved, {}) if n.op == "select"]
        conditions += [r.difference for r in self.discrete.relations]
        known = frozenset[Node]().union(*map(self.system.builder.symbols, conditions))
        return frozenset(s.name for s in known) & {p.name for p in self.system.parameters}

    def dependencies(self, expression: Node) -> frozenset[Node] | None:
        """States, inputs and parameters that an expression depends on; None where it is not known without events."""
        b = self.system.builder
        loop_of = {u: loop for loop in self.loops for u in loop.unknowns}
        behind = {u: {s for r in loop.residuals for s in b.symbols(r)} for u, loop in loop_of.items()}
        found = reachable(b.symbols(expression), lambda s: behind.get(s, ())).keys()
        between = set(self.discrete.updates) | {r.symbol for r in self.discrete.relations}
        between |= {r.symbol for r in self.discrete.roundings}
        if found & between or any(s.name.startswith(("pre(", "sample#", "initial(")) for s in found):
            return None
        return frozenset(found - loop_of.keys())

    @property
    def loop_and_event_expressions(self) -> tuple[Node, ...]:
        """Expressions of loops and events, which rates and outputs depend on through symbols."""
        d = self.discrete
        return (
            *(r for loop in self.loops for r in loop.residuals),
            *(self.initial.residuals if self.initial is not None else ()),
            *d.updates.values(),
            *(x for r in d.reinits for x in (r.active, r.value)),
            *(r.difference for r in d.relations),
            *(r.argument for r in d.roundings),
            *(x for s in d.samplings for x in (s.start, s.interval)),
            *(c for c, _ in d.assertions),
        )


def causalise(system: EquationSystem) -> ExplicitModel:
    """Solve the residuals for the derivatives and the algebraic variables."""
    b = system.builder
    whole = system
    system, aliases = _merge_aliases(whole)
    residuals = [r for r in system.residuals if r is not b.zero]
    by_name = {v.name: v for v in system.variables}
    dynamic = [v.name for v in system.variables if v.name in system.derivatives]
    for name in system.derivatives:
        if name not in by_name:
            raise InputError(f"model {system.name}: the derivative of the input {name!r} is needed, which is not known")
    extra: list[Node] = []
    while True:
        states = set(dynamic)
        unknowns = [b.symbol(v.name) for v in system.variables if v.name not in states]
        unknowns += [d for n, d in system.derivatives.items() if n in by_name]
        equations = residuals + extra
        if len(equations) != len(unknowns):
            raise InputError(f"model {system.name}: {len(equations)} equations for {len(unknowns)} unknowns")
        matched, singular, reached = match(b, equations, unknowns)
        if not singular:
            break
        constraint = _constraint(system, [equations[k] for k in singular], [unknowns[u] for u in reached])
        name, rate = _dummy_derivative(system, constraint, dynamic)
        dynamic.remove(name)
        extra.append(rate)
    solved, loops = _solve(system, equations, unknowns, matched)
    states_in_order = tuple(v.name for v in system.variables if v.name in states)
    rates = tuple(solved[system.derivatives[n]] for n in states_in_order)
    starts, initial = initial_values(system, states_in_order, solved, loops)
    named = {n.name: e for n, e in solved.items()}
    named |= {a.name: b.substitute(e, dict(solved)) for a, e in aliases.items()}
    named |= {v.name: b.symbol(v.name) for v in whole.discrete_variables}
    everything = {b.symbol(n): e for n, e in named.items()}
    discrete = solve_discrete(whole.name, b, whole.discrete, everything, {b.symbol(n) for n in states_in_order})
    return ExplicitModel(whole, states_in_order, rates, named, starts, loops, discrete, initial)


def _merge_aliases(system: EquationSystem) -> tuple[EquationSystem, dict[Node, Node]]:
    """Replace variables that equal another one, or its negative, by one of them: a state where there is one.

    Returns the smaller system and, for each variable that is gone, what it equals."""
    b = system.builder
    known = {b.symbol(v.name): v for v in system.variables}
    inputs = {b.symbol(v.name) for v in system.inputs}
    equal = SignedUnionFind[Node]()

    def rank(node: Node) -> tuple[bool, bool, bool, int]:
        variable = known.get(node)
        dynamic = node.name in system.derivatives
        return (node not in inputs, not dynamic, variable is None or not variable.fixed, node.index)

    for r in system.residuals:
        body = r.args[0] if r.op == "neg" else r
        if body.op not in ("add", "sub") or not all(a in known or a in inputs for a in body.args):
            continue
        (one, sign_one), (two, sign_two) = map(equal.find, body.args)
        if one is two or (one in inputs and two in inputs):
            continue
        kept, gone = sorted((one, two), key=rank)
        equal.union(gone, kept, sign_one * sign_two * (-1 if body.op == "add" else 1))
    aliases: dict[Node, Node] = {}
    replaced: dict[Node, Node] = {}
    derivatives = dict(system.derivatives)
    for gone in equal.above:
        kept, sign = equal.find(gone)
        aliases[gone] = b.neg(kept) if sign < 0 else kept
        if gone.name in derivatives:
            rate = derivatives.setdefault(kept.name, b.symbol(f"der({kept.name})"))
            replaced[derivatives.pop(gone.name)] = b.neg(rate) if sign < 0 else rate
    memo = {**aliases, **replaced}
    smaller = replace(
        system,
        variables=tuple(v for v in system.variables if b.symbol(v.name) not in aliases),
        residuals=tuple(b.substitute(r, memo) for r in system.residuals),
        initial_residuals=tuple(b.substitute(r, memo) for r in system.initial_residuals),
        derivatives=derivatives,
    )
    return smaller, aliases


def _constraint(system: EquationSystem, equations: Sequence[Node], unknowns: Sequence[Node]) -> Node:
    """Return what equations that have one unknown less than they are many say about states alone."""
    b = system.builder
    constants = frozenset(b.symbol(p.name) for p in system.parameters)
    rest = eliminate(b, equations, unknowns, constants)
    names = ", ".join(sorted({s.name for e in equations for s in b.symbols(e)} - {p.name for p in constants}))
    if rest.unknowns or rest.residuals[0] is b.zero:
        raise InputError(
            f"model {system.name}: structurally singular: equations that determine nothing new among "
            f"{names or 'no variable'}"
        )
    return rest.residuals[0]


def _dummy_derivative(system: EquationSystem, equation: Node, dynamic: Sequence[str]) -> tuple[str, Node]:
    """Find a state of ``equation`` that need not be one, and its derivative's equation in terms of the others'."""
    b = system.builder
    by_name = {v.name: v for v in system.variables}
    constants = frozenset(b.symbol(p.name) for p in system.parameters)
    present = b.symbols(equation)
    candidates = [n for n in dynamic if b.symbol(n) in present]
    candidates.sort(key=lambda n: (_SELECT.index(by_name[n].state_select), by_name[n].fixed))
    for name in candidates:
        symbol = b.symbol(name)
        slope = b.derivative(equation, symbol)
        if slope is b.zero or not b.symbols(slope) <= constants:
            continue
        others = b.neg(b.div(b.substitute(equation, {symbol: b.zero}), slope))
        inputs = [v.name for v in system.inputs if b.symbol(v.name) in b.symbols(others)]
        if inputs:
            raise InputError(f"model {system.name}: the derivative of {name!r} needs that of the input {inputs[0]!r}")
        rate = b.derivative(others, system.time)
        for n, d in list(system.derivatives.items()):
            if n != name:
                rate = b.add(rate, b.mul(b.derivative(others, b.symbol(n)), d))
        return name, b.sub(system.derivatives[name], rate)
    names = ", ".join(sorted(s.name for s in present - constants)) or "no variable"
    if not candidates:
        raise InputError(
            f"model {system.name}: structurally singular: an equation that determines nothing new among {names}"
        )
    raise InputError(
        f"model {system.name}: which of {names} are states changes while the model runs (dynamic state selection)"
    )


def _solve(
    system: EquationSystem, equations: Sequence[Node], unknowns: Sequence[Node], matched: Sequence[int]
) -> tuple[dict[Node, Node], tuple[AlgebraicLoop, ...]]:
    b = system.builder
    constants = frozenset(b.symbol(p.name) for p in system.parameters)
    equation_of = {unknowns[u]: e for e, u in enumerate(matched)}
    needs = [[equation_of[s] for s in _ordered(b, e) if s in equation_of] for e in equations]
    solved: dict[Node, Node] = {}
    memo: dict[Node, Node] = {}
    loops: list[AlgebraicLoop] = []
    for block in components(needs):
        block = sorted(block)
        symbols = [unknowns[matched[e]] for e in block]
        values = solve_where_linear(system, [equations[e] for e in block], symbols, memo)
        if values is not None:
            found = dict(zip(symbols, values, strict=True))
        else:
            here = [b.substitute(equations[e], dict(memo)) for e in block]
            rest = eliminate(b, here, symbols, constants)
            found = {u: u for u in rest.unknowns}
            found |= rest.back_substituted(b, found)
            if rest.unknowns:
                loops.append(AlgebraicLoop(rest.unknowns, rest.residuals))
        solved |= found
        memo |= found
    return solved, tuple(loops)


def _ordered(b: Builder, node: Node) -> list[Node]:
    return sorted(b.symbols(node), key=lambda n: n.index)
