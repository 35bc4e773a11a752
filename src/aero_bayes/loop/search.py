"""The search over structures: it fills a table of errors, size by size.

1. A *structure* is the first model with laws attached. A few of each size are *extended* by every offered term.
2. Terms are *screened* beside a structure; those that promise most are fitted *briefly*, the best of these *whole*.
3. The search ends where only noise is left, or where a size brings nothing material; while structure is left it looks
   one size further, since two terms may explain what neither does alone.
4. A model that was decided on is *completed*: without each of its terms, all that comes near is tried in its place.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, fit_progressive_horizon, local_fit
from aero_bayes.loop.first_fit import LoopStatistics
from aero_bayes.loop.folds import ROUNDING_SHARE, Folds, newton_errors, refitted_errors
from aero_bayes.loop.models import FittedModel, Models, ModelSource
from aero_bayes.loop.screen import LEAST_FALL, Promise, Screen, Screened
from aero_bayes.loop.table import MATERIAL, Row, Structure, Table
from aero_bayes.loop.validation import Validation
from aero_bayes.parallel import ParallelMap, Task

R = TypeVar("R")


@dataclass(frozen=True)
class Effort:
    """How much is tried in a search, by what a simulation costs.

    ``beam`` are structures of each size that are extended, from none to two terms: the best may hold none of the right
    ones. Beside a structure so many terms are ``fitted`` after a brief fit (beside the first model, whose predictions
    are the worst; beside others), ``finished`` of them are fitted to the end, and ``begun`` with a beginning of the
    recordings. ``structures`` are fitted in all, ``swaps`` besides in the place of each term of the model. Beside
    the first model each term is fitted from ``declared`` nominal sizes and declared values, finer laws, too; it is
    screened ``beside_declared`` values, too."""

    beam: tuple[int, int, int] = (1, 4, 2)
    fitted: tuple[int, int] = (12, 6)
    finished: int = 5
    begun: tuple[int, int] = (3, 1)
    structures: int = 45
    swaps: int = 15
    declared: int = 0
    beside_declared: bool = True

    @classmethod
    def of(cls, steps: int) -> Effort:
        """The effort for a first model that a run of the recordings costs so many steps of the engine."""
        return next((effort for most, effort in EFFORTS if steps <= most), cls())


#: Steps of a run up to which everything is tried, and up to which twice as much is tried as otherwise.
EFFORTS = (
    (150, Effort((1, 30, 8), (60, 60), 60, (60, 60), 300, 100, 6)),
    (2500, Effort((1, 6, 4), (30, 12), 12, (12, 3), 90, 30, 3)),
)
#: Points from which a term is fitted: by its slope, by simulation, and beside the declared values.
MOST_STARTS = 3
#: Share of a search's work that has been done once no larger structure is tried; and share of what is left of a part of
#: it that its next tasks are taken for: how many rounds of tasks it has is not known before.
GROWN, NEXT_TASKS = 0.7, 0.4
#: Share of the time limit after which structures no longer grow: what is found has yet to be held against all else in
#: the place of each of its terms, or no law can be named.
GROWING_TIME = 0.5
#: What the kind of a promise beside the declared values begins with, at least.
DECLARED = 2.0
#: Steps of a brief fit and of one to the end, and the relative fall of the squared error that a step must promise.
BRIEF, WHOLE = (4, 2e-3), (25, 1e-4)
#: The same of a fit without a fold: from the fit to all it ends in a few steps, or tells that a fold decides.
REFIT = (5, 1e-3)


@dataclass(frozen=True, eq=False)
class Library:
    """Terms that may be added, for each refinement the coarser law, the learned curves, and what has to be in."""

    offered: Structure
    refines: Mapping[str, str]
    curves: Collection[str]
    required: Structure = ()
    most_terms: int = 3


@dataclass(eq=False)
class Search:
    """A search; ``fits`` are the best of each structure, ``table`` their errors, ``screened`` what terms promised.

    ``completed`` are parts of a model in which what one of its terms may be was tried, and whether all of it was;
    ``map`` does independent tasks."""

    source: ModelSource
    library: Library
    floors: Mapping[tuple[str, str], float]
    map: ParallelMap
    statistics: LoopStatistics
    validated_by: Callable[[FittedModel], Validation | None] = lambda fitted: None
    effort: Effort = Effort()
    fits: dict[Structure, FittedModel] = field(default_factory=dict)
    screened: dict[Structure, dict[str, Screened]] = field(default_factory=dict)
    skipped: dict[str, None] = field(default_factory=dict)
    completed: dict[Structure, bool] = field(default_factory=dict)
    ended: str = ""
    doing: tuple[str, float] = ("", 0.0)
    done: float = 0.0

    def __post_init__(self) -> None:
        self.models = Models(self.source)
        data = self.source.plain.data
        rounding = zip(data.outputs, (ROUNDING_SHARE * data.scale).tolist(), strict=True)
        self._least = {o: max(data.floors.get(o, 0.0), least) for o, least in rounding}
        known = [[sd for (_, name), sd in self.floors.items() if name == o and sd > 0.0] for o in data.outputs]
        self._sensors = np.array([max(own, default=math.inf) for own in known])

    # fits

    def settings(self, how: tuple[int, float]) -> LocalFitSettings:
        """Least squares, each output in units of what is left of it, with some steps and a least fall."""
        data, (steps, share) = self.source.plain.data, how
        least = max(0.5 * share * data.count, 0.02)
        plain = LocalFitSettings(kinds=dict.fromkeys(data.outputs, "white"), floors=self._least)
        local = replace(plain.local, iterations=steps, tolerance=least, min_noise_gain=least, min_decrease=least)
        return replace(plain, local=local)

    def fits_from(self, terms: Structure, points: Iterable[FloatArray], how: tuple[int, float]) -> list[FittedModel]:
        """Fits of a structure from some points (p,), without those that fail."""
        model = self.models.of(terms)
        found: list[FittedModel] = []
        if model is None:
            return found
        for point in points:
            if found and self.statistics.time_is_up():
                break
            with suppress(CannotFinishError):
                end = local_fit(
                    model.objective, point, model.free(terms), settings=self.settings(how), on_iteration=self._stop
                )
                found.append(FittedModel(model, terms, end))
        return found

    def _stop(self, iteration: int, cost: float) -> bool:
        """Whether a fit has to end where it is: none runs past the time limit."""
        return self.statistics.time_is_up()

    def found(self, terms: Structure, points: Iterable[FloatArray], how: tuple[int, float]) -> Optimum | None:
        """The best of the fits from some points."""
        best = min(self.fits_from(terms, points, how), key=lambda f: self.folds.on_fitted(f.optimum), default=None)
        return None if best is None else best.optimum

    def at_values(self, terms: Structure, values: Mapping[str, float], on: Structure) -> list[FloatArray]:
        """The point (p,) of a structure at SI values by name, with some of its terms on; none if it cannot be built."""
        model = self.models.of(terms)
        return [] if model is None else [model.coordinates_of(values, on)]

    def keep(self, found: Mapping[Structure, Optimum | None]) -> None:
        """Put better fits into the table; their terms are on, but for required ones, which may be off."""
        better: dict[Structure, FittedModel] = {}
        for terms, optimum in found.items():
            model = self.models.of(terms) if optimum is not None else None
            if optimum is not None and model is not None:
                fitted, known = FittedModel(model, terms, optimum), self.fits.get(terms)
                ahead = known is None or self.folds.on_fitted(fitted.optimum) < self.folds.on_fitted(known.optimum)
                off = set(fitted.off_terms) - set(self.library.required)
                better |= {terms: fitted} if ahead and not off else {}
        works = [partial(self._row, fitted) for fitted in better.values()]
        for (terms, fitted), row in zip(better.items(), self._map(works), strict=True):
            if row is not None and np.all(np.isfinite(row.errors)):
                self.fits[terms], self.table.rows[terms] = fitted, row

    def _row(self, fitted: FittedModel) -> Row:
        """Errors of a structure on readings that were left out, on validation and on test readings."""
        errors = newton_errors(fitted, self.folds)
        row = Row(fitted.terms, errors, len(fitted.optimum.free))
        if self.validation is None:
            return row
        with suppress(CannotFinishError):
            confirmed, tested = self.validation.errors(fitted.model.objective.calibration, fitted.optimum)
            return replace(row, validation=confirmed, test=tested) if np.all(np.isfinite(confirmed)) else row
        return row

    def begin(self, values: Mapping[str, float]) -> None:
        """Fit the first model from its values, cut the readings into folds, and fit the required terms."""
        first = self.fits_from((), self.at_values((), values, ()), WHOLE)
        if not first:
            raise CannotFinishError("the first model cannot be simulated")
        self.folds = Folds.of(first[0])
        ports = {t: t.rpartition("@")[2] for t in self.library.offered}
        self.table = Table(self.folds.outputs, self.folds.least, ports, self.library.refines, self.library.curves)
        self.table.readings = len(self.folds.owner)
        self.fits[()] = first[0]
        self.validation = self.validated_by(first[0])
        self.table.rows[()] = self._row(first[0])
        terms: Structure = ()
        for id_ in self.library.required:
            self.fit_children(terms, [id_], math.inf)
            terms = _plus(terms, id_)
            if terms not in self.fits:
                raise CannotFinishError(f"the model cannot be simulated with {id_}, which [loop] require asks for")

    def structured(self, terms: Structure) -> tuple[str, ...]:
        """Outputs in which a structure leaves more than what its sensors add."""
        return self.fits[terms].structured(self.floors)

    # the search

    def run(self) -> None:
        """Extend the best structures of each size, as long as that pays."""
        first = tuple(sorted(self.library.required))
        best = first
        for size in range(len(first) + 1, self.library.most_terms + 1):
            if not self.structured(best) or not self.library.offered:
                break
            parents = self._beam(size - 1)
            for k, parent in enumerate(parents):
                room = 1.0 if size == len(first) + 1 else GROWING_TIME
                if len(self.fits) < self.effort.structures and not self._late(f"structures of {size} terms", room):
                    what = f"trying each term{' beside ' * bool(parent)}{', '.join(parent)}"
                    self.work(what, GROWN * (size - 1 + (k + 1) / len(parents)) / self.library.most_terms)
                    self.extend(parent)
            self._late(f"structures of {size} terms", 1.0)
            here = self.table.best_of_size(self.fits).get(size)
            if here is not None and self._pays(here, best):
                best = here
            elif here is None or size > len(best) + 1:
                break

    def _pays(self, here: Structure, best: Structure) -> bool:
        """Whether a larger structure is worth extending: it falls materially by one witness at least.

        Each witness alone may mislead the decision; the search only goes on."""
        falls = (self.table.witnesses(here) - self.table.witnesses(best)).min(axis=1)
        return bool(np.any(falls <= math.log(MATERIAL)))

    def _late(self, what: str, room: float) -> bool:
        """Whether this share of the time limit has passed; what was being done then is kept."""
        if not self.ended and (self.statistics.time_is_up() or self.statistics.used() > room):
            self.ended = what
        return bool(self.ended)

    def _beam(self, size: int) -> list[Structure]:
        """Structures of a size to extend: the best, that with a coarser law, without a curve, and of other places."""
        required = set(self.library.required)
        order = sorted((k for k in self.fits if len(k) == size and required <= set(k)), key=self.table.order)
        places: dict[Structure, Structure] = {}
        for k in order:
            places.setdefault(tuple(sorted(self.table.ports.get(t, t) for t in k)), k)
        plain = [k for k in order if not set(k) & set(self.library.curves)]
        # A finer law may imitate another term beside its coarser one, which is therefore extended with it.
        refines = self.library.refines.items()
        coarser = [_plus((x for x in k if x != t), of) for k in order[:1] for t, of in refines if t in k]
        width = self.effort.beam[min(size - len(required), len(self.effort.beam) - 1)]
        beam = list(dict.fromkeys([*order[:1], *plain[:1], *places.values(), *order]))[:width]
        return list(dict.fromkeys([*beam, *(k for k in coarser if k in self.fits)]))

    def extend(self, parent: Structure, near: float | None = None, place: str = "") -> bool:
        """Screen all terms beside a structure and fit those that promise most, or all that promise a score ``near``.

        With a ``near`` all that promise anything at the same ``place`` are fitted, too. A finer law is fitted where it
        promises more than its coarser one, or beside the best, and in place of it. Gives whether nothing was left."""
        tried_all = self.fit_children(parent, self._free(parent), near, place)
        children = [k for k in self.fits if len(k) == len(parent) + 1 and set(parent) < set(k)]
        best = sorted(children, key=self.table.order)[: self.effort.beam[1]]
        coarse = {t for k in best for t in set(k) - set(parent)} | set(parent)
        finer: dict[Structure, list[str]] = {}
        for t, of in self.library.refines.items():
            origin = tuple(x for x in parent if x != of)
            if of in coarse and origin in self.fits and t in self._free(origin) and _plus(origin, t) not in self.fits:
                finer.setdefault(origin, []).append(t)
        for origin, terms in finer.items():
            if len(self.fits) < self.effort.structures + self.effort.swaps:
                self.fit_children(origin, terms, self.folds.on_fitted(self.fits[origin].optimum) - LEAST_FALL)
        return tried_all

    def _free(self, terms: Structure) -> list[str]:
        """Terms that may be put beside a structure: no second curve, and no finer form of what is in it."""
        curves, refines = {*self.library.curves}, self.library.refines
        taken = {*terms, *(curves if curves & {*terms} else ())}
        return [t for t in self.library.offered if t not in taken and refines.get(t) not in terms]

    def fit_children(
        self, parent: Structure, offered: Sequence[str], near: float | None = None, place: str = ""
    ) -> bool:
        """Fit what promises most beside a structure, the best to the end; gives whether all that is near was fitted."""
        promises = self.screen(parent, offered)
        order, cut = self._promising(parent, {t: s.gain for t, s in promises.items()}, near, place)
        children = [_plus(parent, t) for t in order]
        works = [partial(self._brief, parent, t, promises[t].promises) for t in order]
        found = dict(zip(children, self._map(works), strict=True))
        ends = sorted((k for k in children if found[k] is not None), key=lambda k: (self.folds.on_fitted(found[k]), k))
        ends = ends if near is not None else ends[: self.effort.fitted[bool(parent)]]
        self.keep({k: found[k] for k in ends})
        kept = [k for k in ends[: self.effort.finished] if k in self.fits]
        begun = self.effort.begun[bool(parent)] if near is None else 0
        self.finish(kept, [k for k in kept[:begun] if self.structured(k)])
        return not cut

    def _promising(
        self, parent: Structure, gains: dict[str, float], near: float | None, place: str
    ) -> tuple[list[str], list[str]]:
        """Terms to be fitted beside a structure by what they promise, the best first, and those that are cut off."""
        here = self.folds.on_fitted(self.fits[parent].optimum)
        coarse = {t: gains.get(of, -math.inf) for t, of in self.library.refines.items()}
        finer = self.effort.declared and not parent
        gains = {t: g for t, g in gains.items() if finer or t not in coarse or g > coarse[t] + LEAST_FALL}
        if near is None:
            # A first fit may have gone so far astray that no promise is worth anything: from the declared values a law
            # is fitted whatever it promises.
            order = [t for t in gains if gains[t] >= LEAST_FALL or (not parent and t not in self.library.curves)]
            count = len(order) if not parent else self.effort.fitted[1]
        else:
            # A promise is to first order, and no bound: the best are tried in any case, and all at the same place.
            best = sorted(gains, key=lambda t: (-gains[t], t))[: self.effort.fitted[1] if place else 0]
            best += [t for t in gains if self.table.ports.get(t) == place and gains[t] >= LEAST_FALL]
            order = [t for t in gains if here - gains[t] <= near or t in best]
            order = [t for t in order if _plus(parent, t) not in self.fits]
            count = self.effort.swaps
        order.sort(key=lambda t: (-gains[t], t))
        return order[:count], order[count:]

    def screen(self, parent: Structure, offered: Sequence[str]) -> dict[str, Screened]:
        """Screen terms beside a structure, those that were not yet."""
        known = self.screened.setdefault(parent, {})
        new = [t for t in offered if t not in known]
        # What took longest before begins first: no worker waits for it at the end.
        order = sorted(
            new, key=lambda t: -max((there[t].seconds for there in self.screened.values() if t in there), default=0.0)
        )
        results = dict(zip(order, self._map([partial(self._screen, parent, t) for t in order]), strict=True))
        for t in new:
            found = results[t]
            if found is not None and found.port:
                known[t] = found
            elif found is not None:
                self.skipped[t] = None
        self.table.ports = {**self.table.ports, **{t: s.port for t, s in known.items() if s.port}}
        return {t: known[t] for t in offered if t in known}

    def finish(self, structures: Iterable[Structure], begun: Sequence[Structure] = ()) -> None:
        """Go on with fits until no step promises anything; some are fitted to a beginning of the recordings, too."""
        wanted = [k for k in structures if k in self.fits and not self.fits[k].optimum.reason.converged]
        works = [partial(self.found, k, [self.fits[k].optimum.coordinates], WHOLE) for k in wanted]
        found = self._map([*works, *(partial(self._from_beginning, k) for k in begun)])
        self.keep(dict(zip(wanted, found[: len(wanted)], strict=True)))
        self.keep(dict(zip(begun, found[len(wanted) :], strict=True)))

    def complete(self, model: Structure, part: Structure) -> None:
        """Fit a part of a structure, and all that does nearly as well as what it lacks in its place."""
        # A fit of the part by itself may have ended in a local optimum that its values in the whole avoid.
        freed = {n for t in {*model} - {*part} if t in self.source.held for n in self.fits[model].term_values(t)}
        values = {name: value for name, value in self.fits[model].values.items() if name not in freed}
        self.keep({part: self.found(part, self.at_values(part, values, part), WHOLE)})
        swaps = self._known_swaps(model, part, values)
        works = [partial(self.found, k, self.at_values(k, known, k), WHOLE) for k, known in swaps.items()]
        self.keep(dict(zip(swaps, self._map(works), strict=True)))
        tried_all, lacks = True, {*model} - {*part}
        if part in self.fits and len(lacks) == 1:
            near = self.folds.on_fitted(self.fits[model].optimum) - 2.0 * math.log(MATERIAL)
            tried_all = self.extend(part, near, self.table.ports[min(lacks)])
        # What ends with the time has not tried all.
        self.completed[part] = tried_all and not self.statistics.time_is_up()

    def _known_swaps(
        self, model: Structure, part: Structure, values: Mapping[str, float]
    ) -> dict[Structure, dict[str, float]]:
        """Structures that are tried beside a part whatever they promise, and SI values to begin from.

        They have the coarser law, from the finer one's size, or a term of what does as well as the model."""
        found: dict[Structure, dict[str, float]] = {}
        near, free = self.table.score(model) - math.log(MATERIAL), self._free(part)
        alike = (k for k in self.fits if len(k) == len(model) and self.table.score(k) <= near)
        for k in sorted(alike, key=self.table.order)[: self.effort.fitted[1]]:
            for term in (t for t in free if t in k and t not in model):
                found.setdefault(_plus(part, term), {**values, **self.fits[k].term_values(term)})
        for fine in {*model} - {*part}:
            child = _plus(part, coarse := self.library.refines.get(fine, ""))
            simulated = self.models.of(child) if coarse in free else None
            if simulated is not None:
                ends = (self.fits[model].model, fine), (simulated, coarse)
                size, own = (m.objective.parameters.names[m.candidates[t].columns[0]] for m, t in ends)
                found[child] = {**values, own: values.get(size, 0.0)}
        return found

    def refit(self, wanted: Sequence[Structure]) -> None:
        """Find the left-out errors of some structures by fits without each fold."""
        self.finish(wanted)
        works = [partial(refitted_errors, self.fits[k], self.folds, self.settings(REFIT), self._stop) for k in wanted]
        most = 1e6 * self.table.rows[()].errors.sum(axis=0)
        for k, errors in zip(wanted, self._map(works), strict=True):
            if errors is not None:
                errors = np.where(np.isfinite(errors), errors, most)
                self.table.rows[k] = replace(self.table.rows[k], errors=errors, refitted=True)

    # tasks, perhaps in a process of their own

    def work(self, what: str, until: float) -> None:
        """Begin a part of the work, at the end of which so much of the whole is done."""
        self.done, self.doing = self.doing[1], (what, until)
        self.statistics.tell_search(what, self.done)

    def _map(self, works: Sequence[Callable[[], R]]) -> list[R | None]:
        """Do tasks; those that cannot be done give None."""
        tasks = [Task(partial(_tried, work), self.statistics.outcomes) for work in works]
        (what, until), begun = self.doing, self.done
        step = NEXT_TASKS * (until - begun)
        found = self.map(tasks, lambda share: self.statistics.tell_search(what, begun + step * share))
        self.done += step
        return found

    def _screen(self, parent: Structure, term: str) -> Screened:
        """Screen a term beside a fit, of the first model beside its declared values, too.

        A fit that lacks a term may have moved them to where it does nothing."""
        child, fitted, began = _plus(parent, term), self.fits[parent], time.perf_counter()
        kept = child in self.fits
        model = self.models.of(child)
        if model is None:
            return Screened()
        known = [f for k, f in self.fits.items() if term in k and k != child]
        best = min(known, key=lambda f: self.table.order(f.terms), default=None)
        values = [tuple(best.term_values(term).values())] if best is not None else []
        found = Screen(fitted, model, term, self.folds, self._sensors).run(values)
        declared = fitted.at_declared_values() if not parent and self.effort.beside_declared else None
        if declared is not None:
            loss = self.folds.on_fitted(declared.optimum) - self.folds.on_fitted(fitted.optimum)
            there = Screen(declared, model, term, self.folds, self._sensors).run()
            moved = (replace(p, gain=p.gain - loss, kind=(DECLARED + p.kind[0], *p.kind[1:])) for p in there.promises)
            promises = (*found.promises, *moved)
            found = replace(found, promises=tuple(sorted(promises, key=lambda p: -p.gain)))
        if not kept:
            self.models.drop(child)
        return replace(found, seconds=time.perf_counter() - began)

    def _brief(self, parent: Structure, term: str, promises: Sequence[Promise]) -> Optimum | None:
        """Fit a term beside a structure from what it promises, and from the structure itself where that is better."""
        child, start = _plus(parent, term), self.fits[parent]
        sources = {p.kind[0]: p for p in reversed(promises)}
        points = [p.point for p in sources.values() if p.gain >= LEAST_FALL or p.kind[0] >= DECLARED]
        points = points[::-1] or [p.point for p in promises[:1]]
        points = points[:MOST_STARTS] + ([] if parent else self._declared_points(child, term))
        ends = self.fits_from(child, points, BRIEF)
        here = self.folds.on_fitted(start.optimum)
        if all(self.folds.on_fitted(end.optimum) > here for end in ends):
            ends += self.fits_from(child, self.at_values(child, start.values, parent), BRIEF)
        end = min(ends, key=lambda f: self.folds.on_fitted(f.optimum), default=None)
        return None if end is None else end.optimum

    def _declared_points(self, child: Structure, term: str) -> list[FloatArray]:
        """Points (p,) at the declared values of the first model and nominal sizes of a term.

        Where the first model had to bend far, its fit is no place to begin from, and sizes are wrong there."""
        model = self.models.of(child)
        starts = model.candidates[term].starts[: self.effort.declared] if model is not None else ()
        points = []
        for start in starts:
            assert model is not None
            values = model.objective.parameters.start.copy()
            values[list(model.candidates[term].columns[: len(start)])] = start
            points.append(model.objective.parameters.to_search(values))
        return points

    def _from_beginning(self, terms: Structure) -> Optimum | None:
        """Fit the beginning of the recordings first, then more and more of them.

        An oscillating or growing motion has few local optima only while a recording is short."""
        model, known = self.fits[terms].model, self.fits[terms].optimum.coordinates
        start = model.objective.parameters.revived(known, model.free_base_columns)
        settings = self.settings(WHOLE).with_limits(WHOLE[0], 0.01)
        free = model.free(terms)
        point, _ = fit_progressive_horizon(model.objective, start, free, settings, self.source.open, known, self._stop)
        return self.found(terms, [point], WHOLE)


def _tried(work: Callable[[], R]) -> R | None:
    with suppress(CannotFinishError):
        return work()
    return None


def _plus(terms: Iterable[str], *more: str) -> Structure:
    return tuple(sorted({*terms, *more}))
