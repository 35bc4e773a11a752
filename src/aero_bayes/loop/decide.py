"""The decision of the closed loop: model and claims, a pure function of a table of errors.

``structures.json`` holds such a table; ``python -m aero_bayes.loop.decide FILE`` decides on it again.

Two witnesses speak of a structure: the error on left-out training readings, and the error on validation readings. The
score is, for each output, the geometric mean of both ratios to the first model; outputs count by sum of logarithms.

1. A term is *material* if it improves the best structure without it: the score of an output falls by a quarter (with a
   curve beside other terms by a third), clearly, and each witness of that output by a tenth. No witness of any other
   output rises by 2 %.
2. A structure is *admissible* if each of its terms is material, at most one is a curve, ten training readings come on
   each free parameter, and no structure within it validates better. Two terms may explain what neither does alone;
   three or more are admissible only if they are so without one of them (heredity), since some set fits by chance.
3. The *size* is the smallest whose best admissible structure no larger admissible one materially beats.
4. The *model* is the best of that size, or one as good with fewer curves, then fewer parameters.
5. A *claim* says what may be said of a term, and changes nothing in the model. Held against it is all that does as well
   in its place by the score, or by one of the witnesses. ``law``: nothing else does. ``place``: all that do are at its
   port. ``mechanism``: only the same law elsewhere does. ``one of``: they are listed.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from aero_bayes.laws.law_places import is_held
from aero_bayes.loop.table import MATERIAL, Structure, Table, law_of

ClaimKind = Literal["law", "place", "mechanism", "one of"]

#: A curve beside other terms has to lower it by a third: with so many parameters it always takes up something.
MATERIAL_CURVE = 0.67
#: Training readings that a structure needs for each free parameter: with fewer one of many fits by chance.
READINGS_EACH = 10
#: Terms that may be admissible together though none is alone.
PAIR = 2
#: Share of the gain that a simpler model of the same size may give away: fits and blocks are not more exact.
AS_GOOD = 0.05
#: Share of the gain of a curve that a law in its place may give away: a curve takes up what else is missing, too.
CURVE_LOSS = 0.25


@dataclass(frozen=True)
class Claim:
    """What is said of a term of the model.

    ``share`` is the left-out error with the term over that without it, in the output ``share_of``. ``alternatives`` are
    the terms that do as well in its place, each with the score with it over that with the term. ``tried_all`` says that
    everything offered was tried there."""

    kind: ClaimKind
    share: float
    share_sd: float
    share_of: str
    alternatives: tuple[tuple[str, float], ...] = ()
    tried_all: bool = True


@dataclass(frozen=True)
class Decision:
    """The model, and a claim for each of its terms.

    ``refused`` are structures that predict left-out training readings materially better and validation readings worse.
    The decision hangs on the left-out errors of the structures that were ``compared``."""

    model: Structure
    claims: Mapping[str, Claim]
    refused: tuple[Structure, ...]
    compared: tuple[Structure, ...]


def decide(table: Table, required: Iterable[str] = ()) -> Decision:
    """Choose the model, and say what may be claimed of each of its terms; no claims are made of ``required`` ones.

    The table has to hold the structure of the required terms alone, and that of none."""
    first = tuple(sorted(required))
    offered = [k for k in table.rows if set(first) <= set(k)]
    allowed = [k for k in offered if k == first or admissible(table, k, first)]
    best = table.best_of_size(allowed)
    size = min(n for n in best if not any(m > n and table.material(best[m], best[n]) for m in best))
    model = first if size == len(first) else _simplest(table, best[size], [k for k in allowed if len(k) == size])
    claims = {t: claim(table, model, t) for t in model if t not in first}
    # One Newton step may hide that a term is material: the best of each size is fitted again in any case, as is what
    # comes near the model.
    compared = [(), first, *best.values(), *table.best_of_size(offered).values(), model]
    near = table.score(model) - math.log(MATERIAL)
    compared += [k for k in allowed if len(k) == len(model) and table.score(k) <= near]
    compared += [table.without(model, t) for t in claims]
    compared += [tuple(sorted({*model, o} - {t})) for t, c in claims.items() for o, _ in c.alternatives]
    return Decision(model, claims, refused(table, model, offered), tuple(dict.fromkeys(compared)))


def admissible(table: Table, terms: Structure, required: Structure = ()) -> bool:
    """Whether each term that is not required is material beside the others, and nothing within validates better."""
    own = [t for t in terms if t not in required]
    few = table.readings is not None and READINGS_EACH * table.rows[terms].free > table.readings
    if few or sum(t in table.curves for t in own) > 1:
        return False
    within = [k for k in table.rows if set(k) < set(terms)]
    smaller = (k for k in within if len(k) + 1 == len(terms) and set(required) <= set(k))
    by_chance = len(own) > PAIR and not any(admissible(table, k, required) for k in smaller)
    if by_chance or any(table.validated(k) < table.validated(terms) for k in within):
        return False
    limits = {t: MATERIAL_CURVE if t in table.curves and len(terms) > 1 else MATERIAL for t in own}
    return all(table.material(terms, table.without(terms, t), limits[t]) for t in own)


def refused(table: Table, model: Structure, offered: Iterable[Structure]) -> tuple[Structure, ...]:
    """Structures that predict left-out training readings better than the model by a quarter, and validate worse."""
    left_out, confirmed = table.witnesses(model)[0].sum(), table.validated(model)
    found = [
        k for k in offered
        if table.witnesses(k)[0].sum() < left_out + math.log(MATERIAL) and table.validated(k) > confirmed
    ]  # fmt: skip
    return tuple(sorted(found, key=lambda k: (float(table.witnesses(k)[0].sum()), k)))


def _simplest(table: Table, best: Structure, among: Iterable[Structure]) -> Structure:
    """The structure as good as the best of its size that has the fewest curves, then the fewest parameters."""
    gain = min(table.score(k) for k in table.rows if len(k) < len(best)) - table.score(best)

    def bent(terms: Structure) -> int:
        return sum(t in table.curves for t in terms)

    def as_good(k: Structure) -> bool:
        given_away = CURVE_LOSS if bent(k) < bent(best) else AS_GOOD
        return table.score(k) - table.score(best) <= given_away * gain or not table.clear(best, k)

    return min(filter(as_good, among), key=lambda k: (bent(k), table.rows[k].free, table.order(k)))


def claim(table: Table, model: Structure, term: str) -> Claim:
    """Say what is known of a term: its law and place, its place, its law, or that it is one of several."""
    part, own = table.without(model, term), table.ports.get(term)
    gain = table.score(part) - table.score(model)
    limit = max(CURVE_LOSS * gain, -math.log(MATERIAL)) if term in table.curves else -math.log(MATERIAL)
    one_curve = sum(t in table.curves for t in model if t != term) == 0
    swaps = {o: d for o, d in table.swaps(model, term).items() if one_curve or o not in table.curves}
    alike = {o: d for o, d in swaps.items() if d < gain and (d <= limit or _preferred(table, model, term, o))}
    # A curve at the port of a law says the same: it is no other place, and no other law. Nor is a finer form of it.
    other = [o for o in alike if not (table.ports.get(o) == own and (o in table.curves or _same_law(table, term, o)))]
    kind: ClaimKind = "one of"
    if not other and term not in table.curves and _stands_alone(table, model, term):
        kind = "law"
    elif all(table.ports.get(o) == own for o in other):
        kind = "place"
    elif all(_same_law(table, term, o) for o in other) and _stands_alone(table, model, term):
        kind = "mechanism"
    return Claim(kind, *table.share_of_term(model, term), tuple((o, math.exp(d)) for o, d in alike.items()))


def _preferred(table: Table, model: Structure, term: str, other: str) -> bool:
    """Whether one of the witnesses prefers another term in the place of a term."""
    swapped = tuple(sorted({*model, other} - {term}))
    return bool(np.any((table.witnesses(swapped) - table.witnesses(model)).sum(axis=1) <= 0.0))


def _same_law(table: Table, one: str, other: str) -> bool:
    """Whether two terms are one law, or forms of one that refine each other; another fixed value is another cause."""
    return not is_held(one) and law_of(table.refines.get(one, one)) == law_of(table.refines.get(other, other))


def _stands_alone(table: Table, model: Structure, term: str) -> bool:
    """Whether a law lowers the error without the curve of the model, too: beside one almost anything does."""
    laws = tuple(t for t in model if t not in table.curves)
    if laws == model or term in table.curves:
        return laws == model
    rest = tuple(t for t in laws if t != term)
    return laws in table.rows and rest in table.rows and table.score(laws) < table.score(rest)


def _told(table: Table) -> str:
    """A decision in lines."""
    found = decide(table)
    ratio, row = math.exp(table.score(found.model)), table.rows[found.model]
    lines = [f"{', '.join(found.model) or 'no further term'} of {len(table.rows)} structures: error x {ratio:.3g}"]
    first = table.rows[()].test
    lines += [f"  test error of {o}: {first[o]:.3g} -> {error:.3g}" for o, error in row.test.items() if o in first]
    lines += [f"  refused by validation: {', '.join(k)}" for k in found.refused]
    for term, one in found.claims.items():
        others = ", ".join(f"{id_} ({error:.2f})" for id_, error in one.alternatives)
        lines.append(f"  {term}: {one.kind}, error of {one.share_of} x {one.share:.2f} (+- {one.share_sd:.2f})")
        lines[-1] += f"; or {others}" if others else ""
    return "\n".join(lines)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(f"{name}: {_told(Table.of(json.loads(Path(name).read_text())))}")
