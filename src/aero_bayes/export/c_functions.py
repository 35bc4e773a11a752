"""C functions of a generated model: each evaluates expressions and stores the values in the model's structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aero_bayes.export.c_writer import ExpressionWriter
from aero_bayes.export.causalisation import ExplicitModel
from aero_bayes.export.expression import Builder, Node

#: Values that a function stores at most, where it is long and can be cut.
_PART = 100


@dataclass(frozen=True)
class StoredValue:
    """Where a value goes in the structure."""

    place: str
    node: Node


def loop_function(k: int | str, targets: Sequence[StoredValue], leaves: dict[Node, str]) -> str:
    """Return the function of one algebraic loop: its residuals into ``f``, their Jacobian by columns into ``j``."""
    writer = ExpressionWriter(leaves)
    writer.write([t.node for t in targets])
    stores = [f"    {t.place} = {writer.term(t.node)};" for t in targets]
    head = f"static void eval_loop_{k}(const Model *restrict m, double *restrict f, double *restrict j) {{"
    return "\n".join([head, "    (void)m;", *writer.lines, *stores, "}"])


def assertion_function(conditions: Sequence[Node], leaves: dict[Node, str]) -> str:
    """Return the function that marks the assertions that do not hold, and tells whether there are any."""
    writer = ExpressionWriter(leaves)
    writer.write(conditions)
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
    writer = ExpressionWriter(leaves)
    writer.write(prepared)
    lines = [
        f"    if ({writer.term(active)}) {{ {leaves[r.state]} = {writer.term(value)}; any = 1; }}"
        for r, active, value in zip(model.discrete.reinits, prepared[::2], prepared[1::2], strict=True)
    ]
    return "\n".join(
        [
            "static int eval_reinit(Model *m) {",
            "    int any = 0; (void)m;",
            *writer.lines,
            *lines,
            "    return any;",
            "}",
        ]
    )


def store_function(
    name: str,
    targets: Sequence[StoredValue],
    leaves: dict[Node, str],
    kept: dict[Node, str],
) -> str:
    """Return a function that stores values; in several where it is long and they share little.

    The time that a compiler takes for a function grows with the square of its length."""

    def body(part: Sequence[StoredValue]) -> list[str]:
        writer = ExpressionWriter({**leaves, **kept})
        writer.write([t.node for t in part])
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
        writer = ExpressionWriter(leaves)
        writer.write([n for _, _, n in group])
        stores = [f"    if (!{set_}) {place} = {writer.term(n)};" for place, set_, n in group]
        lines += ["    {", *writer.lines, *stores, "    }"] if group else []
    writer = ExpressionWriter(leaves)
    writer.write([n for _, _, n in steps])
    lines += [*writer.lines, *(f"    {pre} = {now} = {writer.term(n)};" for pre, now, n in steps)]
    return "\n".join(["static void start(Model *m) {", *(lines or ["    (void)m;"]), "}"])
