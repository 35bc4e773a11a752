"""The search over structures: a beam over sizes, all structures compared by their error on left-out readings.

Keep the best structures of each size, by the closed form of one Newton step. Expand them by edits, fit their neighbours
from the starts of the start rules, take the noise from the best, and compare all structures again. The search ends when
a level brings no better structure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum
from aero_bayes.parallel import Task, doubling_batches
from aero_bayes.search.candidate_fits import CandidateFits
from aero_bayes.search.common_noise import CommonNoise, common_noise
from aero_bayes.search.compared_fits import ComparedFits
from aero_bayes.search.edits import EditContext
from aero_bayes.search.explored import Library, SearchControl, SearchResult
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.search.parts import Parts
from aero_bayes.search.refit import fit_anew, refit
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import KnownTerms, Start, least_gain_beside_terms, starting_points
from aero_bayes.search.structure import Structure

#: Log-posterior that a fit may lose when it moves to another model of the same structure: that of the solver's steps.
MAX_LOSS = 0.5


@dataclass(eq=False)
class StructureSearch:
    """Beam search."""

    cache: ModelCache
    library: Library
    settings: StructureSettings
    fit_settings: LocalFitSettings
    floors: Mapping[tuple[str, str], float]
    parts: Parts
    control: SearchControl = field(default_factory=SearchControl)

    def __post_init__(self) -> None:
        self.fit_settings = replace(self.fit_settings, hold_noise=True)
        self._expanded: set[Structure] = set()
        self._restarted: set[tuple[str, Structure]] = set()
        self._level_count = 0
        self._ended = ""
        self._completed: set[Structure] = set()

    def run(self, root: FittedModel) -> SearchResult:
        """Search from the fit of the first model."""
        self._begin(root)
        if not self._known.noise.exact:
            self._restart([], "the first model")
            self._expand_all()
        return self._result()

    def go_on(self, root: FittedModel, explored: SearchResult, worth: Iterable[Structure]) -> SearchResult:
        """Fit the structures that are worth it of those that were explored on a part of the recordings to all of them.

        They are fitted under the noise that the best one leaves on the part. Where that is only noise, but more is left
        on the whole, the search goes on there."""
        self._begin(root, explored.noise)
        self._candidates.skipped |= dict.fromkeys(explored.skipped)
        self._ended = explored.ended
        like, works = list[FittedModel](), list[Callable[[], Optimum | None]]()
        for structure in worth:
            with suppress(CannotFinishError):
                model = self.cache.of(structure)
                point = model.coordinates_of(explored.fits[structure].values, structure.terms)
                like.append(replace(self._known.fits[self._known.required], model=model, structure=structure))
                works.append(partial(fit_anew, like[-1], point, self._known.tempered))
        self._known.fit_all(like, works)
        self._known.update_noise()
        if explored.noise.adequate and not self._known.noise.adequate:
            self._expand_all()
        return self._result()

    def _begin(self, root: FittedModel, noise: CommonNoise | None = None) -> None:
        """Take the first model, and what is required; compare under a given noise, or that which the best leaves."""
        required = root.structure.plus(*self.settings.require)
        self._known = ComparedFits(
            root, required, noise or common_noise(root, self.floors), self.settings, self.fit_settings, self.floors,
            self.control,
        )  # fmt: skip
        self._candidates = CandidateFits(self.cache, self._known)
        if self.settings.require:
            self._fit_required(root.structure)
        if noise is None:
            self._known.update_noise()

    def complete(self, fitted: FittedModel) -> SearchResult:
        """Fit what the choice of a structure has to be compared with, as far as that was not done.

        These are the sub-structures with one term left out, and :meth:`_at_the_same_port`."""
        structure = fitted.structure
        if structure in self._completed:
            return self._result()
        self._completed.add(structure)
        for id_ in fitted.terms:
            with suppress(CannotFinishError):
                self._known.keep_better(self._fit_alone(structure.minus(id_), fitted.values))
        new = {s: o for s, o in self._at_the_same_port(structure).items() if s not in self._known.fits}
        if self._fit_larger(new, "other laws at the same ports"):
            self._known.update_noise()
        return self._result()

    def _at_the_same_port(self, structure: Structure) -> dict[Structure, Structure]:
        """Return the same with another law at the port of each term, and what is left without it.

        In place of a curve that is each law: one alone was compared with it when each was tried alone. In place of a
        law it is each refinement of another one, since refinements are not offered where only noise is left."""
        explored, library, found = self._result(), self.library, dict[Structure, Structure]()
        for id_ in structure.terms:
            is_law, rest = id_ not in library.curves, structure.minus(id_)
            if is_law or len(structure) > 1:
                others = [t for t in library.terms if t != id_ and (not is_law or t in library.refines)]
                there = explored.laws_in_place_of(id_, rest, [rest.plus(t) for t in others])
                found |= dict.fromkeys(there, rest)
        return found

    def alone(self, fitted: FittedModel) -> FittedModel:
        """Return the same fit on the model that has its terms and no others; as it is where that cannot be had."""
        with suppress(CannotFinishError):
            if self.cache.of(fitted.structure) is not fitted.model:
                found = self._fit_alone(fitted.structure, fitted.values)
                if found.log_posterior >= fitted.with_noise(self._known.noise.noise).log_posterior - MAX_LOSS:
                    return found
        return fitted

    def _expand_all(self) -> None:
        """Expand until no structure is left to expand."""
        while not self._time_is_up("the search") and (frontier := self._frontier()):
            beside = self._known.best().terms
            what = f"level {self._level_count + 1}" + (f" beside {', '.join(beside)}" if beside else "")
            self._level(frontier, what)

    def _level(self, frontier: Sequence[FittedModel], what: str) -> None:
        """Expand structures, take the noise from the best, and restart the fits of the best."""
        tried = self._expand(frontier, what)
        self._known.update_noise()
        self._restart(tried, what)
        self._level_count += 1

    def _result(self) -> SearchResult:
        return SearchResult(
            dict(self._known.fits), self._known.best(), self._known.order(), self._known.noise, self.floors,
            self.cache.ports, self.library.refines, self.library.curves, tuple(self._candidates.skipped),
            self._ended,
        )  # fmt: skip

    # which structures to expand

    def _frontier(self) -> list[FittedModel]:
        """Return the best structure; where its residual is structured, also the best of its size."""
        best = self._known.best()
        if best.structure not in self._expanded:
            if self._known.noise.adequate:
                return [best]
            return [best, *(f for f in self._beam(len(best.structure)) if f is not best)]
        if self._known.noise.adequate or len(best.structure) + 1 >= self.settings.max_effects:
            return []
        # A pair may explain what neither of its terms does alone: look one level further.
        return self._beam(len(best.structure) + 1)

    def _beam(self, size: int) -> list[FittedModel]:
        """Return those structures of a size that are to be expanded: the best, and none materially worse than it."""
        return [f for f in self._known.near_best(size) if f.structure not in self._expanded]

    # neighbours

    def _expand(self, frontier: Sequence[FittedModel], what: str) -> list[Structure]:
        """Fit the neighbours of structures; those that were fitted."""
        self._candidates.clear()
        best, adequate, targets = self._known.best(), self._known.noise.adequate, dict[Structure, Structure]()
        near = tuple(f.structure for f in self._known.near_best(len(best.structure)))
        for k, fitted in enumerate(frontier):
            self._expanded.add(fitted.structure)
            self.control.report(what, 0.2 * k / len(frontier))
            directions = tuple(self._candidates.directions(fitted, self.library))
            context = EditContext(
                fitted, adequate and fitted is best, self.library.terms, self.library.refines, self.library.curves,
                self._known.best_terms(), self.cache.free_later, directions,
                self.cache.interpolation_is_free, fitted is best, near,
            )  # fmt: skip
            for edit in self.parts.edits:
                self._fit_smaller(fitted, edit.neighbours(context), targets)
        return self._fit_larger(targets, what)

    def _fit_smaller(
        self, fitted: FittedModel, neighbours: Iterable[Structure], targets: dict[Structure, Structure]
    ) -> None:
        """Fit neighbours without new terms at once, from where the fit is; the others are ``targets``."""
        for structure in neighbours:
            if not structure.contains_terms(self._known.required) or len(structure) > self.settings.max_effects:
                continue
            if structure.new_terms(fitted.structure):
                if structure not in self._known.fits:
                    targets.setdefault(structure, fitted.structure)
                continue
            with suppress(CannotFinishError):
                self._known.keep_better(self._fit_alone(structure, fitted.values))

    def _fit_larger(self, targets: Mapping[Structure, Structure], what: str) -> list[Structure]:
        """Fit structures with new terms in the order of their predicted gain; skip those that cannot matter."""
        found = {s: self._candidates.base_of(s, origin, self.library) for s, origin in targets.items()}
        bases = {s: base for s, base in found.items() if base is not None}
        rules = (*self.parts.start_rules, *([KnownTerms(self._known.best_values())] if self.parts.known_terms else []))
        for base in bases.values():
            base.prepare()
        searches = [Task(partial(starting_points, rules, f, s), f.model.objective.outcomes) for s, f in bases.items()]
        points_of = self.control.map(searches, lambda done: self.control.report(what, 0.2 + 0.3 * done))
        starts = {s: points for s, points in zip(bases, points_of, strict=True) if points is not None}
        self._time_is_up(what)
        promised = {s: bases[s].optimum.log_likelihood + _max_gain(points) for s, points in starts.items()}
        order = sorted(starts, key=lambda s: (-promised[s], s.terms))
        tried: list[Structure] = []
        for wave in doubling_batches(order, self.settings.beam_width):
            best = max(
                (self._known.fits[s].optimum.log_likelihood for s in tried if s in self._known.fits), default=-math.inf
            )
            if tried and self._time_is_up(what):
                break
            likely = [s for s in wave if self._may_matter(bases[s], starts[s], best)]
            begin = {s: [start.point for start in starts[s][: self.settings.starts]] for s in likely}
            works = [partial(refit, bases[s], s, begin[s], self._known.tempered) for s in likely]
            self._known.fit_all([replace(bases[s], structure=s) for s in likely], works)
            tried += likely
            self.control.report(what, 0.5 + 0.5 * len(tried) / max(len(order), 1))
        return [s for s in dict.fromkeys((*tried, *starts)) if s in self._known.fits]

    # which structures are worth a fit

    def _may_matter(self, base: FittedModel, starts: Sequence[Start], best: float) -> bool:
        """Tell whether a start predicts enough of the gain up to the log-likelihood of the best of its level.

        Beside other terms it must be a share of what is left, too."""
        predicted = _max_gain(starts)
        if base.terms and predicted < least_gain_beside_terms(base):
            return False
        needed = max(best - base.optimum.log_likelihood, 0.0)
        likely = base.response.gain_under_white_noise(predicted) >= self.settings.min_predicted_gain
        return likely and predicted >= self.settings.min_predicted_share * needed

    # noise, restarts, time

    def _restart(self, tried: Sequence[Structure], what: str) -> None:
        """Restart the fits of the best structures of a level while the residual is structured."""
        for restart, top in self.parts.restarts:
            scores = self._known.order().scores
            likely = sorted((s for s in tried if s in scores), key=lambda s: (scores[s], s.terms))
            for structure in dict.fromkeys((self._known.best().structure, *likely[: top - 1])):
                done = type(restart).__name__, structure
                if self._known.noise.adequate or self._time_is_up(what) or done in self._restarted:
                    continue
                self._restarted.add(done)
                with suppress(CannotFinishError):
                    found = restart.refit(
                        self._fit_alone(structure, self._known.fits[structure].values), self._known.tempered
                    )
                    if found is not None:
                        self._known.keep_better(found)
            self._known.update_noise()

    def _fit_alone(self, structure: Structure, values: Mapping[str, float]) -> FittedModel:
        """Fit a structure from SI values by name, on the model that has its terms and no others."""
        model = self.cache.of(structure)
        return model.fit(
            structure, model.coordinates_of(values, structure.terms), self._known.noise.noise, self._known.tempered
        )

    def _fit_required(self, root: Structure) -> None:
        """Fit the required terms, one after the other."""
        for id_ in self.settings.require:
            structure = root.plus(id_)
            base = self._candidates.base_of(structure, root, self.library)
            if base is not None:
                off = base.optimum.coordinates
                starts = starting_points(self.parts.start_rules, base, structure)
                points = [start.point for start in starts[: self.settings.starts]]
                if (found := refit(base, structure, [*points, off], self._known.tempered)) is not None:
                    self._known.keep_better(replace(base, structure=structure, optimum=found))
            if structure not in self._known.fits:
                raise CannotFinishError(f"the model cannot be simulated with {id_}, which [loop] require asks for")
            root = structure

    def _time_is_up(self, what: str) -> bool:
        """Return whether the time limit has passed; what was being done then is kept."""
        if self.control.time_is_up() and not self._ended:
            self._ended = what
        return bool(self._ended)


def _max_gain(starts: Sequence[Start]) -> float:
    """Largest gain in log-likelihood that a start predicts."""
    return max((s.predicted_gain for s in starts), default=-math.inf)
