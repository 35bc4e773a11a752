"""A model prepared for its C source: stages of its parameters, functions, and their lanes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.expression import (
    FUNCTIONS,
    INFIX,
    Builder,
    ExpressionWriter,
    Node,
    evaluate_nodes,
    number,
    topological_order,
)
from aero_bayes.modelica.parse import BOOLEAN
from aero_bayes.modelica.switching_surfaces import SwitchingModel, VariableLayout

#: Values that a function stores at most, where it is long and can be cut.
_PART = 100


@dataclass(frozen=True)
class StoredValue:
    """Where a value goes in the structure."""

    place: str
    node: Node


def loop_function(k: int | str, targets: Sequence[StoredValue], leaves: dict[Node, str]) -> str:
    """Return the function of one algebraic loop: its residuals into ``f``, their Jacobian by columns into ``j``."""
    writer = ExpressionWriter(leaves, [t.node for t in targets])
    stores = [f"    {t.place} = {writer.term(t.node)};" for t in targets]
    head = f"static void eval_loop_{k}(const Model *restrict m, double *restrict f, double *restrict j) {{"
    return "\n".join([head, "    (void)m;", *writer.lines, *stores, "}"])


def assertion_function(conditions: Sequence[Node], leaves: dict[Node, str]) -> str:
    """Return the function that marks the assertions that do not hold, and tells whether there are any."""
    writer = ExpressionWriter(leaves, conditions)
    lines = [f"    any |= bad[{i}] = !({writer.term(c)});" for i, c in enumerate(conditions)]
    head = ["static int eval_violated(Model *m, unsigned char *bad) {", "    int any = 0; (void)m; (void)bad;"]
    return "\n".join([*head, *writer.lines, *lines, "    return any;", "}"])


def c_string(message: str) -> str:
    """Return a message as a C string literal of plain ASCII."""
    plain = message.encode("ascii", "replace").decode().replace("\\", "/").replace('"', "'").replace("\n", " ")
    return f'"{plain}"'


def reinit_function(
    model: ExplicitModel, prepared: Sequence[Node], leaves: dict[Node, str], states: Sequence[Node]
) -> str:
    """Return the function that gives states the values of active ``reinit()``, and tells whether there are any."""
    writer = ExpressionWriter(leaves, prepared)
    lines = [
        f"    if ({writer.term(active)}) {{ {leaves[r.state]} = {writer.term(value)}; any = 1; }}"
        for r, active, value in zip(model.discrete.reinits, prepared[::2], prepared[1::2], strict=True)
    ]
    head = ["static int eval_reinit(Model *m) {", "    int any = 0; (void)m;"]
    return "\n".join([*head, *writer.lines, *lines, "    return any;", "}"])


def store_function(
    name: str,
    targets: Sequence[StoredValue],
    leaves: dict[Node, str],
    kept: dict[Node, str],
) -> str:
    """Return a function that stores values; in several where it is long and they share little.

    The time that a compiler takes for a function grows with the square of its length."""

    def body(part: Sequence[StoredValue]) -> list[str]:
        writer = ExpressionWriter({**leaves, **kept}, [t.node for t in part])
        return [*writer.lines, *(f"    {t.place} = {writer.term(t.node)};" for t in part)]

    whole, lines = body(targets) or ["    (void)m;"], []
    parts = [body(targets[k : k + _PART]) for k in range(0, len(targets), _PART)]
    if len(whole) > 20 * _PART and sum(map(len, parts)) < 1.5 * len(whole):
        for k, part in enumerate(parts):
            lines += [f"static __attribute__((noinline)) void eval_{name}_{k}(Model *restrict m) {{", *part, "}"]
        whole = [f"    eval_{name}_{k}(m);" for k in range(len(parts))]
    return "\n".join([*lines, f"static void eval_{name}(Model *restrict m) {{", *whole, "}"])


def start_function(
    starts: Sequence[tuple[str, str, Node]],
    steps: Sequence[tuple[str, str, Node]],
    states: frozenset[Node],
    b: Builder,
    leaves: dict[Node, str],
) -> str:
    """Initial values that depend on parameters, then those that depend on other states' initial values."""
    lines: list[str] = []
    for later in (False, True):
        group = [s for s in starts if bool(b.symbols(s[2]) & states) is later]
        writer = ExpressionWriter(leaves, [n for _, _, n in group])
        stores = [f"    if (!{set_}) {place} = {writer.term(n)};" for place, set_, n in group]
        lines += ["    {", *writer.lines, *stores, "    }"] if group else []
    writer = ExpressionWriter(leaves, [n for _, _, n in steps])
    lines += [*writer.lines, *(f"    {pre} = {now} = {writer.term(n)};" for pre, now, n in steps)]
    return "\n".join(["static void start(Model *m) {", *(lines or ["    (void)m;"]), "}"])


#: States and operations up to which lanes are written: beyond, one lane's numbers do not fit into the nearest cache,
#: and the compiler takes longer for them than the runs of a fit save.
MOST_STATES = 24
MOST_OPERATIONS = 2000

#: Instruction sets: name in ``native/lanes.h``, lanes in one register, attribute of the functions, condition.
_SETS = (
    ("BASELINE", 2, "", "1"),
    ("AVX2", 4, '__attribute__((target("avx2,fma"))) ', "defined(__x86_64__)"),
)


@dataclass(frozen=True)
class LaneEquations:
    """What the lane functions compute, in terms of these symbols."""

    states: Sequence[Node]
    inputs: Sequence[Node]
    time: Node
    constants: dict[Node, str]
    rates: Sequence[Node]
    outputs: Sequence[Node]
    slopes: Sequence[StoredValue]


class _LaneWriter(ExpressionWriter):
    """Prints expressions as statements over vectors; conditions are masks."""

    def __init__(self, leaves: dict[Node, str], constants: dict[Node, str], used: dict[Node, int]) -> None:
        super().__init__(leaves)
        self._constants = constants
        self._used = used

    def term(self, node: Node) -> str:
        if node in self._constants:
            return f"LOAD(k, {self._used.setdefault(node, len(self._used))})"
        return super().term(node)

    def declaration(self, node: Node) -> str:
        kind = "Mask" if node.op in BOOLEAN else "Vector"
        return f"    const {kind} t{node.index} = {self._expression(node)};"

    def vector(self, node: Node) -> str:
        """Return the text of a number in all lanes."""
        if node.op == "const":
            return f"SPLAT({number(node.value)})"
        text = self.term(node)
        return f"CHOOSE({text}, SPLAT(1.0), SPLAT(0.0))" if self._is_mask(node) else text

    def mask(self, node: Node) -> str:
        """Return the text of a condition."""
        return self.term(node) if self._is_mask(node) else f"(Mask)({self.vector(node)} != 0.0)"

    def _is_mask(self, node: Node) -> bool:
        return node.op in BOOLEAN and node not in self._constants and node not in self.leaves

    def _expression(self, n: Node) -> str:
        if n.op in ("and", "or"):
            return f"{self.mask(n.args[0])} {'&' if n.op == 'and' else '|'} {self.mask(n.args[1])}"
        if n.op == "not":
            return f"~{self.mask(n.args[0])}"
        if n.op == "select":
            return f"CHOOSE({self.mask(n.args[0])}, {self.vector(n.args[1])}, {self.vector(n.args[2])})"
        args = [self.vector(a) for a in n.args]
        if n.op in INFIX:
            text = f"{args[0]} {INFIX[n.op]} {args[1]}"
            return f"(Mask)({text})" if n.op in BOOLEAN else text
        match n.op:
            case "neg":
                return f"-{args[0]}"
            case "abs":
                return f"MAGNITUDE({args[0]})"
            case "sign":
                one, zero = "SPLAT(1.0)", "SPLAT(0.0)"
                return f"CHOOSE({args[0]} > 0.0, {one}, {zero}) - CHOOSE({args[0]} < 0.0, {one}, {zero})"
            case "min" | "max":
                return f"CHOOSE({args[0]} {'<' if n.op == 'min' else '>'} {args[1]}, {args[0]}, {args[1]})"
        return f"EACH{'' if len(args) == 1 else '_OF_TWO'}({FUNCTIONS[n.op]}, {', '.join(args)})"


def lane_functions(equations: LaneEquations, info: dict[str, int]) -> tuple[str, list[int]] | None:
    """C source of the lane functions, and the places of the constants that they take; None for too large a model."""
    e = equations
    leaves = {s: f"LOAD(x, {i})" for i, s in enumerate(e.states)}
    leaves |= {s: f"LOAD(u, {i})" for i, s in enumerate(e.inputs)}
    leaves[e.time] = "LOAD(time, 0)"
    used: dict[Node, int] = {}
    bodies = {}
    for name, targets in (
        ("derivatives", [StoredValue(str(i), n) for i, n in enumerate(e.rates)]),
        ("jacobian", list(e.slopes)),
        ("outputs", [StoredValue(str(i), n) for i, n in enumerate(e.outputs)]),
    ):
        writer = _LaneWriter(leaves, e.constants, used)
        writer.known = dict.fromkeys(e.constants, "")
        writer.write([t.node for t in targets])
        bodies[name] = [*writer.lines, *(f"    STORE(out, {t.place}) = {writer.vector(t.node)};" for t in targets)]
    if len(e.states) > MOST_STATES or sum(map(len, bodies.values())) > MOST_OPERATIONS:
        return None
    places = [int(re.findall(r"\[(\d+)\]", e.constants[n])[0]) for n in used]
    members = {
        "nx": len(e.states), "nu": len(e.inputs), "constants": len(used), "ny": len(e.outputs), **info,
    }  # fmt: skip
    lines = ['#include "lane_arithmetic.h"']
    for name, width, attribute, condition in _SETS:
        lines += [f"#if {condition}", *_one_set(name, width, attribute, bodies, members), "#endif"]
    lines += [
        '__attribute__((visibility("default"))) const LaneTable *ab_lanes(int set) {',
        *(f"#if {c}\n    if (set == AB_{name}) return &lanes_{name};\n#endif" for name, _, _, c in _SETS),
        "    return 0;",
        "}",
    ]
    return "\n".join(lines), places


def _one_set(name: str, width: int, attribute: str, bodies: dict[str, list[str]], members: dict[str, int]) -> list[str]:
    """Return the functions for one instruction set, and their table."""
    lines = [
        f"#define WIDTH {width}",
        f"typedef double Vector_{name} __attribute__((vector_size({8 * width}), may_alias));",
        f"typedef long long Mask_{name} __attribute__((vector_size({8 * width}), may_alias));",
        f"#define Vector Vector_{name}",
        f"#define Mask Mask_{name}",
    ]
    arguments = "int lanes, const double *k, const double *time, const double *u, const double *x, double *restrict out"
    for function, body in bodies.items():
        lines += [
            f"{attribute}static void {function}_{name}({arguments}) {{",
            "    (void)k; (void)time; (void)u; (void)x; (void)out;",
            "    for (int lane = 0; lane < lanes; lane += WIDTH) {",
            *body,
            "    }",
            "}",
        ]
    table = "".join(f", .{key} = {value}" for key, value in members.items())
    functions = "".join(f", .{function} = {function}_{name}" for function in bodies)
    lines.append(f"static const LaneTable lanes_{name} = {{AB_LANES_VERSION, AB_LANES{table}{functions}}};")
    return [*lines, "#undef Vector", "#undef Mask", "#undef WIDTH"]


class ParameterStage:
    """Tells expressions of parameters alone from the rest, and turns division by one into multiplication."""

    def __init__(self, builder: Builder, parameters: frozenset[Node]) -> None:
        self.builder = builder
        self.parameters = parameters
        self._memo: dict[Node, Node] = {}

    def of_parameters_only(self, node: Node) -> bool:
        """Return whether an expression depends on parameters alone."""
        return self.builder.symbols(node) <= self.parameters

    def reciprocal(self, node: Node) -> Node:
        """Return the expression with divisions by early expressions as multiplications by their reciprocals."""
        b = self.builder
        for n in topological_order([node], self._memo):
            args = tuple(self._memo[a] for a in n.args)
            if n.op == "div" and self.of_parameters_only(args[1]) and not self.of_parameters_only(args[0]):
                self._memo[n] = b.mul(args[0], b.div(b.one, args[1]))
            else:
                self._memo[n] = b.apply(n, args) if n.args else n
        return self._memo[node]

    def to_store(self, nodes: Sequence[Node]) -> list[Node]:
        """Early expressions (no plain symbols or constants) that late ones or the results use directly."""
        found: dict[Node, None] = {}

        def consider(n: Node) -> None:
            if n.args and self.of_parameters_only(n):
                found.setdefault(n)

        for n in nodes:
            consider(n)
        for n in topological_order(nodes, {}, lambda n: not self.of_parameters_only(n)):
            if not self.of_parameters_only(n):
                for a in n.args:
                    consider(a)
        return sorted(found, key=lambda n: n.index)


class PreparedModel:
    """A model as its C source computes it: symbols, and expressions with as little work at a time step as possible.

    Parameters of inner components that nothing shows are replaced by their values, and divisions by parameters are
    multiplications."""

    def __init__(self, switching: SwitchingModel, layout: VariableLayout) -> None:
        self.switching, self.layout, self.model = switching, layout, switching.model
        model, b = self.model, self.model.system.builder
        self.builder = b
        self.states = [b.symbol(p) for p in layout.state_paths]
        self.inputs = [b.symbol(v.name) for v in layout.inputs]
        self.parameters = [b.symbol(v.name) for v in layout.parameters]
        self.unknowns = [u for loop in model.loops for u in loop.unknowns]
        self.steps = sorted(model.discrete.updates, key=lambda s: s.name.startswith("when#"))
        self.stage = ParameterStage(b, frozenset(self.parameters))
        self.defaults = {
            p: evaluate_nodes([v.binding], {})[0]
            for p, v in zip(self.parameters, layout.parameters, strict=True)
            if v.binding
        }
        hidden = {
            b.symbol(v.name): v.binding
            for v in model.system.parameters
            if v.binding is not None and v.binding.op == "const" and b.symbol(v.name) not in self.defaults
        }
        #: Values of all parameters.
        self.constants = {**{s: n.value for s, n in hidden.items()}, **self.defaults}
        self._memo = hidden
        self.rates = self.prepare(model.rates)
        self.outputs = self.prepare(model.solved[v.name] for v in layout.outputs)
        self.dependent = self.prepare(v.binding for v in layout.dependent if v.binding is not None)
        self.starts = self.prepare(model.starts)
        self.loops = [self.prepare(loop.residuals) for loop in model.loops]
        self.rows = [*self.rates, *self.outputs, *self.dependent]

    @cached_property
    def instants(self) -> dict[int, tuple[Node, Node]]:
        """Relations that change at a known time: by their number, that time and its slope."""
        relations = enumerate(self.model.discrete.relations)
        return {i: t for i, r in relations if (t := self.model.time_of_change(r.difference)) is not None}

    def prepare(self, nodes: Iterable[Node]) -> list[Node]:
        """Return expressions as they are computed."""
        return [self.stage.reciprocal(self.builder.substitute(n, self._memo)) for n in nodes]

    def step_starts(self) -> Iterator[Node]:
        """Yield values of the discrete variables before the first event."""
        by_name = {v.name: v for v in self.model.system.discrete_variables}
        given, zero = self.model.discrete.before, self.builder.zero
        for s in self.steps:
            declared = by_name[s.name].attributes.get("start", zero) if s.name in by_name else zero
            yield given.get(s, declared)
