"""Explicit model -> C: one structure, lazily evaluated functions, exact Jacobians.

Expressions of parameters alone are computed when a parameter changes and kept (``m->k``); the rest is straight-line
code over local variables. The FMI functions around it are in ``native/runtime.c``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files

from aero_bayes.export.causalise import ExplicitModel
from aero_bayes.export.expression import Builder, Node, evaluate, topological
from aero_bayes.export.layout import Layout
from aero_bayes.export.translate import Variable

_FUNCTIONS = {
    "sqrt": "sqrt", "exp": "exp", "log": "log", "log10": "log10", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "asin", "acos": "acos", "atan": "atan", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "abs": "fabs",
    "pow": "pow", "atan2": "atan2", "floor": "floor",
}  # fmt: skip
_INFIX = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==",
    "ne": "!=", "and": "&&", "or": "||",
}  # fmt: skip


class _Writer:
    """Prints expressions as C statements over local variables."""

    def __init__(self, leaves: dict[Node, str]) -> None:
        self.leaves = leaves
        self.lines: list[str] = []
        self.known: dict[Node, str] = {}

    def term(self, node: Node) -> str:
        if node in self.leaves:
            return self.leaves[node]
        if node.op == "const":
            return _number(node.value)
        return self.known[node]

    def write(self, nodes: Iterable[Node]) -> None:
        done: dict[Node, object] = {**self.known, **self.leaves}
        for n in topological(nodes, done):
            if n.op == "const":
                continue
            if n.op == "symbol":
                raise KeyError(n.name)
            self.known[n] = f"t{n.index}"
            self.lines.append(f"    const double t{n.index} = {self._expression(n)};")

    def _expression(self, n: Node) -> str:
        args = [self.term(a) for a in n.args]
        if n.op in _INFIX:
            return f"{args[0]} {_INFIX[n.op]} {args[1]}"
        if n.op in _FUNCTIONS:
            return f"{_FUNCTIONS[n.op]}({', '.join(args)})"
        match n.op:
            case "neg":
                return f"-{args[0]}"
            case "not":
                return f"!{args[0]}"
            case "sign":
                return f"({args[0]} > 0) - ({args[0]} < 0)"
            case "select":
                return f"{args[0]} ? {args[1]} : {args[2]}"
            case "min":
                return f"{args[0]} < {args[1]} ? {args[0]} : {args[1]}"
            case "max":
                return f"{args[0]} > {args[1]} ? {args[0]} : {args[1]}"
        raise NotImplementedError(n.op)


def _number(value: float) -> str:
    text = repr(value)
    return f"({text})" if value < 0 else text


@dataclass(frozen=True)
class _Target:
    """Where a value goes in the structure."""

    place: str
    node: Node


def generate(model: ExplicitModel, layout: Layout, guid: str) -> str:
    """The complete C source of one FMU."""
    b = model.system.builder
    nx, nu, np_ = len(layout.states), len(layout.inputs), len(layout.parameters)
    nq, ny = len(layout.dependent), len(layout.outputs)
    states = [b.symbol(p) for p in layout.state_paths]
    inputs = [b.symbol(v.name) for v in layout.inputs]
    parameters = [b.symbol(v.name) for v in layout.parameters]
    stage = _Stages(b, frozenset(parameters))
    defaults = {
        p: evaluate([v.binding], {})[0] for p, v in zip(parameters, layout.parameters, strict=True) if v.binding
    }
    # parameters of inner components that nothing shows keep their value
    hidden = {
        b.symbol(v.name): v.binding
        for v in model.system.parameters
        if v.binding is not None and v.binding.op == "const" and b.symbol(v.name) not in defaults
    }
    memo: dict[Node, Node] = dict(hidden)

    def prepare(nodes: Iterable[Node]) -> list[Node]:
        return [stage.reciprocal(b.substitute(n, memo)) for n in nodes]

    rates = prepare(model.rates)
    outputs = prepare(model.solved[v.name] for v in layout.outputs)
    dependent = prepare(v.binding for v in layout.dependent if v.binding is not None)
    starts = prepare(model.starts)
    rows = [*rates, *outputs, *dependent]
    jx = _jacobian(b, rows, [*states, *inputs], stage, "m->jx")
    jp = _jacobian(b, rows, parameters, stage, "m->jp")
    leaves = {model.system.time: "m->time"}
    leaves |= {s: f"m->r[{i}]" for i, s in enumerate(states)}
    leaves |= {s: f"m->r[{2 * nx + i}]" for i, s in enumerate(inputs)}
    leaves |= {s: f"m->r[{layout.first_parameter + i}]" for i, s in enumerate(parameters)}
    groups = {
        "dx": [_Target(f"m->r[{nx + i}]", n) for i, n in enumerate(rates)],
        "y": [_Target(f"m->r[{layout.first_output + i}]", n) for i, n in enumerate(outputs)],
        "jx": jx,
        "jp": jp,
    }
    saved = stage.saved([t.node for g in groups.values() for t in g])
    kept = {n: f"m->k[{i}]" for i, n in enumerate(saved)}
    first = [_Target(place, n) for n, place in kept.items()]
    first += [_Target(f"m->r[{layout.first_dependent + i}]", n) for i, n in enumerate(dependent)]
    functions = [_function("k", first, leaves, {})]
    functions += [_function(name, targets, leaves, kept) for name, targets in groups.items()]
    fixed_starts = [(i, n.value) for i, n in enumerate(starts) if n.op == "const"]
    free_starts = [(i, n) for i, n in enumerate(starts) if n.op != "const"]
    functions.append(_start_function(free_starts, frozenset(states), b, leaves))
    time_varying = any(model.system.time in b.symbols(t.node) for g in groups.values() for t in g)
    nominals = [_attribute(v, "nominal", defaults, 1.0) for v in layout.states]
    set_defaults = [f"    m->r[{i}] = {value!r};" for i, value in fixed_starts]
    set_defaults += [
        f"    m->r[{2 * nx + i}] = {_attribute(v, 'start', defaults, 0.0)!r};" for i, v in enumerate(layout.inputs)
    ]
    set_defaults += [f"    m->r[{layout.first_parameter + i}] = {v!r};" for i, v in enumerate(defaults.values())]
    sizes = {
        "NX": nx, "NXX": max(nx, 1), "NU": nu, "NP": np_, "NQ": nq, "NY": ny, "NK": max(len(kept), 1),
        "NROW": nx + ny + nq, "NREAL": layout.first_output + ny, "TIME_VARYING": int(time_varying),
    }  # fmt: skip
    lines = [
        "#include <math.h>",
        "#include <stdarg.h>",
        "#include <stdio.h>",
        "#include <stdlib.h>",
        "#include <string.h>",
        '#include "fmi2Functions.h"',
        f'#define MODEL_GUID "{guid}"',
        *(f"#define {name} {value}" for name, value in sizes.items()),
        "typedef struct {",
        f"    double r[{max(sizes['NREAL'], 1)}], k[NK], time, tolerance, step;",
        "    int fresh, phase;",
        "    unsigned char started[NXX];",
        f"    double jx[{max(sizes['NROW'] * (nx + nu), 1)}], jp[{max(sizes['NROW'] * np_, 1)}];",
        "} Model;",
        f"static const double nominal[NXX] = {{{', '.join(map(repr, nominals)) or '0'}}};",
        "static void set_defaults(Model *m) {",
        *(set_defaults or ["    (void)m;"]),
        "}",
        *functions,
        files("aero_bayes.export").joinpath("native", "runtime.c").read_text(encoding="utf-8"),
    ]
    return "\n".join(lines)


def _attribute(v: Variable, key: str, values: dict[Node, float], otherwise: float) -> float:
    node = v.attributes.get(key)
    return otherwise if node is None else evaluate([node], values)[0]


def _jacobian(b: Builder, rows: Sequence[Node], columns: Sequence[Node], stage: _Stages, place: str) -> list[_Target]:
    targets = []
    for j, symbol in enumerate(columns):
        memo: dict[Node, Node] = {}
        for i, row in enumerate(rows):
            if symbol in b.symbols(row):
                slope = stage.reciprocal(b.derivative(row, symbol, memo))
                if slope is not b.zero:
                    targets.append(_Target(f"{place}[{j * len(rows) + i}]", slope))
    return targets


def _function(name: str, targets: Sequence[_Target], leaves: dict[Node, str], kept: dict[Node, str]) -> str:
    writer = _Writer({**leaves, **kept})
    writer.write([t.node for t in targets])
    stores = [f"    {t.place} = {writer.term(t.node)};" for t in targets]
    body = [*writer.lines, *stores] or ["    (void)m;"]
    return "\n".join([f"static void eval_{name}(Model *restrict m) {{", *body, "}"])


def _start_function(
    starts: Sequence[tuple[int, Node]], states: frozenset[Node], b: Builder, leaves: dict[Node, str]
) -> str:
    """Initial values that depend on parameters, then those that depend on other states' initial values."""
    lines: list[str] = []
    for later in (False, True):
        group = [(i, n) for i, n in starts if bool(b.symbols(n) & states) is later]
        writer = _Writer(leaves)
        writer.write([n for _, n in group])
        stores = [f"    if (!m->started[{i}]) m->r[{i}] = {writer.term(n)};" for i, n in group]
        lines += ["    {", *writer.lines, *stores, "    }"] if group else []
    return "\n".join(["static void eval_start(Model *m) {", *(lines or ["    (void)m;"]), "}"])


class _Stages:
    """Tells expressions of parameters alone from the rest, and turns division by one into multiplication."""

    def __init__(self, builder: Builder, parameters: frozenset[Node]) -> None:
        self.builder = builder
        self.parameters = parameters
        self._memo: dict[Node, Node] = {}

    def early(self, node: Node) -> bool:
        return self.builder.symbols(node) <= self.parameters

    def reciprocal(self, node: Node) -> Node:
        b = self.builder
        for n in topological([node], self._memo):
            args = tuple(self._memo[a] for a in n.args)
            if n.op == "div" and self.early(args[1]) and not self.early(args[0]):
                self._memo[n] = b.mul(args[0], b.div(b.one, args[1]))
            else:
                self._memo[n] = b.apply(n, args) if n.args else n
        return self._memo[node]

    def saved(self, nodes: Sequence[Node]) -> list[Node]:
        """Early expressions (no plain symbols or constants) that late ones or the results use directly."""
        found: dict[Node, None] = {}

        def consider(n: Node) -> None:
            if n.args and self.early(n):
                found.setdefault(n)

        for n in nodes:
            consider(n)
        for n in topological(nodes, {}, lambda n: not self.early(n)):
            if not self.early(n):
                for a in n.args:
                    consider(a)
        return sorted(found, key=lambda n: n.index)
