"""C functions that evaluate a model for several parameter vectors at a time, one in each lane of a vector register.

They are exported beside FMI's functions (native/lanes.h) for models whose equations hold without events and without
algebraic loops; an importer that does not know them sees no difference.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from aero_bayes.export.c_functions import StoredValue
from aero_bayes.export.c_writer import FUNCTIONS, INFIX, ExpressionWriter, number
from aero_bayes.export.expression import Node
from aero_bayes.language.values import BOOLEAN

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
