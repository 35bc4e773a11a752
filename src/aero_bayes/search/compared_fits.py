"""Fits of structures under one noise, compared by their errors on readings that were left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum
from aero_bayes.parallel import Task
from aero_bayes.search.common_noise import CommonNoise, common_noise
from aero_bayes.search.comparison import Comparison
from aero_bayes.search.explored import SearchControl
from aero_bayes.search.models import FittedModel
from aero_bayes.search.order import LeftOutOrder
from aero_bayes.search.refit import refit_from_here
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.structure import Structure, by_size

#: Number of the best structures whose terms are tried in place of others.
MAX_RIVALS = 10
#: Largest number of noise updates in a row.
MAX_NOISE_UPDATES = 3


@dataclass(eq=False)
class ComparedFits:
    """The best fit of each structure so far, all under the noise that the best structure leaves."""

    first: FittedModel
    required: Structure
    noise: CommonNoise
    settings: StructureSettings
    fit_settings: LocalFitSettings
    floors: Mapping[tuple[str, str], float]
    control: SearchControl
    fits: dict[Structure, FittedModel] = field(default_factory=dict)

    def __post_init__(self) -> None:
        first = self.first.refitted(self.noise.noise, self.tempered)
        self.fits[first.structure] = first
        self._left_out = LeftOutOrder(first)

    @property
    def tempered(self) -> LocalFitSettings:
        """Settings of a local fit under the present noise."""
        return self.fit_settings.at_temperature(self.noise.noise.temperature)

    def order(self) -> Comparison:
        """Compare all fits by their left-out errors."""
        return self._left_out.of(self.fits)

    def best(self) -> FittedModel:
        """Return the fit of the simplest structure that no other one clearly beats."""
        order = self.order()
        allowed = [s for s in order.squares if s.contains_terms(self.required)]
        return self.fits[order.simplest(allowed, self.settings.min_share)]

    def near_best(self, size: int) -> list[FittedModel]:
        """Return the best structure of a size and those that it does not materially beat, best first."""
        order, least = self.order(), self.settings.min_share
        own = [s for s in order.ranked if len(s) == size and s.contains_terms(self.required)]
        near = [s for s in own if s == own[0] or not order.much_better(own[0], s, least)]
        return [self.fits[s] for s in near[: self.settings.beam_width]]

    def best_terms(self) -> tuple[str, ...]:
        """Return the terms of the best structures so far."""
        return tuple(dict.fromkeys(t for s in self.order().ranked[:MAX_RIVALS] for t in s.terms))

    def best_values(self) -> dict[str, dict[str, float]]:
        """Return values of each term in the best structure that has it."""
        found: dict[str, dict[str, float]] = {}
        for structure in self.order().ranked:
            for id_ in structure.terms:
                found.setdefault(id_, self.fits[structure].term_values(id_))
        return found

    def keep_better(self, found: FittedModel) -> None:
        """Keep the better fit of a structure; none where a term that is not required ends with a magnitude of zero."""
        known, off = self.fits.get(found.structure), set(found.off_terms) - set(self.settings.require)
        if not off and (known is None or found.log_posterior > known.with_noise(self.noise.noise).log_posterior):
            self.fits[found.structure] = found

    def fit_all(self, like: Sequence[FittedModel], works: Sequence[Callable[[], Optimum | None]]) -> None:
        """Do independent fits, each on the model and of the structure of one of ``like``, and keep the better ones."""
        tasks = [Task(work, f.model.objective.outcomes) for f, work in zip(like, works, strict=True)]
        for fitted, end in zip(like, self.control.map(tasks, lambda done: None), strict=True):
            if end is not None:
                self.keep_better(replace(fitted, optimum=end))

    def update_noise(self) -> None:
        """Take the noise from the best structure, and compare all structures under it."""
        for _ in range(MAX_NOISE_UPDATES):
            last, self.noise = self.noise, common_noise(self.best(), self.floors)
            if self.noise.noise == last.noise:
                break
            self._compare_again()

    def _compare_again(self) -> None:
        """Compare all structures under the present noise; fit those anew that are near the best of their size."""
        self.fits = {s: f.with_noise(self.noise.noise) for s, f in self.fits.items()}
        self._left_out = LeftOutOrder(self.fits[self.required])
        again = {self.required, Structure()} | {self.best().structure.minus(t) for t in self.best().terms}
        order, least = self.order(), self.settings.min_share
        for own in by_size(order.ranked).values():
            again |= {s for s in own[: self.settings.beam_width] if not order.far_better(own[0], s, least)}
        known = [s for s in self.fits if s in again]
        works = [partial(refit_from_here, self.fits[s], self.noise.noise, self.tempered) for s in known]
        self.fit_all([replace(self.fits[s], temperature=self.noise.noise.temperature) for s in known], works)
