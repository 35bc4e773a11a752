"""The decision of the closed loop: model and claims, a pure function of a table of errors.

``structures.json`` holds such a table; ``python -m aero_bayes.loop.decide FILE`` decides on it again.

1. A structure is *admissible* if each of its terms is material: it lowers the left-out error of an output by a quarter
   (a curve beside other terms by a third), clearly, against the best structure without it.
2. The *size* is the smallest whose best admissible structure no larger admissible one materially beats.
3. The *model* predicts: of that size the best, or one as good with fewer curves, then fewer parameters. Unseen
   recordings only refuse: one that they show to be worse than the best by a quarter is not as good, and where they take
   back half of what a term has to gain against a smaller structure, the next one, or a smaller size, is the model.
4. A *claim* says what may be said of a term of the model. All that was tried in its place is held against it. ``law``:
   nothing else does as well. ``place``: all that do are at its port. ``one of``: they are listed. Nothing leaves the
   model because it cannot be told.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aero_bayes.loop.table import MATERIAL, Table, Terms, law_of

ClaimKind = Literal["law", "place", "one of"]

#: A curve beside other terms has to lower it by a third: with so many parameters it always takes up something.
MATERIAL_CURVE = 0.67
#: Share of the gain that a simpler model of the same size may give away: fits and blocks are not more exact.
AS_GOOD = 0.05
#: Share of the gain of a curve that a law in its place may give away: a curve takes up what else is missing, too.
CURVE_LOSS = 0.25
#: Models that unseen recordings may refuse: of more, one would pass by chance.
MOST_REFUSED = 5


@dataclass(frozen=True)
class Claim:
    """What is said of a term of the model.

    ``share`` is the error with the term over that without it, in the output ``share_of`` where it falls most.
    ``alternatives`` are the terms that do as well in its place, each with the error with it over that with the term."""

    kind: ClaimKind
    share: float
    share_sd: float
    share_of: str
    alternatives: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Decision:
    """The model, a claim for each of its terms, and the models that unseen recordings refused.

    ``compared`` are the structures on whose left-out errors it hangs, ``compared_unseen`` on whose unseen ones."""

    model: Terms
    claims: Mapping[str, Claim]
    refused: tuple[Terms, ...]
    compared: tuple[Terms, ...]
    compared_unseen: tuple[Terms, ...]


def decide(table: Table, required: Iterable[str] = ()) -> Decision:
    """Choose the model, and say what may be claimed of each of its terms; no claims are made of ``required`` ones.

    The table has to hold the structure of the required terms alone."""
    first = tuple(sorted(required))
    allowed = {k for k in table.rows if k == first or (set(first) < set(k) and admissible(table, k, first))}
    refused: list[Terms] = []
    compared, unseen = dict.fromkeys([(), first]), dict.fromkeys([(), first])
    while True:
        best = table.best_of_size(allowed)
        size = min(n for n in best if not any(m > n and table.material(best[m], best[n]) for m in best))
        compared |= dict.fromkeys(best.values())
        # One Newton step may hide that a term is material: the best of each size is fitted again in any case.
        compared |= dict.fromkeys(table.best_of_size(k for k in table.rows if set(first) < set(k)).values())
        if size == len(first) or len(refused) > MOST_REFUSED:
            return Decision(first, {}, tuple(refused), tuple(compared), tuple(unseen))
        near = _as_good(table, best[size], [k for k in allowed if len(k) == size])
        model = next(k for k in near if k == best[size] or not worse_unseen(table, k, best[size], 1.0))
        passed_over = near[: near.index(model)]
        smaller = [first, *(best[n] for n in best if n < size)]
        unseen |= dict.fromkeys((*passed_over, model, best[size], *smaller))
        if not any(worse_unseen(table, model, k) for k in smaller):
            break
        refused.append(model)
        allowed.discard(model)
    claims = {t: claim(table, model, t) for t in model if t not in first}
    others = [tuple(sorted({*model, o} - {t})) for t, c in claims.items() for o, _ in c.alternatives]
    parts = [table.without(model, t) for t in claims]
    compared |= dict.fromkeys((model, *parts, *others))
    refused += passed_over
    return Decision(model, claims, tuple(refused), tuple(compared), tuple(unseen))


def admissible(table: Table, terms: Terms, required: Terms = ()) -> bool:
    """Whether each term that is not required is material beside the others; at most one of them is a curve."""
    own = [t for t in terms if t not in required]
    if sum(t in table.curves for t in own) > 1:
        return False
    limits = {t: MATERIAL_CURVE if t in table.curves and len(terms) > 1 else MATERIAL for t in own}
    return all(table.material(terms, table.without(terms, t), limits[t]) for t in own)


def worse_unseen(table: Table, one: Terms, other: Terms, part: float = 0.5) -> bool:
    """Whether one structure predicts unseen recordings materially worse than another.

    It does so if it is worse over all outputs, and in one of them by a part of what a term has to gain."""
    first, second = table.rows[one].unseen, table.rows[other].unseen
    if first is None or not second:
        return False
    logs = [math.log(max(first[o], 1e-300) / max(second[o], 1e-300)) for o in first if o in second]
    return not logs or (sum(logs) > 0.0 and max(logs) > -part * math.log(MATERIAL))


def _as_good(table: Table, best: Terms, among: Iterable[Terms]) -> list[Terms]:
    """Structures as good as the best of their size, those with the fewest curves first, then the fewest parameters."""
    gain = min(table.score(k) for k in table.rows if len(k) < len(best)) - table.score(best)
    near = [k for k in among if table.score(k) - table.score(best) <= AS_GOOD * gain or not table.clear(best, k)]
    return sorted(near, key=lambda k: (sum(t in table.curves for t in k), table.rows[k].free, table.order(k)))


def claim(table: Table, model: Terms, term: str) -> Claim:
    """Say what is known of a term: its law, its place, or that it is one of several."""
    part, own = table.without(model, term), table.ports.get(term)
    gain = table.score(part) - table.score(model)
    limit = max(CURVE_LOSS * gain, -math.log(MATERIAL)) if term in table.curves else -math.log(MATERIAL)
    one_curve = sum(t in table.curves for t in model if t != term) == 0
    swaps = {o: d for o, d in table.swaps(model, term).items() if one_curve or o not in table.curves}
    alike = {o: d for o, d in swaps.items() if d <= limit and d < gain}
    # A curve at the port of a law says the same: it is no other place, and no other law.
    other = [o for o in alike if not (o in table.curves and table.ports.get(o) == own)]
    coarse = table.refines.get(term, term)
    kin = {law_of(term), law_of(coarse), *(law_of(f) for f, c in table.refines.items() if c == coarse)}
    kind: ClaimKind = "one of"
    if all(law_of(o) in kin for o in other) and _stands_alone(table, model, term):
        kind = "law"
    elif all(table.ports.get(o) == own for o in other):
        kind = "place"
    return Claim(kind, *table.share(model, part), tuple((o, math.exp(d)) for o, d in alike.items()))


def _stands_alone(table: Table, model: Terms, term: str) -> bool:
    """Whether a law lowers the error without the curve of the model, too: beside one almost anything does."""
    laws = tuple(t for t in model if t not in table.curves)
    if laws == model or term in table.curves:
        return laws == model
    rest = tuple(t for t in laws if t != term)
    return laws in table.rows and rest in table.rows and table.score(laws) < table.score(rest)


def _told(table: Table) -> str:
    """A decision in lines."""
    found = decide(table)
    ratio = math.exp(table.score(found.model) - table.score(()))
    lines = [
        f"{', '.join(found.model) or 'no further term'} of {len(table.rows)} structures: left-out error x {ratio:.3g}"
    ]
    lines += [f"  refused by unseen recordings: {', '.join(k)}" for k in found.refused]
    for term, one in found.claims.items():
        others = ", ".join(f"{id_} ({error:.2f})" for id_, error in one.alternatives)
        lines.append(f"  {term}: {one.kind}, error of {one.share_of} x {one.share:.2f} (+- {one.share_sd:.2f})")
        lines[-1] += f"; or {others}" if others else ""
    return "\n".join(lines)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(f"{name}: {_told(Table.of(json.loads(Path(name).read_text())))}")
