"""Choose a structure: rank all by the closed form, fit the finalists again without each block, decide."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum
from aero_bayes.judge.choice import Choice, ChoiceSettings, Judge, residual_reports
from aero_bayes.judge.comparison import Comparison
from aero_bayes.judge.left_out import CommonBlocks, newton_errors, refitted_errors
from aero_bayes.parallel import Task
from aero_bayes.search.explored import Mapper, SearchResult, one_by_one
from aero_bayes.search.models import FittedModel
from aero_bayes.search.structure import Structure

FloatArray = NDArray[np.float64]

#: Structures that are fitted again without each block: more than ten cost more than the search.
FINALISTS = 10
#: Rounds in which the choice may change because of structures that were fitted for it.
MAX_ROUNDS = 4


@dataclass(eq=False)
class Chooser:
    """Chooses a structure of those that a search explored.

    Parameters
    ----------
    settings : ChoiceSettings
    fit : LocalFitSettings
        Of the fits without a block.
    complete : callable
        Fits a structure without each of its terms where that is worse than it must be, and gives all that was found.
    map : Mapper
        Does independent tasks, perhaps in parallel.
    told : callable
        Told the share of the refits that is done.
    """

    settings: ChoiceSettings
    fit: LocalFitSettings
    complete: Callable[[FittedModel], SearchResult]
    map: Mapper = one_by_one
    told: Callable[[float], None] = lambda share: None

    def __post_init__(self) -> None:
        self._known: dict[Structure, tuple[Optimum, FloatArray]] = {}

    def choose(self, explored: SearchResult) -> Choice:
        """Choose; the structure without terms if no term is material."""
        for _ in range(MAX_ROUNDS):
            common, ranking = rank(explored)
            chosen = Judge(explored, ranking, self.settings).near()[0]
            found = self.complete(explored.fits[chosen])
            if not changed(explored, found):
                break
            explored = found
        wanted = finalists(Judge(explored, ranking, self.settings))
        for _ in range(MAX_ROUNDS):
            comparison = self._refitted(explored, common, wanted)
            near = Judge(explored, comparison, self.settings).near()
            found = self.complete(explored.fits[near[0]])
            rests = [near[0].minus(t) for t in near[0].terms]
            again = [
                s for s in rests if s in found.fits and (s not in comparison.squares or changed(explored, found, s))
            ]
            explored = found
            if not again:
                break
            wanted = [*dict.fromkeys((*wanted, *again))]
        chosen = near[0]
        fitted = explored.fits[chosen]
        return Choice(
            fitted, tuple(near), Judge(explored, ranking, self.settings).smaller(chosen), comparison, ranking,
            residual_reports(explored.first_model, explored), residual_reports(fitted, explored), explored,
            self.settings,
        )  # fmt: skip

    def _refitted(self, explored: SearchResult, common: CommonBlocks, wanted: Iterable[Structure]) -> Comparison:
        """Errors of structures that were fitted again without each block.

        Where the time was up the closed form takes their place. A structure that cannot be simulated without a block is
        left out.
        """
        noise, folds = explored.noise.noise, len(common.folds)
        fits = {s: explored.fits[s] for s in wanted}
        new = {
            s: f.with_noise(noise)
            for s, f in fits.items()
            if s not in self._known or self._known[s][0] is not f.optimum
        }
        fit = self.fit.at_temperature(noise.temperature)
        tasks = [
            Task(partial(refitted_errors, f, common, k, fit), f.model.objective.outcomes)
            for f in new.values()
            for k in range(folds)
        ]
        found = self.map(tasks, self.told)
        for n, (s, fitted) in enumerate(new.items()):
            own = [e for e in found[n * folds : (n + 1) * folds] if e is not None]
            errors = np.concatenate(own) if len(own) == folds else newton_errors(fitted, common)
            self._known[s] = fits[s].optimum, errors
        able = {s: self._known[s][1] for s in fits if np.all(np.isfinite(self._known[s][1]))}
        if not any(not s.terms for s in able):
            able |= {s: newton_errors(f.with_noise(noise), common) for s, f in fits.items() if not s.terms}
        return Comparison(able, common.outputs, common.least)


def rank(explored: SearchResult) -> tuple[CommonBlocks, Comparison]:
    """All structures by the closed form, and the blocks that are left out."""
    noise = explored.noise.noise
    fits = {s: f.with_noise(noise) for s, f in explored.fits.items()}
    common = CommonBlocks.of(list(fits.values()))
    squares = {s: newton_errors(f, common) for s, f in fits.items()}
    return common, Comparison(
        {s: e for s, e in squares.items() if np.all(np.isfinite(e))}, common.outputs, common.least
    )


def finalists(judge: Judge) -> list[Structure]:
    """Structures that are worth a refit without each block.

    Those near the best material structure, the best of each size by the closed form and by the fit itself, which the
    closed form may misjudge, and what they must be better than.
    """
    ranking, explored = judge.comparison, judge.explored
    scores, fits = ranking.scores, explored.fits
    base = [s for s in ranking.squares if set(s.terms) == set(judge.settings.require)]
    found = [ranking.best(base), *judge.near()[: FINALISTS // 2]]
    for size in sorted({len(s) for s in ranking.squares}):
        own = [s for s in ranking.squares if len(s) == size]
        found += sorted(own, key=lambda s: scores[s])[:2]
        found += sorted(own, key=lambda s: -fits[s].optimum.log_likelihood)[:1]
    found = [*dict.fromkeys(found)][:FINALISTS]
    rests = [judge.rest(s, t) for s in found for t in s.terms if len(s) > 1]
    return [*dict.fromkeys((*found, *rests))]


def changed(one: SearchResult, other: SearchResult, only: Structure | None = None) -> bool:
    """Whether one result has fits that the other lacks or that are better."""
    names = other.fits if only is None else [only]
    return any(s not in one.fits or one.fits[s].optimum is not other.fits[s].optimum for s in names)
