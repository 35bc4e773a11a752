"""The search told in rounds: each term of the model beside those before it, and what was tried in its place."""

from __future__ import annotations

from dataclasses import dataclass

from aero_bayes.loop.decide import Decision
from aero_bayes.search.table import Table, Terms


@dataclass(frozen=True)
class StepCandidate:
    """A term beside those of the rounds before: the left-out error with it over that without it.

    ``refitted`` is whether it was fitted again without each block, else its error is that of one Newton step."""

    id: str
    port: str
    share: float
    share_sd: float
    refitted: bool = True


@dataclass(frozen=True)
class Step:
    """What one term is worth beside those before it; ``equivalent`` are those that do as well in its place."""

    number: int
    candidates: tuple[StepCandidate, ...]
    chosen: str | None
    equivalent: tuple[str, ...]
    why: str

    def to_dict(self) -> dict[str, object]:
        """Return the entry of result.json."""
        own = {name: value for name, value in vars(self).items() if name != "number"}
        return {**own, "round": self.number, "candidates": [vars(one) for one in self.candidates]}


def steps_of(table: Table, decision: Decision, required: Terms) -> tuple[Step, ...]:
    """Return one step for each term of the model, the one that explains most first, and one for what is left."""
    found: list[Step] = []
    base, left = tuple(sorted(required)), [t for t in decision.model if t not in required]
    while base in table.rows:
        larger = (k for k in table.rows if len(k) == len(base) + 1 and set(base) < set(k))
        beside = {next(iter(set(k) - set(base))): k for k in larger}
        chosen = min((t for t in left if t in beside), key=lambda t: table.order(beside[t]), default=None)
        chosen = chosen or next(iter(left), None)
        rivals = [
            StepCandidate(t, table.ports.get(t, ""), *table.share(k, base)[:2], table.rows[k].refitted)
            for t, k in beside.items()
        ]
        rivals.sort(key=lambda one: (one.share, one.id))
        if chosen is None:
            if not rivals:
                break
            why = f"with {rivals[0].id} the error on left-out readings {fall(rivals[0].share, rivals[0].share_sd)}"
            return (*found, Step(len(found) + 1, tuple(rivals), None, (), f"no further term is in the model; {why}"))
        claim = decision.claims[chosen]
        alike = tuple(o for o, _ in claim.alternatives)
        why = f"with {chosen} the error of {claim.share_of} on left-out readings {fall(claim.share, claim.share_sd)}"
        why += f"; what else does as well: {', '.join(alike)}" if alike else ""
        found.append(Step(len(found) + 1, tuple(rivals), chosen, (chosen, *alike) if alike else (), why))
        left.remove(chosen)
        base = tuple(sorted((*base, chosen)))
    return tuple(found)


def fall(share: float, sd: float) -> str:
    """How far an error falls, in words."""
    verb, change = ("rises", share - 1.0) if share > 1.0 else ("falls", 1.0 - share)
    return f"{verb} by {100.0 * change:.0f} % (+- {100.0 * sd:.0f})"
