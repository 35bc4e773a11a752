"""The search over structures: it fills a table of errors, size by size.

A structure is the first model with laws attached. A few structures of each size are extended by every offered term:
all are screened beside the fit, the promising ones are fitted briefly, the best to the end. The search ends where only
noise is left, or where a size brings nothing material; while structure is left it looks one size further, since two
terms may explain what neither does alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, fit_progressive_horizon, local_fit
from aero_bayes.loop.left_out import ROUNDING_SHARE, Blocks, newton_errors, refitted_errors
from aero_bayes.loop.models import FittedModel, Models, ModelSource
from aero_bayes.loop.screen import LEAST_FALL, Promise, Screen, Screened
from aero_bayes.loop.table import MATERIAL, Row, Table, Terms
from aero_bayes.parallel import ParallelMap, Task
from aero_bayes.simulation.interface import Outcome

R = TypeVar("R")

#: Structures of each size that are extended, from none to two terms: the best may hold none of the right ones.
BEAM = (1, 4, 2)
#: Terms beside a structure that are kept after a brief fit (beside the first model, whose predictions are the worst;
#: beside others), those of them that are fitted to the end, and those that begin with a beginning of the recordings.
FITTED, FINISHED, BEGUN = (12, 6), 5, (3, 1)
#: Structures that are fitted in a search, and those beside them that are tried in the place of a term of the model.
MOST_STRUCTURES, MOST_SWAPS, LEAST_SWAPS = 45, 15, 2
#: Points from which a term is fitted: by its slope, by simulation, and beside the declared values.
MOST_STARTS = 3
#: What the kind of a promise beside the declared values begins with, at least.
DECLARED = 2.0
#: Steps of a brief fit and of one to the end, and the relative fall of the squared error that a step must promise.
BRIEF, WHOLE = (4, 2e-3), (25, 1e-4)


@dataclass(frozen=True, eq=False)
class Library:
    """Terms that may be added, for each refinement the coarser law, the learned curves, and what has to be in."""

    offered: Terms
    refines: Mapping[str, str]
    curves: Collection[str]
    required: Terms = ()
    most_terms: int = 3


@dataclass(frozen=True, eq=False)
class Control:
    """How a search is run: its map over independent tasks, their counts, its time limit and its report."""

    map: ParallelMap
    counts: Counter[Outcome]
    late: Callable[[], bool]
    tell: Callable[[str, float], object]


@dataclass(eq=False)
class Search:
    """A search; ``fits`` are the best of each structure, ``table`` their errors, ``screened`` what terms promised."""

    source: ModelSource
    library: Library
    floors: Mapping[tuple[str, str], float]
    control: Control
    fits: dict[Terms, FittedModel] = field(default_factory=dict)
    screened: dict[Terms, dict[str, Screened]] = field(default_factory=dict)
    skipped: dict[str, None] = field(default_factory=dict)
    completed: set[Terms] = field(default_factory=set)
    ended: str = ""

    def __post_init__(self) -> None:
        self.models = Models(self.source)
        data = self.source.plain.data
        rounding = zip(data.outputs, (ROUNDING_SHARE * data.scale).tolist(), strict=True)
        self._least = {o: max(data.floors.get(o, 0.0), least) for o, least in rounding}

    # fits

    def settings(self, how: tuple[int, float]) -> LocalFitSettings:
        """Least squares, each output in units of what is left of it, with some steps and a least fall."""
        data, (steps, share) = self.source.plain.data, how
        least = max(0.5 * share * data.count, 0.02)
        plain = LocalFitSettings(kinds=dict.fromkeys(data.outputs, "white"), floors=self._least)
        local = replace(plain.local, iterations=steps, tolerance=least, min_noise_gain=least, min_decrease=least)
        return replace(plain, local=local)

    def fits_from(self, terms: Terms, points: Iterable[FloatArray], how: tuple[int, float]) -> list[FittedModel]:
        """Fits of a structure from some points (p,), without those that fail."""
        model = self.models.of(terms)
        found: list[FittedModel] = []
        if model is None:
            return found
        for point in points:
            with suppress(CannotFinishError):
                end = local_fit(model.objective, point, model.free(terms), settings=self.settings(how))
                found.append(FittedModel(model, terms, end))
        return found

    def found(self, terms: Terms, points: Iterable[FloatArray], how: tuple[int, float]) -> Optimum | None:
        """The best of the fits from some points."""
        best = min(self.fits_from(terms, points, how), key=self.blocks.on_fitted, default=None)
        return None if best is None else best.optimum

    def at_values(self, terms: Terms, values: Mapping[str, float], on: Terms) -> list[FloatArray]:
        """The point (p,) of a structure at SI values by name, with some of its terms on; none if it cannot be built."""
        model = self.models.of(terms)
        return [] if model is None else [model.coordinates_of(values, on)]

    def keep(self, found: Mapping[Terms, Optimum | None]) -> None:
        """Put better fits into the table; their terms are on, but for required ones, which may be off."""
        better: dict[Terms, FittedModel] = {}
        for terms, optimum in found.items():
            model = self.models.of(terms) if optimum is not None else None
            if optimum is not None and model is not None:
                fitted, known = FittedModel(model, terms, optimum), self.fits.get(terms)
                ahead = known is None or self.blocks.on_fitted(fitted) < self.blocks.on_fitted(known)
                off = set(fitted.off_terms) - set(self.library.required)
                better |= {terms: fitted} if ahead and not off else {}
        works = [partial(newton_errors, fitted, self.blocks) for fitted in better.values()]
        for (terms, fitted), errors in zip(better.items(), self._map(works), strict=True):
            if errors is not None and np.all(np.isfinite(errors)):
                self.fits[terms] = fitted
                unseen = self.table.rows[terms].unseen if terms in self.table.rows else None
                self.table.rows[terms] = Row(terms, errors, len(fitted.optimum.free), unseen=unseen)

    def begin(self, values: Mapping[str, float]) -> None:
        """Fit the first model from its values, cut the readings into blocks, and fit the required terms."""
        first = self.fits_from((), self.at_values((), values, ()), WHOLE)
        if not first:
            raise CannotFinishError("the first model cannot be simulated")
        self.blocks = Blocks.of(first[0])
        ports = {t: t.rpartition("@")[2] for t in self.library.offered}
        self.table = Table(self.blocks.outputs, self.blocks.least, ports, self.library.refines, self.library.curves)
        self.fits[()] = first[0]
        self.table.rows[()] = Row((), newton_errors(first[0], self.blocks), len(first[0].optimum.free))
        terms: Terms = ()
        for id_ in self.library.required:
            self.fit_children(terms, [id_], least=-math.inf)
            terms = _plus(terms, id_)
            if terms not in self.fits:
                raise CannotFinishError(f"the model cannot be simulated with {id_}, which [loop] require asks for")

    def structured(self, terms: Terms) -> tuple[str, ...]:
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
                if len(self.fits) < MOST_STRUCTURES and not self._late(f"structures of {size} terms"):
                    what = f"trying each term{' beside ' * bool(parent)}{', '.join(parent)}"
                    self.control.tell(what, (size - 1 + k / len(parents)) / self.library.most_terms)
                    self.extend(parent)
            here = self.table.best_of_size(self.fits).get(size)
            if here is not None and self.table.material(here, best):
                best = here
            elif here is None or size > len(best) + 1:
                break

    def _late(self, what: str) -> bool:
        """Whether the time limit has passed; what was being done then is kept."""
        if not self.ended and self.control.late():
            self.ended = what
        return bool(self.ended)

    def _beam(self, size: int) -> list[Terms]:
        """Structures of a size that are extended: the best, the best without a curve, the best of other places."""
        required = set(self.library.required)
        order = sorted((k for k in self.fits if len(k) == size and required <= set(k)), key=self.table.order)
        places: dict[Terms, Terms] = {}
        for k in order:
            places.setdefault(tuple(sorted(self.table.ports.get(t, t) for t in k)), k)
        plain = [k for k in order if not set(k) & set(self.library.curves)]
        width = BEAM[min(size - len(required), len(BEAM) - 1)]
        return list(dict.fromkeys([*order[:1], *plain[:1], *places.values(), *order]))[:width]

    def extend(self, parent: Terms, near: float | None = None) -> None:
        """Screen all terms beside a structure and fit those that promise most, or all that promise a score ``near``.

        A finer law is fitted where it promises more than its coarser one, or beside the best, and in place of it."""
        curved = bool(set(parent) & set(self.library.curves))
        curves, refines = self.library.curves, self.library.refines
        free = (t for t in self.library.offered if t not in parent and refines.get(t) not in parent)
        offered = [t for t in free if not (curved and t in curves)]
        self.fit_children(parent, offered, near)
        children = [k for k in self.fits if len(k) == len(parent) + 1 and set(parent) < set(k)]
        best = sorted(children, key=self.table.order)[: BEAM[1]]
        coarse = {t for k in best for t in set(k) - set(parent)} | set(parent)
        for t, of in self.library.refines.items():
            origin = tuple(x for x in parent if x != of)
            child, second = _plus(origin, t), t in self.library.curves and set(origin) & set(self.library.curves)
            wanted = of in coarse and t in self.library.offered and t not in parent and not second
            new = origin in self.fits and child not in self.fits
            if wanted and new and len(self.fits) < MOST_STRUCTURES + MOST_SWAPS:
                self.fit_children(origin, [t])

    def fit_children(
        self, parent: Terms, offered: Sequence[str], near: float | None = None, least: float = LEAST_FALL
    ) -> None:
        """Fit the terms that promise most beside a structure: some steps each, the best of them to the end."""
        promises = self.screen(parent, offered)
        here, gains = self.blocks.on_fitted(self.fits[parent]), {t: s.gain for t, s in promises.items()}
        if len(offered) > 1:
            coarse = {t: gains.get(of, -math.inf) for t, of in self.library.refines.items()}
            gains = {t: g for t, g in gains.items() if t not in coarse or g > coarse[t] + LEAST_FALL}
        if near is None:
            # A first fit may have gone so far astray that no promise is worth anything: from the declared values a law
            # is fitted whatever it promises.
            order = [t for t in gains if gains[t] >= least or (not parent and t not in self.library.curves)]
            count = len(order) if not parent else FITTED[1]
        else:
            order = [t for t in gains if here - gains[t] <= near and _plus(parent, t) not in self.fits]
            count = MOST_STRUCTURES + MOST_SWAPS - len(self.fits)
        order = sorted(order, key=lambda t: (-gains[t], t))[: max(count, LEAST_SWAPS)]
        children = [_plus(parent, t) for t in order]
        works = [partial(self._brief, parent, t, promises[t].promises) for t in order]
        found = dict(zip(children, self._map(works), strict=True))
        ends = sorted((k for k in children if found[k] is not None), key=lambda k: (self._score(found[k]), k))
        ends = ends if near is not None else ends[: FITTED[bool(parent)]]
        self.keep({k: found[k] for k in ends})
        kept = [k for k in ends[:FINISHED] if k in self.fits]
        self.finish(kept)
        again = [k for k in kept[: BEGUN[bool(parent)]] if near is None and self.structured(k)]
        self.keep(dict(zip(again, self._map([partial(self._from_beginning, k) for k in again]), strict=True)))

    def screen(self, parent: Terms, offered: Sequence[str]) -> dict[str, Screened]:
        """Screen terms beside a structure, those that were not yet."""
        known = self.screened.setdefault(parent, {})
        new = [t for t in offered if t not in known]
        for t, found in zip(new, self._map([partial(self._screen, parent, t) for t in new]), strict=True):
            if found is not None and found.port:
                known[t] = found
            elif found is not None:
                self.skipped[t] = None
        self.table.ports = {**self.table.ports, **{t: s.port for t, s in known.items() if s.port}}
        return {t: known[t] for t in offered if t in known}

    def finish(self, structures: Iterable[Terms]) -> None:
        """Go on with fits until no step promises anything."""
        wanted = [k for k in structures if k in self.fits and not self.fits[k].optimum.reason.converged]
        works = [partial(self.found, k, [self.fits[k].optimum.coordinates], WHOLE) for k in wanted]
        self.keep(dict(zip(wanted, self._map(works), strict=True)))

    def complete(self, model: Terms, part: Terms) -> None:
        """Fit a part of a structure, and all that does nearly as well as what it lacks in its place."""
        self.completed.add(part)
        # A fit of the part by itself may have ended in a local optimum that its values in the whole avoid.
        freed = {self.source.held[t].name for t in {*model} - {*part} if t in self.source.held}
        values = {name: value for name, value in self.fits[model].values.items() if name not in freed}
        self.keep({part: self.found(part, self.at_values(part, values, part), WHOLE)})
        if part in self.fits and len(part) + 1 == len(model):
            self.extend(part, self.blocks.on_fitted(self.fits[model]) - 2.0 * math.log(MATERIAL))

    def refit(self, structures: Sequence[Terms]) -> None:
        """Find the errors of some structures by fits without each block."""
        self.finish(structures)
        works = [partial(refitted_errors, self.fits[k], self.blocks, self.settings(WHOLE)) for k in structures]
        most = 1e6 * self.table.rows[()].errors.sum(axis=0)
        for k, errors in zip(structures, self._map(works), strict=True):
            if errors is not None:
                errors = np.where(np.isfinite(errors), errors, most)
                self.table.rows[k] = replace(self.table.rows[k], errors=errors, refitted=True)

    # tasks, perhaps in a process of their own

    def _map(self, works: Sequence[Callable[[], R]]) -> list[R | None]:
        """Do tasks; those that cannot be done give None."""
        tasks = [Task(partial(_tried, work), self.control.counts) for work in works]
        return self.control.map(tasks)

    def _screen(self, parent: Terms, term: str) -> Screened:
        """Screen a term beside a fit, of the first model beside its declared values, too.

        A fit that lacks a term may have moved them to where it does nothing."""
        child, fitted = _plus(parent, term), self.fits[parent]
        kept = child in self.fits
        model = self.models.of(child)
        if model is None:
            return Screened()
        known = [f for k, f in self.fits.items() if term in k and k != child]
        best = min(known, key=lambda f: self.table.order(f.terms), default=None)
        values = [tuple(best.term_values(term).values())] if best is not None else []
        found = Screen(fitted, model, term, self.blocks).run(values)
        declared = fitted.at_declared_values() if not parent else None
        if declared is not None:
            loss = self.blocks.on_fitted(declared) - self.blocks.on_fitted(fitted)
            there = Screen(declared, model, term, self.blocks).run()
            moved = (replace(p, gain=p.gain - loss, kind=(DECLARED + p.kind[0], *p.kind[1:])) for p in there.promises)
            promises = (*found.promises, *moved)
            found = replace(found, promises=tuple(sorted(promises, key=lambda p: -p.gain)))
        if not kept:
            self.models.drop(child)
        return found

    def _brief(self, parent: Terms, term: str, promises: Sequence[Promise]) -> Optimum | None:
        """Fit a term beside a structure from what it promises, and from the structure itself where that is better."""
        child, start = _plus(parent, term), self.fits[parent]
        sources = {p.kind[0]: p for p in reversed(promises)}
        points = [p.point for p in sources.values() if p.gain >= LEAST_FALL or p.kind[0] >= DECLARED]
        points = points[::-1] or [p.point for p in promises[:1]]
        ends = self.fits_from(child, points[:MOST_STARTS], BRIEF)
        here = self.blocks.on_fitted(start)
        if all(self.blocks.on_fitted(end) > here for end in ends):
            ends += self.fits_from(child, self.at_values(child, start.values, parent), BRIEF)
        end = min(ends, key=self.blocks.on_fitted, default=None)
        return None if end is None else end.optimum

    def _from_beginning(self, terms: Terms) -> Optimum | None:
        """Fit the beginning of the recordings first, then more and more of them.

        An oscillating or growing motion has few local optima only while a recording is short."""
        model, known = self.fits[terms].model, self.fits[terms].optimum.coordinates
        start = model.objective.parameters.revived(known, model.free_base_columns)
        settings = self.settings(WHOLE).with_limits(WHOLE[0], 0.01)
        free = model.free(terms)
        point, _ = fit_progressive_horizon(model.objective, start, free, settings, self.source.open, known)
        return self.found(terms, [point], WHOLE)

    def _score(self, found: Optimum | None) -> float:
        """Score of a fit that a task brought back, on the fitted readings."""
        if found is None:
            return math.inf
        return self.blocks.score(found.whitened.residual, np.array([found.noise[o].sd for o in self.blocks.outputs]))


def _tried(work: Callable[[], R]) -> R | None:
    with suppress(CannotFinishError):
        return work()
    return None


def _plus(terms: Terms, *more: str) -> Terms:
    return tuple(sorted({*terms, *more}))
