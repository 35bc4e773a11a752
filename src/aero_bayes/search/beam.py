"""The search over structures: a beam over sizes, all structures scored under one noise.

Keep the best structures of each size that lie within honest evidence of the best of that size. Expand them by edits,
fit their neighbours from the starts that the start rules give, take the noise from the best, and score all anew. The
search ends when a whole level brings no better structure, and where the best one is down to its noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

from aero_bayes.ahead import waves
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.search.edits import Direction, EditContext, term_directions
from aero_bayes.search.explored import Explored, Library, Work, ranked
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.search.parts import Parts
from aero_bayes.search.refit import aim_at, refit
from aero_bayes.search.score import CommonNoise, Price, common_noise
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import KnownTerms, Start, starting_points
from aero_bayes.search.structure import Structure, by_size

#: Number of the best structures whose terms are tried in place of others.
MAX_RIVALS = 10
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
    fit : LocalFitSettings
        Of each local fit.
    floors : mapping of (recording, output) to float
        Noise floors where they are known.
    parts : Parts
        Edits, start rules and restarts.
    work : Work
    explained : callable
        Whether the listed laws that were found explain what was missing; else curves are learned.
    """

    cache: ModelCache
    library: Library
    settings: StructureSettings
    fit: LocalFitSettings
    floors: Mapping[tuple[str, str], float]
    parts: Parts
    work: Work = field(default_factory=Work)
    explained: Callable[[Explored], bool] = lambda explored: bool(explored.best.terms)

    def __post_init__(self) -> None:
        self.fit = replace(self.fit, hold_noise=True)
        self._fits: dict[Structure, FittedModel] = {}
        self._expanded: set[Structure] = set()
        self._restarted: set[tuple[str, Structure]] = set()
        self._level_count = 0
        self._moved: dict[tuple[Structure, tuple[str, ...]], FittedModel | None] = {}
        self._promised: dict[Structure, float] = {}
        self._skipped: dict[str, None] = {}
        self._ended, self._unlisted = "", False
        special = frozenset((*self.library.refines, *self.library.curves))
        listed = sum(1 for t in self.library.terms if t not in special)
        free_later = len(self.cache.free_later)
        self._price = Price(listed, self.settings.margin, special, free_later)

    def run(self, root: FittedModel) -> Explored:
        """Search from the fit of the first model.

        Raises
        ------
        CannotFinishError
            If the model cannot be simulated with what is required.
        """
        self._root = root.structure.plus(*self.settings.require)
        self._noise = common_noise(root, self.floors)
        self._fits[root.structure] = root.refitted(self._noise.noise, self._settings)
        if self.settings.require:
            self._require(root.structure)
        self._renew()
        self._restart([], "the first model")
        self._search()
        if self.library.curves and not self._noise.adequate and not self._late("learned curves"):
            self._unlisted = not self.explained(self._explored())
            if self._unlisted:
                self._level([self._fits[self._root]], "learned curves")
                self._search()
        return self._explored()

    def complete(self, fitted: FittedModel) -> Explored:
        """All that was found, and a structure without each of its terms where that was not fitted yet."""
        for id_ in fitted.terms:
            rest = fitted.structure.minus(id_)
            if rest not in self._fits:
                with suppress(CannotFinishError):
                    self._keep(self._alone(rest, fitted.values))
        return self._explored()

    def complete_path(self, order: Sequence[str], fitted: FittedModel) -> Explored:
        """The same for a structure whose terms come in one after the other."""
        explored = self.complete(fitted)
        for id_ in reversed(order):
            fitted = explored.fits.get(fitted.structure.minus(id_), fitted)
            explored = self.complete(fitted)
        return explored

    def _search(self) -> None:
        """Expand until nothing that is worth it is left."""
        while not self._late("the search") and (frontier := self._frontier()):
            beside = self._best().terms
            what = f"level {self._level_count + 1}" + (f" beside {', '.join(beside)}" if beside else "")
            self._level(frontier, what)

    def _level(self, frontier: Sequence[FittedModel], what: str) -> None:
        """Expand structures, take the noise from the best, and fit the best anew from elsewhere."""
        tried = self._expand(frontier, what)
        self._renew()
        self._restart(tried, what)
        self._level_count += 1

    def _explored(self) -> Explored:
        return Explored(
            dict(self._fits), self._noise, self._price, self.floors,
            {s: p for s, p in self._promised.items() if s not in self._fits}, self.cache.ports,
            self.library.refines, tuple(self._skipped),
            self._ended,
        )  # fmt: skip

    @property
    def _settings(self) -> LocalFitSettings:
        """Of a local fit under the present noise."""
        return self.fit.at_temperature(self._noise.noise.temperature)

    # which structures to expand

    def _best(self) -> FittedModel:
        allowed = [f for s, f in self._fits.items() if s.contains_terms(self._root)]
        return max(allowed, key=lambda f: (self._price.score(f), f.structure.terms))

    def _frontier(self) -> list[FittedModel]:
        """The best, and where structure is left those of a size that lie within honest evidence of its best."""
        best = self._best()
        if best.structure not in self._expanded:
            if self._noise.adequate:
                return [best]
            return [best, *(f for f in self._beam(len(best.structure)) if f is not best)]
        if self._noise.adequate or len(best.structure) + 1 >= self.settings.max_effects:
            return []
        # A pair may explain what neither of its terms does alone: one level further than what pays.
        return self._beam(len(best.structure) + 1)

    def _beam(self, size: int) -> list[FittedModel]:
        """Structures of a size that are not yet expanded, best first, within honest evidence of the best."""
        sized = by_size(self._fits).get(size, [])
        own = ranked((self._fits[s] for s in sized if s.contains_terms(self._root)), self._price)
        near = [f for f in own if self._price.score(f) > self._price.score(own[0]) - self.settings.within]
        return [f for f in near[: self.settings.beam] if f.structure not in self._expanded]

    # neighbours

    def _expand(self, frontier: Sequence[FittedModel], what: str) -> list[Structure]:
        """Fit the neighbours of structures; those that were fitted."""
        self._moved.clear()
        best, adequate, targets = self._best(), self._noise.adequate, dict[Structure, Structure]()
        for k, fitted in enumerate(frontier):
            self._expanded.add(fitted.structure)
            self.work.tell(what, 0.2 * k / len(frontier))
            here = EditContext(
                fitted, adequate and fitted is best, self.library.terms, self.library.refines, self.library.curves,
                self._rivals(), self.cache.free_later, tuple(self._directions(fitted)), self.cache.interpolation_is_free,
                fitted is best, self._unlisted,
            )  # fmt: skip
            for edit in self.parts.edits:
                self._fit_smaller(fitted, edit.neighbours(here), targets)
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
                self._keep(self._alone(structure, fitted.values))

    def _fit_larger(self, targets: Mapping[Structure, Structure], what: str) -> list[Structure]:
        """Fit structures that have new terms, the most promising first; give up what cannot matter."""
        bases = {s: found for s, origin in targets.items() if (found := self._base_of(s, origin)) is not None}
        rules = (*self.parts.start_rules, *([KnownTerms(self._known())] if self.parts.known_terms else []))
        looks = {s: partial(starting_points, rules, base, s) for s, base in bases.items()}
        self.work.ahead(list(looks.values()), lambda done: self.work.tell(what, 0.2 + 0.3 * done))
        starts: dict[Structure, list[Start]] = {}
        for structure, look in looks.items():
            if self._late(what):
                break
            starts[structure] = look()
            self._promised[structure] = max(_most(starts[structure]), 0.0) / bases[structure].temperature
        order = sorted(starts, key=lambda s: (-self._promise(bases[s], starts[s]), s.terms))
        tried: list[Structure] = []
        for wave in waves(order, self.settings.beam):
            fitted = [self._fits[s] for s in tried if s in self._fits]
            least = {s: self._least(fitted, len(s)) for s in wave}
            likely = {
                s: partial(refit, bases[s], s, starts[s], self.settings, self._aiming(bases[s], least[s]))
                for s in wave
                if self._may_reach(bases[s], starts[s], least[s])
            }
            self.work.ahead(list(likely.values()), lambda done: None)
            for structure, task in likely.items():
                if tried and self._late(what):
                    break
                if (found := task()) is not None:
                    self._keep(found)
                tried.append(structure)
            self.work.tell(what, 0.5 + 0.5 * len(tried) / max(len(order), 1))
        return [s for s in dict.fromkeys((*tried, *starts)) if s in self._fits]

    def _base_of(self, structure: Structure, origin: Structure) -> FittedModel | None:
        """The largest explored structure within this one, on the model of the new terms; None if it cannot be
        simulated."""
        inside = [s for s in self._fits if structure.contains(s) and s != structure] or [origin]
        base = max(inside, key=lambda s: (len(s), self._fits[s].log_evidence, s.terms))
        new = structure.new_terms(base)
        extra = tuple(dict.fromkeys(id_ for t in new for id_ in self.library.group_of(t)))
        return self._on(self._fits[base], extra)

    def _on(self, fitted: FittedModel, extra: tuple[str, ...]) -> FittedModel | None:
        """The same fit on a model that has further terms at hand."""
        key = fitted.structure, extra
        if key not in self._moved:
            try:
                model = self.cache.of(fitted.structure, extra)
                start = model.at(fitted.values, fitted.terms)
                self._moved[key] = model.fit(fitted.structure, start, self._noise.noise, self._settings)
            except CannotFinishError:
                # A law that is off can still be too stiff for this recording.
                self._skipped |= dict.fromkeys(t for t in extra if t not in fitted.terms)
                self._moved[key] = None
        return self._moved[key]

    def _directions(self, fitted: FittedModel) -> list[Direction]:
        """Linearised response to each offered term."""
        found: list[Direction] = []
        for group in self.library.groups:
            if set(group) & set(self.library.curves):
                continue
            moved = self._on(fitted, tuple(group))
            if moved is not None:
                found += [d for d in term_directions(moved) if d.id in group]
        return found

    def _rivals(self) -> tuple[str, ...]:
        """Terms of the best structures so far."""
        best = ranked(self._fits.values(), self._price)[:MAX_RIVALS]
        return tuple(dict.fromkeys(t for f in best for t in f.terms))

    def _known(self) -> dict[str, dict[str, float]]:
        """Values of each term in the best structure that has it."""
        found: dict[str, dict[str, float]] = {}
        for fitted in ranked(self._fits.values(), self._price):
            for id_ in fitted.terms:
                found.setdefault(id_, fitted.term_values(id_))
        return found

    # what is worth a fit

    def _promise(self, base: FittedModel, starts: Sequence[Start]) -> float:
        return base.log_evidence + _most(starts) / base.temperature

    def _least(self, tried: Sequence[FittedModel], size: int) -> float:
        """Log-evidence below which a structure of this level and size cannot matter.

        The margin is that under the noise which the best of the level leaves, smaller than the present one. A structure
        that no further term may join matters only where the data do not tell it from the best.
        """
        if not tried:
            return -math.inf
        best = max(tried, key=lambda f: f.log_evidence)
        white = best.optimum.whitened
        left = min(float(white.residual @ white.residual) / white.readings, 1.0)
        margin = self.settings.within if size < self.settings.max_effects else self.settings.equivalence
        return best.log_evidence - margin * left

    def _aiming(self, base: FittedModel, least: float) -> LocalFitSettings:
        return self._settings.with_target_cost(aim_at(base, least))

    def _may_reach(self, base: FittedModel, starts: Sequence[Start], least: float) -> bool:
        """Whether any start promises enough: a line is no more than a hint, so that a small part of it will do."""
        promise = _most(starts)
        needed = max(least - base.log_evidence, 0.0)
        likely = base.response.possible(promise) >= self.settings.promise
        return likely and promise / base.temperature >= self.settings.promise_share * needed

    def _keep(self, found: FittedModel) -> None:
        """Keep the better fit of a structure."""
        known = self._fits.get(found.structure)
        if known is None or found.log_evidence > known.with_noise(self._noise.noise).log_evidence:
            self._fits[found.structure] = found

    # noise, restarts, time

    def _renew(self) -> None:
        """Take the noise from the best structure under its own noise, and score all structures under it."""
        for _ in range(MAX_NOISE_UPDATES):
            last = self._noise
            self._noise = self._own_noise()
            if self._noise.noise == last.noise:
                break
            self._rescore()

    def _own_noise(self) -> CommonNoise:
        """Noise of a structure that is the best under its own noise: a fixed point, from the least residual."""
        allowed = {s: f for s, f in self._fits.items() if s.contains_terms(self._root)}
        best = min(allowed, key=lambda s: (sum(math.log(max(r, 1e-300)) for r in allowed[s].rms().values()), s.terms))
        seen: dict[Structure, CommonNoise] = {}
        while best not in seen:
            noise = seen[best] = common_noise(allowed[best], self.floors)
            best = max(allowed, key=lambda s: (self._price.score(allowed[s].with_noise(noise.noise)), s.terms))
        return seen[best]

    def _rescore(self) -> None:
        """Score all structures under the present noise; fit the best of each size anew."""
        self._fits = {s: f.with_noise(self._noise.noise) for s, f in self._fits.items()}
        again = {self._root, Structure()} | {self._best().structure.minus(t) for t in self._best().terms}
        for own in by_size(self._fits).values():
            own.sort(key=lambda s: (-self._price.score(self._fits[s]), s.terms))
            again |= set(own[: self.settings.beam])
        known = [s for s in self._fits if s in again]
        tasks = [partial(self._fits[s].refitted, self._noise.noise, self._settings) for s in known]
        self.work.ahead(tasks, lambda done: None)
        for task in tasks:
            with suppress(CannotFinishError):
                self._keep(task())

    def _restart(self, tried: Sequence[Structure], what: str) -> None:
        """Fit the best structures of a level again from elsewhere while structure is left."""
        for restart, top in self.parts.restarts:
            likely = sorted((s for s in tried if s in self._fits), key=lambda s: (-self._fits[s].log_evidence, s.terms))
            for structure in dict.fromkeys((self._best().structure, *likely[: top - 1])):
                done = type(restart).__name__, structure
                if self._noise.adequate or self._late(what) or done in self._restarted:
                    continue
                self._restarted.add(done)
                with suppress(CannotFinishError):
                    found = restart.again(self._alone(structure, self._fits[structure].values), self._settings)
                    if found is not None:
                        self._keep(found)
            self._renew()

    def _alone(self, structure: Structure, values: Mapping[str, float]) -> FittedModel:
        """A structure fitted from SI values by name, on the model that has its terms and no others."""
        model = self.cache.of(structure)
        return model.fit(structure, model.at(values, structure.terms), self._noise.noise, self._settings)

    def _require(self, root: Structure) -> None:
        """The fit with the terms that must be there, one after the other."""
        for id_ in self.settings.require:
            structure = root.plus(id_)
            base = self._base_of(structure, root)
            if base is not None:
                off = Start(base.optimum.coordinates, 0.0, 0.0)
                starts = [*starting_points(self.parts.start_rules, base, structure), off]
                if (found := refit(base, structure, starts, self.settings, self._settings)) is not None:
                    self._keep(found)
            if structure not in self._fits:
                raise CannotFinishError(f"the model cannot be simulated with {id_}, which [loop] require asks for")
            root = structure

    def _late(self, what: str) -> bool:
        """Whether the time is up; what was being done then is kept."""
        if self.work.late() and not self._ended:
            self._ended = what
        return bool(self._ended)


def _most(starts: Sequence[Start]) -> float:
    """The greatest gain in log-likelihood that any start promises."""
    return max((s.promise for s in starts), default=-math.inf)
