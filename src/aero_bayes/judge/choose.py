"""Choose a structure: rank all by the closed form, fit the finalists again without each block, decide."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum
from aero_bayes.judge.choice import Choice
from aero_bayes.judge.judge import ChoiceSettings, Judge, residual_reports
from aero_bayes.parallel import Task
from aero_bayes.search.comparison import MIN_BLOCKS, Comparison
from aero_bayes.search.explored import Mapper, SearchResult, one_by_one
from aero_bayes.search.left_out import CommonBlocks, newton_errors, refitted_errors
from aero_bayes.search.models import FitNoise, FittedModel
from aero_bayes.search.structure import Structure, by_size, law_of

#: Structures that are fitted again without each block: more than a dozen cost more than the search.
FINALISTS = 12
#: Rounds in which the choice may change because of structures that were fitted for it.
MAX_ROUNDS = 4
#: Every how many-th block is left out first: what cannot be chosen, to judge by these, is not fitted without the rest.
FIRST_BLOCKS_STRIDE = 4


@dataclass(eq=False)
class Chooser:
    """Chooses a structure of those that a search explored."""

    settings: ChoiceSettings
    fit: LocalFitSettings
    complete: Callable[[FittedModel], SearchResult]
    alone: Callable[[FittedModel], FittedModel]
    map: Mapper = one_by_one
    told: Callable[[float], object] = lambda share: None

    def __post_init__(self) -> None:
        self._known: dict[Structure, _LeftOut] = {}

    def choose(self, explored: SearchResult) -> Choice:
        """Choose; the structure without terms if no term is material."""
        for _ in range(MAX_ROUNDS):
            common, ranking = rank(explored)
            chosen = Judge(explored, ranking, self.settings).near()[0]
            found = self.complete(explored.fits[chosen])
            if not changed(explored, found):
                break
            explored = found
        wanted, whole = finalists(Judge(explored, ranking, self.settings)), set[Structure]()
        for _ in range(MAX_ROUNDS):
            comparison = self._refitted(explored, common, wanted, whole)
            near = Judge(explored, comparison, self.settings).near()
            found = self.complete(explored.fits[near[0]])
            compared = [near[0], *(near[0].minus(t) for t in near[0].terms)]
            compared += [s for s in found.fits if s not in explored.fits]
            again = [s for s in compared if s in found.fits and (not self._is_whole(s) or changed(explored, found, s))]
            explored = found
            if not again:
                break
            wanted, whole = [*dict.fromkeys((*wanted, *again))], {*whole, *again}
        chosen = near[0]
        fitted = explored.fits[chosen]
        return Choice(
            fitted, tuple(near), Judge(explored, ranking, self.settings).smaller(chosen), comparison, ranking,
            residual_reports(explored.first_model, explored), residual_reports(fitted, explored), explored,
            self.settings,
        )  # fmt: skip

    def _refitted(
        self, explored: SearchResult, common: CommonBlocks, wanted: Iterable[Structure], whole: Collection[Structure]
    ) -> Comparison:
        """Errors of structures that were fitted again without each block.

        Every few-th block is left out first. Structures that cannot be chosen, to judge by these, are not fitted
        without the other blocks, unless they are among ``whole``."""
        noise, folds = explored.noise.noise, range(len(common.folds))
        fits = {s: explored.fits[s] for s in wanted}
        for s, fitted in fits.items():
            if s not in self._known or self._known[s].optimum is not fitted.optimum:
                self._known[s] = _LeftOut.of(fitted.optimum, self.alone(fitted).with_noise(noise), common)
        known = {s: self._known[s] for s in fits}
        first = folds[::FIRST_BLOCKS_STRIDE] if len(folds) >= FIRST_BLOCKS_STRIDE * MIN_BLOCKS else folds
        self._leave_out(known.values(), first, common, noise)
        able = {s: e for s, k in known.items() if np.all(np.isfinite(e := k.of_folds(first)))}
        on_first = Comparison(able, common.outputs, common.least)
        judge = Judge(explored, on_first, self.settings)
        beaten = {s for s in on_first.squares if s.terms and s not in whole and _is_beaten(s, judge)}
        self._leave_out([k for s, k in known.items() if s not in beaten], folds, common, noise)
        able = {s: e for s, k in known.items() if np.all(np.isfinite(e := k.of_folds(folds)))}
        if not any(not s.terms for s in able):
            able |= {s: newton_errors(f.with_noise(noise), common) for s, f in fits.items() if not s.terms}
        return Comparison(able, common.outputs, common.least)

    def _leave_out(
        self, structures: Iterable[_LeftOut], folds: Iterable[int], common: CommonBlocks, noise: FitNoise
    ) -> None:
        """Fit structures without some blocks, where that was not done yet."""
        fit = self.fit.at_temperature(noise.temperature)
        missing = [(own, k) for own in structures for k in folds if k not in own.refitted]
        tasks: list[Task[FloatArray | None]] = [
            Task(partial(refitted_errors, own.fitted, common, k, fit), own.fitted.model.objective.outcomes)
            for own, k in missing
        ]
        for (own, k), errors in zip(missing, self.map(tasks, self.told), strict=True):
            if errors is not None:
                own.errors[k] = errors
                own.refitted.add(k)

    def _is_whole(self, structure: Structure) -> bool:
        """Return whether a structure was fitted without every block."""
        own = self._known.get(structure)
        return own is not None and len(own.refitted) == len(own.errors)


def _is_beaten(structure: Structure, judge: Judge) -> bool:
    """Return whether a structure cannot be chosen, to judge by the first blocks.

    One with no more terms is clearly better; or without one of its terms, or with a coarser law in place of one, the
    error is hardly larger."""
    blocks, refines = judge.comparison, judge.explored.refines
    coarser = [structure.minus(t).plus(c) for t, c in refines.items() if t in structure.terms]
    if any(blocks.clearly_better(o, structure) for o in blocks.squares if len(o) <= len(structure) and o != structure):
        return True
    hardly = 0.5 * (1.0 + judge.settings.min_share)
    parts = [*(structure.minus(t) for t in structure.terms), *coarser]
    needless = any(o in blocks.squares and blocks.share(structure, o).value > hardly for o in parts)
    return needless and not judge.only_noise(structure)


@dataclass(eq=False)
class _LeftOut:
    """Squared errors of one structure by fold, and the folds without which it was fitted; closed form in the others.

    ``optimum`` is the fit that it was begun for, ``fitted`` the same on a model of its own."""

    optimum: Optimum
    fitted: FittedModel
    errors: list[FloatArray]
    refitted: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, optimum: Optimum, fitted: FittedModel, common: CommonBlocks) -> _LeftOut:
        ends = np.cumsum([len(fold) for fold in common.folds])[:-1]
        return cls(optimum, fitted, list(np.split(newton_errors(fitted, common), ends)))

    def of_folds(self, folds: Iterable[int]) -> FloatArray:
        """Squared errors (blocks, m) of some folds."""
        return np.concatenate([self.errors[k] for k in folds])


def rank(explored: SearchResult) -> tuple[CommonBlocks, Comparison]:
    """Return all structures by the closed form, and the blocks that are left out."""
    noise = explored.noise.noise
    fits = {s: f.with_noise(noise) for s, f in explored.fits.items()}
    common = CommonBlocks.of(list(fits.values()))
    squares = {s: newton_errors(f, common) for s, f in fits.items()}
    return common, Comparison(
        {s: e for s, e in squares.items() if np.all(np.isfinite(e))}, common.outputs, common.least
    )


def worth_all_readings(explored: SearchResult, settings: ChoiceSettings) -> list[Structure]:
    """Structures, explored on a part of the recordings, that are worth a fit to all: the finalists and their likes.

    Their likes are the structures that the best one does not clearly beat, the best law in place of each curve, and the
    best term of each place: which place it is, all readings may tell otherwise."""
    judge = Judge(explored, rank(explored)[1], settings)
    found = [*finalists(judge), *judge.near()[:FINALISTS]]
    scores, ports = judge.comparison.scores, explored.ports
    for own in by_size(judge.comparison.ranked).values():
        next_best = own[1 : 1 + FINALISTS // 4]
        found += [s for s in next_best if s.terms and not judge.comparison.likely_better(own[0], s)]
    for structure in tuple(found):
        for curve in set(structure.terms) & set(explored.curves):
            laws = explored.laws_in_place_of(curve, structure.minus(curve), scores)
            found += sorted(laws, key=lambda s: scores[s])[:1]
    alone = sorted((s for s in scores if len(s) == 1 and judge.material(s)), key=lambda s: scores[s])
    places: dict[str | None, Structure] = {}
    for structure in alone:
        places.setdefault(ports.get(structure.terms[0]), structure)
    return [*dict.fromkeys((*found, *[*places.values()][:FINALISTS]))]


def finalists(judge: Judge) -> list[Structure]:
    """Structures that are worth a refit without each block."""
    ranking, explored = judge.comparison, judge.explored
    scores, fits, curves = ranking.scores, explored.fits, explored.curves
    base = [s for s in ranking.squares if set(s.terms) == set(judge.settings.require)]
    near = judge.near()
    found = [ranking.best(base), *one_of_each(near, curves)[: FINALISTS // 2], *near[: FINALISTS // 4]]
    sizes = [sorted(own, key=lambda s: scores[s]) for _, own in sorted(by_size(ranking.squares).items())]
    for own in sizes:
        best = next((s for s in own if judge.material(s)), None)
        found += [best, *one_of_each(judge.close_to(best), curves)[: FINALISTS // 4]] if best is not None else []
    for own in sizes:
        found += [
            s for s in one_of_each(own, curves)[:2] if not ranking.far_better(own[0], s, judge.settings.min_share)
        ]
        found += sorted(own, key=lambda s: -fits[s].optimum.log_likelihood)[:1]
    found = [*dict.fromkeys((*found, *near))][:FINALISTS]
    rests = [judge.rest(s, t) for s in found for t in s.terms if len(s) > 1]
    rests += [c for s in found for c in judge.coarser(s)]
    return [*dict.fromkeys((*found, *rests))]


def one_of_each(structures: Iterable[Structure], curves: Collection[str]) -> list[Structure]:
    """Return the first structure with each set of laws, wherever these act; a curve at another place is another law."""
    first: dict[tuple[str, ...], Structure] = {}
    for structure in structures:
        laws = sorted(t if t in curves else law_of(t) for t in structure.terms)
        first.setdefault(tuple(laws), structure)
    return [*first.values()]


def changed(one: SearchResult, other: SearchResult, only: Structure | None = None) -> bool:
    """Return whether one result has fits that the other lacks or that are better."""
    names = other.fits if only is None else [only]
    return any(s not in one.fits or one.fits[s].optimum is not other.fits[s].optimum for s in names)
