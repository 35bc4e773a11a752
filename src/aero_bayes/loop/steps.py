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
        return {
            "round": self.number, "candidates": [vars(one) for one in self.candidates], "chosen": self.chosen,
            "equivalent": list(self.equivalent), "why": self.why,
        }  # fmt: skip


def steps_of(table: Table, decision: Decision, required: Terms) -> tuple[Step, ...]:
    """Return one step for each term of the model, the one that explains most first, and one for what is left."""
    found: list[Step] = []
    base, left = tuple(sorted(required)), [t for t in decision.model if t not in required]
    while True:
        beside = {
            next(iter(set(k) - set(base))): k for k in table.rows if len(k) == len(base) + 1 and set(base) < set(k)
        }
        here = [t for t in left if t in beside]
        chosen = min(here, key=lambda t: table.order(beside[t]), default=next(iter(left), None))
        shares = {t: table.share(k, base) for t, k in beside.items()}
        rivals = sorted(
            (
                StepCandidate(t, table.ports.get(t, ""), *shares[t][:2], table.rows[k].refitted)
                for t, k in beside.items()
            ),
            key=lambda one: (one.share, one.id),
        )
        if chosen is not None or rivals:
            alike = (
                tuple(o for o, _ in decision.claims[chosen].alternatives)
                if chosen is not None and chosen in decision.claims
                else ()
            )
            why = _why(decision, chosen, rivals, alike)
            found.append(Step(len(found) + 1, tuple(rivals), chosen, (chosen, *alike) if chosen and alike else (), why))
        if chosen is None:
            return tuple(found)
        left.remove(chosen)
        base = tuple(sorted((*base, chosen)))
        if base not in table.rows:
            return tuple(found)


def _why(decision: Decision, chosen: str | None, rivals: list[StepCandidate], alike: tuple[str, ...]) -> str:
    if chosen is not None:
        one = decision.claims.get(chosen)
        if one is None:
            return f"{chosen} is required"
        text = f"with {chosen} the error of {one.share_of} on left-out readings {fall(one.share, one.share_sd)}"
        return text + (
            f"; {', '.join(alike)} do as well" if len(alike) > 1 else f"; {alike[0]} does as well" if alike else ""
        )
    best = rivals[0]
    change = fall(best.share, best.share_sd)
    return f"no further term is in the model; with {best.id} the error on left-out readings {change}"


def fall(share: float, sd: float) -> str:
    """How far an error falls, in words."""
    verb, change = ("rises", share - 1.0) if share > 1.0 else ("falls", 1.0 - share)
    return f"{verb} by {100.0 * change:.0f} % (+- {100.0 * sd:.0f})"
