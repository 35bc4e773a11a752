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
from aero_bayes.search.common_noise import CommonNoise, common_noise
from aero_bayes.search.comparison import Comparison
from aero_bayes.search.edits import Direction, EditContext, term_directions
from aero_bayes.search.explored import Library, SearchControl, SearchResult
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.search.order import LeftOutOrder
from aero_bayes.search.parts import Parts
from aero_bayes.search.refit import fit_anew, refit, refit_from_here
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import KnownTerms, Start, starting_points
from aero_bayes.search.structure import Structure, by_size

#: Number of the best structures whose terms are tried in place of others.
MAX_RIVALS = 10
#: Log-posterior that a fit may lose when it moves to another model of the same structure: that of the solver's steps.
MAX_LOSS = 0.5
#: Largest number of noise updates in a row.
MAX_NOISE_UPDATES = 3


@dataclass(eq=False)
class StructureSearch:
    """Beam search.

    Parameters
    ----------
    cache : ModelCache
    library : Library
    settings : StructureSettings
    fit_settings : LocalFitSettings
        Of each local fit.
    floors : mapping of (recording, output) to float
        Noise floors where they are known.
    parts : Parts
        Edits, start rules and restarts.
    control : SearchControl
    """

    cache: ModelCache
    library: Library
    settings: StructureSettings
    fit_settings: LocalFitSettings
    floors: Mapping[tuple[str, str], float]
    parts: Parts
    control: SearchControl = field(default_factory=SearchControl)

    def __post_init__(self) -> None:
        self.fit_settings = replace(self.fit_settings, hold_noise=True)
        self._fits: dict[Structure, FittedModel] = {}
        self._expanded: set[Structure] = set()
        self._restarted: set[tuple[str, Structure]] = set()
        self._level_count = 0
        self._candidate_fits: dict[tuple[Structure, tuple[str, ...]], FittedModel | None] = {}
        self._skipped: dict[str, None] = {}
        self._proposed_values: Mapping[str, Mapping[str, float]] = {}
        self._ended = ""
        self._completed: set[Structure] = set()

    def run(self, root: FittedModel) -> SearchResult:
        """Search from the fit of the first model.

        Raises
        ------
        CannotFinishError
            If the model cannot be simulated with what is required.
        """
        self._begin(root)
        if not self._noise.exact:
            self._restart([], "the first model")
            self._expand_all()
        return self._result()

    def go_on(self, root: FittedModel, explored: SearchResult, worth: Iterable[Structure]) -> SearchResult:
        """Fit the structures that are worth it of those that were explored on a part of the recordings to all of them.

        They are fitted under the noise that the best one leaves on the part. Where that is only noise, but more is left
        on the whole, the search goes on there.

        Parameters
        ----------
        root : FittedModel
            The first model, fitted to all readings.
        explored : SearchResult
            Of a search on a part of the recordings.
        worth : iterable of Structure
            Some of these.
        """
        self._begin(root, explored.noise)
        self._skipped |= dict.fromkeys(explored.skipped)
        self._ended = explored.ended
        like, works = list[FittedModel](), list[Callable[[], Optimum | None]]()
        for structure in worth:
            with suppress(CannotFinishError):
                model = self.cache.of(structure)
                point = model.coordinates_of(explored.fits[structure].values, structure.terms)
                like.append(replace(self._fits[self._root], model=model, structure=structure))
                works.append(partial(fit_anew, like[-1], point, self._settings))
        self._fit_all(like, works)
        self._update_noise()
        if explored.noise.adequate and not self._noise.adequate:
            self._expand_all()
        return self._result()

    def _begin(self, root: FittedModel, noise: CommonNoise | None = None) -> None:
        """Take the first model, and what is required; compare under a given noise, or that which the best leaves."""
        self._root = root.structure.plus(*self.settings.require)
        self._noise = noise or common_noise(root, self.floors)
        self._fits[root.structure] = root.refitted(self._noise.noise, self._settings)
        self._left_out = LeftOutOrder(self._fits[root.structure])
        if self.settings.require:
            self._fit_required(root.structure)
        if noise is None:
            self._update_noise()

    def offer(self, starts: Mapping[str, Mapping[str, float]]) -> SearchResult:
        """Try further terms, built into one model, beside the first model and the best structure of listed laws.

        Each comes with SI values by name from which a fit begins, its own and those of the first model.
        """
        group, self._proposed_values = tuple(starts), starts
        self.library = replace(self.library, groups=(*self.library.groups, group), proposed=group)
        best = next((f for f in self._result().ranked if not set(f.terms) & set(self.library.curves)), self._best())
        targets = {s.plus(id_): s for s in dict.fromkeys((self._root, best.structure)) for id_ in group}
        tried = self._fit_larger({s: o for s, o in targets.items() if len(s) <= self.settings.max_effects}, "formulas")
        self._update_noise()
        self._restart(tried, "formulas")
        if not self._noise.adequate:
            self._expand_all()
        return self._result()

    def complete(self, fitted: FittedModel) -> SearchResult:
        """Fit the sub-structures with one term left out, too, and the laws at its port in place of each curve.

        A curve alone was compared with the laws at its port when each was tried alone.
        """
        structure = fitted.structure
        if structure in self._completed:
            return self._result()
        self._completed.add(structure)
        for id_ in fitted.terms:
            with suppress(CannotFinishError):
                self._keep_better(self._fit_alone(structure.minus(id_), fitted.values))
        if len(structure) > 1:
            curves, ports = set(self.library.curves), self.cache.ports
            laws = [t for t in self.library.terms if t not in {*curves, *self.library.proposed, *structure.terms}]
            there = {c: [t for t in laws if ports.get(t) == ports.get(c)] for c in curves & set(structure.terms)}
            named = {structure.minus(c).plus(t): structure.minus(c) for c in sorted(there) for t in there[c]}
            if self._fit_larger({s: o for s, o in named.items() if s not in self._fits}, "laws in place of curves"):
                self._update_noise()
        return self._result()

    def alone(self, fitted: FittedModel) -> FittedModel:
        """Return the same fit on the model that has its terms and no others; as it is where that cannot be had."""
        with suppress(CannotFinishError):
            if self.cache.of(fitted.structure) is not fitted.model:
                found = self._fit_alone(fitted.structure, fitted.values)
                if found.log_posterior >= fitted.with_noise(self._noise.noise).log_posterior - MAX_LOSS:
                    return found
        return fitted

    def _expand_all(self) -> None:
        """Expand until no structure is left to expand."""
        while not self._time_is_up("the search") and (frontier := self._frontier()):
            beside = self._best().terms
            what = f"level {self._level_count + 1}" + (f" beside {', '.join(beside)}" if beside else "")
            self._level(frontier, what)

    def _level(self, frontier: Sequence[FittedModel], what: str) -> None:
        """Expand structures, take the noise from the best, and restart the fits of the best."""
        tried = self._expand(frontier, what)
        self._update_noise()
        self._restart(tried, what)
        self._level_count += 1

    def _result(self) -> SearchResult:
        return SearchResult(
            dict(self._fits), self._best(), self._order(), self._noise, self.floors,
            self.cache.ports, self.library.refines, self.library.curves, tuple(self._skipped),
            self._ended, self.library.proposed,
        )  # fmt: skip

    @property
    def _settings(self) -> LocalFitSettings:
        """Of a local fit under the present noise."""
        return self.fit_settings.at_temperature(self._noise.noise.temperature)

    # which structures to expand

    def _order(self) -> Comparison:
        """Compare all fits by their left-out errors."""
        return self._left_out.of(self._fits)

    def _best(self) -> FittedModel:
        order = self._order()
        allowed = [s for s in order.squares if s.contains_terms(self._root)]
        return self._fits[order.simplest(allowed, self.settings.min_share)]

    def _frontier(self) -> list[FittedModel]:
        """Return the best structure; where its residual is structured, also the best of its size."""
        best = self._best()
        if best.structure not in self._expanded:
            if self._noise.adequate:
                return [best]
            return [best, *(f for f in self._beam(len(best.structure)) if f is not best)]
        if self._noise.adequate or len(best.structure) + 1 >= self.settings.max_effects:
            return []
        # A pair may explain what neither of its terms does alone: look one level further.
        return self._beam(len(best.structure) + 1)

    def _beam(self, size: int) -> list[FittedModel]:
        """Return those structures of a size that are to be expanded: the best, and none materially worse than it."""
        order, least = self._order(), self.settings.min_share
        own = [s for s in order.ranked if len(s) == size and s.contains_terms(self._root)]
        near = [s for s in own if s == own[0] or not order.much_better(own[0], s, least)]
        return [self._fits[s] for s in near[: self.settings.beam_width] if s not in self._expanded]

    # neighbours

    def _expand(self, frontier: Sequence[FittedModel], what: str) -> list[Structure]:
        """Fit the neighbours of structures; those that were fitted."""
        self._candidate_fits.clear()
        best, adequate, targets = self._best(), self._noise.adequate, dict[Structure, Structure]()
        for k, fitted in enumerate(frontier):
            self._expanded.add(fitted.structure)
            self.control.report(what, 0.2 * k / len(frontier))
            context = EditContext(
                fitted, adequate and fitted is best, self.library.terms, self.library.refines, self.library.curves,
                self._rivals(), self.cache.free_later, tuple(self._directions(fitted)),
                self.cache.interpolation_is_free, fitted is best,
            )  # fmt: skip
            for edit in self.parts.edits:
                self._fit_smaller(fitted, edit.neighbours(context), targets)
        return self._fit_larger(targets, what)

    def _fit_smaller(
        self, fitted: FittedModel, neighbours: Iterable[Structure], targets: dict[Structure, Structure]
    ) -> None:
        """Fit neighbours without new terms at once, from where the fit is; the others are ``targets``."""
        for structure in neighbours:
            if not structure.contains_terms(self._root) or len(structure) > self.settings.max_effects:
                continue
            if structure.new_terms(fitted.structure):
                if structure not in self._fits:
                    targets.setdefault(structure, fitted.structure)
                continue
            with suppress(CannotFinishError):
                self._keep_better(self._fit_alone(structure, fitted.values))

    def _fit_larger(self, targets: Mapping[Structure, Structure], what: str) -> list[Structure]:
        """Fit structures with new terms in the order of their predicted gain; skip those that cannot matter."""
        bases = {s: found for s, origin in targets.items() if (found := self._base_model(s, origin)) is not None}
        rules = (*self.parts.start_rules, *([KnownTerms(self._best_values())] if self.parts.known_terms else []))
        rules = (*rules, KnownTerms(self._proposed_values))
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
            best = max((self._fits[s].optimum.log_likelihood for s in tried if s in self._fits), default=-math.inf)
            if tried and self._time_is_up(what):
                break
            likely = [s for s in wave if self._may_matter(bases[s], starts[s], best)]
            begin = {s: [start.point for start in starts[s][: self.settings.starts]] for s in likely}
            works = [partial(refit, bases[s], s, begin[s], self._settings) for s in likely]
            self._fit_all([replace(bases[s], structure=s) for s in likely], works)
            tried += likely
            self.control.report(what, 0.5 + 0.5 * len(tried) / max(len(order), 1))
        return [s for s in dict.fromkeys((*tried, *starts)) if s in self._fits]

    def _base_model(self, structure: Structure, origin: Structure) -> FittedModel | None:
        """Return the largest explored structure within this one, on the model of the new terms; None if it cannot be
        simulated."""
        inside = [s for s in self._fits if structure.contains(s) and s != structure] or [origin]
        scores = self._order().scores
        base = max(inside, key=lambda s: (len(s), -scores.get(s, math.inf), s.terms))
        new = structure.new_terms(base)
        extra = tuple(dict.fromkeys(id_ for t in new for id_ in self.library.group_of(t)))
        return self._with_candidates(self._fits[base], extra)

    def _with_candidates(self, fitted: FittedModel, extra: tuple[str, ...]) -> FittedModel | None:
        """Return the same fit on a model that has further candidate terms built in, switched off."""
        key = fitted.structure, extra
        if key not in self._candidate_fits:
            try:
                model = self.cache.of(fitted.structure, extra)
                start = model.coordinates_of(fitted.values, fitted.terms)
                self._candidate_fits[key] = model.fit(fitted.structure, start, self._noise.noise, self._settings)
            except CannotFinishError:
                # Even switched off, a law may make the model too stiff to simulate.
                self._skipped |= dict.fromkeys(t for t in extra if t not in fitted.terms)
                self._candidate_fits[key] = None
        return self._candidate_fits[key]

    def _directions(self, fitted: FittedModel) -> list[Direction]:
        """Linearised response to each offered term."""
        found: list[Direction] = []
        for group in self.library.groups:
            if set(group) & set(self.library.curves):
                continue
            moved = self._with_candidates(fitted, tuple(group))
            if moved is not None:
                found += [d for d in term_directions(moved) if d.id in group]
        return found

    def _rivals(self) -> tuple[str, ...]:
        """Terms of the best structures so far."""
        return tuple(dict.fromkeys(t for s in self._order().ranked[:MAX_RIVALS] for t in s.terms))

    def _best_values(self) -> dict[str, dict[str, float]]:
        """Return values of each term in the best structure that has it."""
        found: dict[str, dict[str, float]] = {}
        for structure in self._order().ranked:
            for id_ in structure.terms:
                found.setdefault(id_, self._fits[structure].term_values(id_))
        return found

    # which structures are worth a fit

    def _may_matter(self, base: FittedModel, starts: Sequence[Start], best: float) -> bool:
        """Tell whether a start predicts enough of the gain up to the log-likelihood of the best of its level."""
        predicted = _max_gain(starts)
        needed = max(best - base.optimum.log_likelihood, 0.0)
        likely = base.response.gain_under_white_noise(predicted) >= self.settings.min_predicted_gain
        return likely and predicted >= self.settings.min_predicted_share * needed

    def _keep_better(self, found: FittedModel) -> None:
        """Keep the better fit of a structure; none where a term that is not required ends with a magnitude of zero."""
        known, off = self._fits.get(found.structure), set(found.off_terms) - set(self.settings.require)
        if not off and (known is None or found.log_posterior > known.with_noise(self._noise.noise).log_posterior):
            self._fits[found.structure] = found

    # noise, restarts, time

    def _update_noise(self) -> None:
        """Take the noise from the best structure, and compare all structures under it."""
        for _ in range(MAX_NOISE_UPDATES):
            last, self._noise = self._noise, common_noise(self._best(), self.floors)
            if self._noise.noise == last.noise:
                break
            self._compare_again()

    def _compare_again(self) -> None:
        """Compare all structures under the present noise; fit the best of each size anew."""
        self._fits = {s: f.with_noise(self._noise.noise) for s, f in self._fits.items()}
        self._left_out = LeftOutOrder(self._fits[self._root])
        again = {self._root, Structure()} | {self._best().structure.minus(t) for t in self._best().terms}
        for own in by_size(self._order().ranked).values():
            again |= set(own[: self.settings.beam_width])
        known = [s for s in self._fits if s in again]
        works = [partial(refit_from_here, self._fits[s], self._noise.noise, self._settings) for s in known]
        self._fit_all([replace(self._fits[s], temperature=self._noise.noise.temperature) for s in known], works)

    def _fit_all(self, like: Sequence[FittedModel], works: Sequence[Callable[[], Optimum | None]]) -> None:
        """Do independent fits, each on the model and of the structure of one of ``like``, and keep the better ones."""
        tasks = [Task(work, f.model.objective.outcomes) for f, work in zip(like, works, strict=True)]
        for fitted, end in zip(like, self.control.map(tasks, lambda done: None), strict=True):
            if end is not None:
                self._keep_better(replace(fitted, optimum=end))

    def _restart(self, tried: Sequence[Structure], what: str) -> None:
        """Restart the fits of the best structures of a level while the residual is structured."""
        for restart, top in self.parts.restarts:
            scores = self._order().scores
            likely = sorted((s for s in tried if s in scores), key=lambda s: (scores[s], s.terms))
            for structure in dict.fromkeys((self._best().structure, *likely[: top - 1])):
                done = type(restart).__name__, structure
                if self._noise.adequate or self._time_is_up(what) or done in self._restarted:
                    continue
                self._restarted.add(done)
                with suppress(CannotFinishError):
                    found = restart.refit(self._fit_alone(structure, self._fits[structure].values), self._settings)
                    if found is not None:
                        self._keep_better(found)
            self._update_noise()

    def _fit_alone(self, structure: Structure, values: Mapping[str, float]) -> FittedModel:
        """Fit a structure from SI values by name, on the model that has its terms and no others."""
        model = self.cache.of(structure)
        return model.fit(structure, model.coordinates_of(values, structure.terms), self._noise.noise, self._settings)

    def _fit_required(self, root: Structure) -> None:
        """Fit the required terms, one after the other."""
        for id_ in self.settings.require:
            structure = root.plus(id_)
            base = self._base_model(structure, root)
            if base is not None:
                off = base.optimum.coordinates
                starts = starting_points(self.parts.start_rules, base, structure)
                points = [start.point for start in starts[: self.settings.starts]]
                if (found := refit(base, structure, [*points, off], self._settings)) is not None:
                    self._keep_better(replace(base, structure=structure, optimum=found))
            if structure not in self._fits:
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
