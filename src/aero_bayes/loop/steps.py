"""The search told as steps: one for each term that was chosen, with the other candidates, their gains and odds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from aero_bayes.search.explored import SearchResult
from aero_bayes.search.models import FittedModel
from aero_bayes.search.score import UNLISTED_PROBABILITY, odds
from aero_bayes.search.structure import Structure


@dataclass(frozen=True)
class StepCandidate:
    """A term beside those of the steps before: its gain in log-evidence, and its odds.

    ``refitted`` is False where its starts promised too little for a fit.
    """

    id: str
    port: str
    gain: float
    odds: float
    refitted: bool = True


@dataclass(frozen=True)
class Step:
    """What one term is worth beside those before it.

    ``threshold`` is the least gain that counts; ``equivalent`` are terms that the data do not tell from the chosen one;
    ``nothing`` and ``untried`` are the odds of no term and of one that no candidate is.
    """

    number: int
    candidates: tuple[StepCandidate, ...]
    threshold: float
    chosen: str | None
    equivalent: tuple[str, ...]
    why: str
    nothing: float
    untried: float

    def to_dict(self) -> dict[str, object]:
        """The entry of result.json."""
        candidates = [
            {
                "id": rival.id,
                "port": rival.port,
                "delta_evidence": rival.gain if math.isfinite(rival.gain) else None,
                "refitted": rival.refitted,
                "odds": rival.odds,
            }
            for rival in self.candidates
        ]
        return {
            "round": self.number,
            "candidates": candidates,
            "threshold": self.threshold,
            "chosen": self.chosen,
            "equivalent": list(self.equivalent),
            "odds": {"nothing": self.nothing, "untried": self.untried},
            "why": self.why,
        }


def in_order(explored: SearchResult, fitted: FittedModel) -> tuple[str, ...]:
    """Terms of a structure, those first that would be missed most."""
    return tuple(sorted(fitted.terms, key=lambda t: (-loss_without(explored, fitted, t), t)))


def loss_without(explored: SearchResult, fitted: FittedModel, id_: str) -> float:
    """Log-evidence that a structure loses without one of its terms; NaN where that was not fitted."""
    rest = explored.fits.get(fitted.structure.minus(id_))
    return fitted.log_evidence - rest.log_evidence if rest is not None else math.nan


def equivalents(explored: SearchResult, fitted: FittedModel, id_: str, within: float) -> tuple[str, ...]:
    """A term and those that could replace it without a loss of evidence, best first.

    A refinement of the term holds it as a special case, so that it does as well by itself: it is not listed.
    """
    rest = fitted.structure.minus(id_)
    rivals = [
        (f.log_evidence, new[0])
        for s, f in explored.fits.items()
        if s.contains(rest)
        and len(new := s.new_terms(rest)) == 1
        and f.log_evidence > fitted.log_evidence - within
        and explored.refines.get(new[0]) != id_
    ]
    others = [other for _, other in sorted(rivals, reverse=True) if other != id_]
    return (id_, *others)


def steps_of(explored: SearchResult, fitted: FittedModel, within: float) -> tuple[Step, ...]:
    """One step for each term, and one more that says what was tried beside them."""
    found: list[Step] = []
    base = fitted.structure.minus(*fitted.terms)
    for id_ in (*in_order(explored, fitted), None):
        step = step_of(explored, base, id_, len(found) + 1, within)
        if step is not None:
            found.append(step)
        base = base.plus(id_) if id_ is not None else base
    return tuple(found)


def step_of(explored: SearchResult, base: Structure, id_: str | None, number: int, within: float) -> Step | None:
    """What a term is worth beside a structure, with its rivals there; None where that structure was not fitted."""
    here = explored.fits.get(base)
    if here is None:
        return None
    gains = {
        s.new_terms(base)[0]: f.log_evidence - here.log_evidence
        for s, f in explored.fits.items()
        if s.contains(base) and len(s.new_terms(base)) == 1
    }
    unfitted = {
        s.new_terms(base)[0]: max(gain, 0.0)
        for s, gain in explored.predicted_gains.items()
        if s.contains(base) and len(s.new_terms(base)) == 1
    }
    ranked = sorted(gains, key=lambda t: (-gains[t], t))
    every = [*ranked, *(t for t in sorted(unfitted) if t not in gains)]
    # A refinement and a curve have the smaller prior, as in the search.
    priors = {t: explored.penalty.of_one - explored.penalty.of_term(t) for t in every}
    shares, nothing = odds([gains.get(t, 0.0) + priors[t] for t in every])
    rivals = tuple(
        StepCandidate(t, explored.ports.get(t, ""), gains.get(t, unfitted.get(t, 0.0)), share, t in gains)
        for t, share in zip(every, shares, strict=True)
    )
    penalty = explored.penalty.of_term(id_) if id_ is not None else explored.penalty.of_one
    if id_ is not None and id_ in gains:
        near = (t for t in ranked if t != id_ and gains[t] > gains[id_] - within)
        same = (id_, *(t for t in near if explored.refines.get(t) != id_))
        why = f"{id_} gains {gains[id_]:.1f} in log-evidence (needed: {penalty:.1f})"
        why += f"; the data cannot tell it from {', '.join(same[1:])}" if len(same) > 1 else ""
        return Step(number, rivals, penalty, id_, same, why, nothing, UNLISTED_PROBABILITY)
    if not ranked:
        return Step(
            number,
            (),
            penalty,
            None,
            (),
            "no candidate is expected to gain log-evidence",
            nothing,
            UNLISTED_PROBABILITY,
        )
    best = f"the best, {ranked[0]}, gains {gains[ranked[0]]:z.1f}"
    return Step(
        number,
        rivals,
        penalty,
        None,
        (),
        f"no candidate gains the needed {penalty:.1f} in log-evidence; {best}",
        nothing,
        UNLISTED_PROBABILITY,
    )
