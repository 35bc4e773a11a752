"""The finite set of values of an expression whose value depends on branches only (constant propagation)."""

from __future__ import annotations

from itertools import product

from aero_bayes.export.expression import Builder, Node, topological_order

LIMIT = 256


def possible_values(b: Builder, node: Node) -> frozenset[float] | None:
    """Return every value that ``node`` can take, and maybe more; None where these are not a few numbers."""
    known: dict[Node, frozenset[float] | None] = {}
    for n in topological_order([node], known):
        known[n] = _of(b, n, known)
    return known[node]


def _of(b: Builder, n: Node, known: dict[Node, frozenset[float] | None]) -> frozenset[float] | None:
    if n.op == "const":
        return frozenset((n.value,))
    args = [known[a] for a in n.args]
    if n.op == "select":
        then, otherwise = args[1:]
        return None if then is None or otherwise is None else then | otherwise
    if n.op in ("and", "or") and (sure := frozenset((float(n.op == "or"),))) in args:
        return sure
    found: set[float] = set()
    sets = [a for a in args if a is not None]
    if not sets or len(sets) < len(args):
        return None
    for values in product(*sets):
        if len(found) >= LIMIT:
            return None
        result = b.apply(n, tuple(map(b.const, values)))
        if result.op != "const":
            return None
        found.add(result.value)
    return frozenset(found)
