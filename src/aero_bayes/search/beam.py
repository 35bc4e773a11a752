"""The search over structures: a beam over sizes, all structures scored under one noise.

Keep the best structures of each size that lie within a margin of tempered log-evidence of the best of that size. Expand
them by edits, fit their neighbours from the starts of the start rules, take the noise from the best, and score all
structures again. The search ends when a level brings no better structure and the best one leaves only noise.
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
from aero_bayes.search.edits import Direction, EditContext, term_directions
from aero_bayes.search.explored import Library, SearchControl, SearchResult, ranked
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.search.parts import Parts
from aero_bayes.search.refit import fit_from, refit, refit_from_here
from aero_bayes.search.score import CommonNoise, Penalty, common_noise
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import KnownTerms, Start, starting_points
from aero_bayes.search.structure import Structure, by_size

#: Number of the best structures whose terms are tried in place of others.
MAX_RIVALS = 10
#: Log-evidence that a fit may lose when it moves to another model of the same structure: that of the solver's steps.
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
        special = frozenset((*self.library.refines, *self.library.curves))
        listed = sum(1 for t in self.library.terms if t not in special)
        free_later = len(self.cache.free_later)
        self._penalty = Penalty(listed, self.settings.margin, special, free_later)

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

        Where the best structure leaves only noise on the part, but more on the whole, the search goes on there.

        Parameters
        ----------
        root : FittedModel
            The first model, fitted to all readings.
        explored : SearchResult
            Of a search on a part of the recordings.
        worth : iterable of Structure
            Some of these.
        """
        self._begin(root)
        self._skipped |= dict.fromkeys(explored.skipped)
        self._ended = explored.ended
        like, works = list[FittedModel](), list[Callable[[], Optimum | None]]()
        for structure in worth:
            with suppress(CannotFinishError):
                model = self.cache.of(structure)
                point = model.coordinates_of(explored.fits[structure].values, structure.terms)
                like.append(replace(root, model=model, structure=structure))
                works.append(partial(fit_from, model, structure, point, self._noise.noise, self._settings))
        self._fit_all(like, works)
        self._update_noise()
        if explored.noise.adequate and not self._noise.adequate:
            self._expand_all()
        return self._result()

    def _begin(self, root: FittedModel) -> None:
        """Take the first model, and what is required, and their noise."""
        self._root = root.structure.plus(*self.settings.require)
        self._noise = common_noise(root, self.floors)
        self._fits[root.structure] = root.refitted(self._noise.noise, self._settings)
        if self.settings.require:
            self._fit_required(root.structure)
        self._update_noise()

    def offer(self, starts: Mapping[str, Mapping[str, float]]) -> SearchResult:
        """Try further terms, built into one model, beside the first model and the best structure of listed laws.

        They count as refinements do: each has to gain more than a listed law. Each comes with SI values by name from
        which a fit begins, its own and those of the first model.
        """
        group, self._proposed_values = tuple(starts), starts
        self.library = replace(self.library, groups=(*self.library.groups, group), proposed=group)
        self._penalty = replace(self._penalty, extra=self._penalty.extra | set(group))
        best = next((f for f in self._result().ranked if not set(f.terms) & set(self.library.curves)), self._best())
        targets = {s.plus(id_): s for s in dict.fromkeys((self._root, best.structure)) for id_ in group}
        tried = self._fit_larger({s: o for s, o in targets.items() if len(s) <= self.settings.max_effects}, "formulas")
        self._update_noise()
        self._restart(tried, "formulas")
        if not self._noise.adequate:
            self._expand_all()
        return self._result()

    def complete(self, fitted: FittedModel) -> SearchResult:
        """Fit the sub-structures with one term left out, too, from where the structure is."""
        if fitted.structure in self._completed:
            return self._result()
        self._completed.add(fitted.structure)
        for id_ in fitted.terms:
            with suppress(CannotFinishError):
                self._keep_better(self._fit_alone(fitted.structure.minus(id_), fitted.values))
        return self._result()

    def alone(self, fitted: FittedModel) -> FittedModel:
        """The same fit on the model that has its terms and no others; as it is where that cannot be had."""
        with suppress(CannotFinishError):
            if self.cache.of(fitted.structure) is not fitted.model:
                found = self._fit_alone(fitted.structure, fitted.values)
                if found.log_evidence >= fitted.with_noise(self._noise.noise).log_evidence - MAX_LOSS:
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
            dict(self._fits), self._noise, self._penalty, self.floors,
            self.cache.ports, self.library.refines, self.library.curves, tuple(self._skipped),
            self._ended, self.library.proposed,
        )  # fmt: skip

    @property
    def _settings(self) -> LocalFitSettings:
        """Of a local fit under the present noise."""
        return self.fit_settings.at_temperature(self._noise.noise.temperature)

    # which structures to expand

    def _best(self) -> FittedModel:
        allowed = [f for s, f in self._fits.items() if s.contains_terms(self._root)]
        return max(allowed, key=lambda f: (self._penalty.score(f), f.structure.terms))

    def _frontier(self) -> list[FittedModel]:
        """The best structure; where its residual is structured, also those of its size within the margin."""
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
        """Structures of a size that are not yet expanded and within the margin of the best, best first."""
        sized = by_size(self._fits).get(size, [])
        own = ranked((self._fits[s] for s in sized if s.contains_terms(self._root)), self._penalty)
        near = [f for f in own if self._penalty.score(f) > self._penalty.score(own[0]) - self.settings.beam_margin]
        return [f for f in near[: self.settings.beam_width] if f.structure not in self._expanded]

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
        order = sorted(starts, key=lambda s: (-self._predicted_evidence(bases[s], starts[s]), s.terms))
        tried: list[Structure] = []
        for wave in doubling_batches(order, self.settings.beam_width):
            fitted = [self._fits[s] for s in tried if s in self._fits]
            least = {s: self._min_evidence(fitted, len(s)) for s in wave}
            if tried and self._time_is_up(what):
                break
            likely = [s for s in wave if self._may_reach(bases[s], starts[s], least[s])]
            begin = {s: [start.point for start in starts[s][: self.settings.starts]] for s in likely}
            works = [partial(refit, bases[s], s, begin[s], self._settings) for s in likely]
            self._fit_all([replace(bases[s], structure=s) for s in likely], works)
            tried += likely
            self.control.report(what, 0.5 + 0.5 * len(tried) / max(len(order), 1))
        return [s for s in dict.fromkeys((*tried, *starts)) if s in self._fits]

    def _base_model(self, structure: Structure, origin: Structure) -> FittedModel | None:
        """The largest explored structure within this one, on the model of the new terms; None if it cannot be
        simulated."""
        inside = [s for s in self._fits if structure.contains(s) and s != structure] or [origin]
        base = max(inside, key=lambda s: (len(s), self._fits[s].log_evidence, s.terms))
        new = structure.new_terms(base)
        extra = tuple(dict.fromkeys(id_ for t in new for id_ in self.library.group_of(t)))
        return self._with_candidates(self._fits[base], extra)

    def _with_candidates(self, fitted: FittedModel, extra: tuple[str, ...]) -> FittedModel | None:
        """The same fit on a model that has further candidate terms built in, switched off."""
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
        best = ranked(self._fits.values(), self._penalty)[:MAX_RIVALS]
        return tuple(dict.fromkeys(t for f in best for t in f.terms))

    def _best_values(self) -> dict[str, dict[str, float]]:
        """Values of each term in the best structure that has it."""
        found: dict[str, dict[str, float]] = {}
        for fitted in ranked(self._fits.values(), self._penalty):
            for id_ in fitted.terms:
                found.setdefault(id_, fitted.term_values(id_))
        return found

    # which structures are worth a fit

    def _predicted_evidence(self, base: FittedModel, starts: Sequence[Start]) -> float:
        return base.log_evidence + _max_gain(starts) / base.temperature

    def _min_evidence(self, tried: Sequence[FittedModel], size: int) -> float:
        """Log-evidence below which a structure of this level and size cannot matter.

        The margin is scaled to the residual of the best structure of the level. A structure of the largest size matters
        only if the data cannot distinguish it from the best.
        """
        if not tried:
            return -math.inf
        best = max(tried, key=lambda f: f.log_evidence)
        white = best.optimum.whitened
        left = min(float(white.residual @ white.residual) / white.readings, 1.0)
        margin = self.settings.beam_margin if size < self.settings.max_effects else self.settings.equivalence
        return best.log_evidence - margin * left

    def _may_reach(self, base: FittedModel, starts: Sequence[Start], least: float) -> bool:
        """Whether a start predicts enough gain; a small share of the needed gain is enough, since it is linearised."""
        predicted = _max_gain(starts)
        needed = max(least - base.log_evidence, 0.0)
        likely = base.response.gain_under_white_noise(predicted) >= self.settings.min_predicted_gain
        return likely and predicted / base.temperature >= self.settings.min_predicted_share * needed

    def _keep_better(self, found: FittedModel) -> None:
        """Keep the better fit of a structure; none where a term that is not required ends with a magnitude of zero."""
        known, off = self._fits.get(found.structure), set(found.off_terms) - set(self.settings.require)
        if not off and (known is None or found.log_evidence > known.with_noise(self._noise.noise).log_evidence):
            self._fits[found.structure] = found

    # noise, restarts, time

    def _update_noise(self) -> None:
        """Take the noise from the best structure under its own noise, and score all structures under it."""
        for _ in range(MAX_NOISE_UPDATES):
            last = self._noise
            self._noise = self._consistent_noise()
            if self._noise.noise == last.noise:
                break
            self._rescore()

    def _consistent_noise(self) -> CommonNoise:
        """Noise under which the structure that it was taken from is the best: a fixed-point iteration."""
        allowed = {s: f for s, f in self._fits.items() if s.contains_terms(self._root)}
        best = min(allowed, key=lambda s: (sum(math.log(max(r, 1e-300)) for r in allowed[s].rms().values()), s.terms))
        seen: dict[Structure, CommonNoise] = {}
        while best not in seen:
            noise = seen[best] = common_noise(allowed[best], self.floors)
            best = max(allowed, key=lambda s: (self._penalty.score(allowed[s].with_noise(noise.noise)), s.terms))
        return seen[best]

    def _rescore(self) -> None:
        """Score all structures under the present noise; fit the best of each size anew."""
        self._fits = {s: f.with_noise(self._noise.noise) for s, f in self._fits.items()}
        again = {self._root, Structure()} | {self._best().structure.minus(t) for t in self._best().terms}
        for own in by_size(self._fits).values():
            own.sort(key=lambda s: (-self._penalty.score(self._fits[s]), s.terms))
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
            likely = sorted((s for s in tried if s in self._fits), key=lambda s: (-self._fits[s].log_evidence, s.terms))
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
        """Whether the time limit has passed; what was being done then is kept."""
        if self.control.time_is_up() and not self._ended:
            self._ended = what
        return bool(self._ended)


def _max_gain(starts: Sequence[Start]) -> float:
    """Largest gain in log-likelihood that a start predicts."""
    return max((s.predicted_gain for s in starts), default=-math.inf)
