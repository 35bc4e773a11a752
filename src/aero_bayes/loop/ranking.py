"""Rank the candidates of each step of the search by their left-out errors: one step for each chosen term."""

from __future__ import annotations

from dataclasses import dataclass

from aero_bayes.judge.choice import Choice
from aero_bayes.search.comparison import Share
from aero_bayes.search.structure import Structure


@dataclass(frozen=True)
class StepCandidate:
    """A term beside those of the steps before: the left-out error with it over that without it.

    ``wins`` is the share of resampled blocks in which it is the best of its step; ``refitted`` whether it was fitted
    again without each block, else its error is that of one Newton step."""

    id: str
    port: str
    share: float
    share_sd: float
    wins: float
    refitted: bool = True


@dataclass(frozen=True)
class Step:
    """What one term is worth beside those before it.

    ``equivalent`` are terms that the data do not tell from the chosen one."""

    number: int
    candidates: tuple[StepCandidate, ...]
    chosen: str | None
    equivalent: tuple[str, ...]
    why: str

    def to_dict(self) -> dict[str, object]:
        """Return the entry of result.json."""
        candidates = [
            {
                "id": rival.id,
                "port": rival.port,
                "share": rival.share,
                "share_sd": rival.share_sd,
                "wins": rival.wins,
                "refitted": rival.refitted,
            }
            for rival in self.candidates
        ]
        return {
            "round": self.number,
            "candidates": candidates,
            "chosen": self.chosen,
            "equivalent": list(self.equivalent),
            "why": self.why,
        }


def steps_of(choice: Choice) -> tuple[Step, ...]:
    """Return one step for each chosen term, and one more that says what was tried beside them."""
    found: list[Step] = []
    base = choice.structure.minus(*choice.structure.terms)
    for id_ in (*choice.terms, None):
        if base in choice.ranking.squares:
            found.append(_step(choice, base, id_, len(found) + 1))
        base = base.plus(id_) if id_ is not None else base
    return tuple(found)


def _step(choice: Choice, base: Structure, id_: str | None, number: int) -> Step:
    ranking, true = choice.ranking, choice.comparison
    beside = {s.new_terms(base)[0]: s for s in ranking.squares if s.contains(base) and len(s.new_terms(base)) == 1}
    wins = ranking.wins([base, *beside.values()])
    rivals = []
    for term, structure in beside.items():
        refitted = structure in true.squares and base in true.squares
        share = (true if refitted else ranking).share(structure, base)
        rivals.append(
            StepCandidate(term, choice.explored.ports.get(term, ""), share.value, share.sd, wins[structure], refitted)
        )
    rivals.sort(key=lambda r: (r.share, r.id))
    same = choice.alike(id_) if id_ is not None else ()
    return Step(number, tuple(rivals), id_, same, _why(choice, rivals, id_, same))


def _why(choice: Choice, rivals: list[StepCandidate], id_: str | None, same: tuple[str, ...]) -> str:
    if id_ is not None:
        share = choice.share(id_)
        why = f"with {id_} the error of {share.output} on left-out readings {share.fall}"
        return why + (f"; the data do not tell it from {', '.join(same[1:])}" if len(same) > 1 else "")
    if not rivals:
        return "no further candidate was worth a fit"
    best = rivals[0]
    return (
        f"no further term is material; with the best, {best.id}, the error on left-out readings "
        f"{Share(best.share, best.share_sd, '').fall}"
    )
