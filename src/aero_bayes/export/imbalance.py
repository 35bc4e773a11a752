"""Names the variables determined by too few or too many equations (Dulmage-Mendelsohn decomposition), with the file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
import scipy  # imports its parts when they are first used

from aero_bayes.errors import InputError
from aero_bayes.export.equation_system import translate
from aero_bayes.export.flat import FlatModel
from aero_bayes.language.syntax import names_in

#: Begins the names of what is added to a model so that rumoca, which refuses an imbalance, flattens it.
ADDED = "added_unknown_"
#: Names that a message lists at most.
MAX_LISTED = 6


def balanced_model(model: str, missing: int) -> str:
    """Return a model with as many further equations, or further unknowns, as it takes for equally many of both."""
    lines = ["  time = 0;"] * missing if missing > 0 else [f"  Real {ADDED}{k};" for k in range(-missing)]
    return "\n".join(
        ["model Balanced", f"  extends {model};", *(["equation"] if missing > 0 else []), *lines, "end Balanced;\n"]
    )


def explain_imbalance(name: str, flat: FlatModel) -> InputError | None:
    """Return the error of a model that was flattened with :func:`balanced_model`.

    None where its structure does not tell."""
    system = translate(flat)
    b = system.builder
    unknowns = [b.symbol(v.name) for v in system.variables if v.name not in system.derivatives]
    unknowns = [u for u in unknowns if not u.name.startswith(ADDED)] + list(system.derivatives.values())
    index = {u: k for k, u in enumerate(unknowns)}
    rows = [found for r in system.residuals if (found := [index[s] for s in b.symbols(r) if s in index])]
    columns: list[list[int]] = [[] for _ in unknowns]
    for k, row in enumerate(rows):
        for u in row:
            columns[u].append(k)
    ends = np.cumsum([0, *map(len, rows)])
    entries = (np.ones(ends[-1]), [u for row in rows for u in row], ends)
    graph = scipy.sparse.csr_array(entries, shape=(len(rows), len(unknowns)))
    unknown_of = scipy.sparse.csgraph.maximum_bipartite_matching(graph, perm_type="column").tolist()
    equation_of = {u: k for k, u in enumerate(unknown_of) if u >= 0}
    few = _reached([u for u in range(len(unknowns)) if u not in equation_of], columns, unknown_of)
    many = [unknown_of[k] for k in _reached([k for k, u in enumerate(unknown_of) if u < 0], rows, equation_of)]
    count = f"{name}: {len(rows)} equations for {len(unknowns)} unknowns: "
    if few:
        listed = [unknowns[u].name for u in sorted(few)]
        places = [v.place for v in flat.variables if v.place is not None and v.name in _plain(listed)]
        return InputError(f"{places[0] if places else name}: {count}too few equations determine {_some(listed)}")
    listed = [unknowns[u].name for u in sorted(set(many)) if u >= 0]
    told = [
        e.place
        for e in flat.equations
        if e.place and _plain(listed) & {n for t in (e.left, e.right) for n in names_in(t)}
    ]
    return InputError(f"{told[-1]}: {count}too many equations determine {_some(listed)}") if told else None


def _reached(free: Sequence[int], across: Sequence[Sequence[int]], back: Sequence[int] | dict[int, int]) -> list[int]:
    """Return all that could be left over in place of ``free``, by exchanges along the matching."""
    found = dict.fromkeys(free)
    open_ = list(free)
    while open_:
        for other in across[open_.pop()]:
            partner = back[other]
            if partner not in found:
                found[partner] = None
                open_.append(partner)
    return list(found)


def _plain(names: Iterable[str]) -> set[str]:
    """Return variables by the names of their elements and derivatives."""
    return {re.sub(r"^der\(|\)$|\[[\d,]*\]", "", name) for name in names}


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:MAX_LISTED]) + (f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else "")
