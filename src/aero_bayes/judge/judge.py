"""Judge structures by their left-out errors: which of them are material, and which is chosen."""

from __future__ import annotations

from dataclasses import dataclass, field

from aero_bayes.check.residual_tests import ResidualReport, check_residuals, structured_residuals
from aero_bayes.search.comparison import Comparison
from aero_bayes.search.explored import SearchResult
from aero_bayes.search.models import FittedModel
from aero_bayes.search.structure import Structure


@dataclass(frozen=True)
class ChoiceSettings:
    """What counts as a cause."""

    min_share: float = 0.75
    require: tuple[str, ...] = ()


@dataclass(eq=False)
class Judge:
    """Says which structures are material, and which of them is chosen."""

    explored: SearchResult
    comparison: Comparison
    settings: ChoiceSettings
    _only_noise: dict[Structure, bool] = field(default_factory=dict)

    def only_noise(self, structure: Structure) -> bool:
        """Return whether a structure leaves nothing but noise, under the noise of the best structure."""
        if structure not in self._only_noise:
            reports = residual_reports(self.explored.fits[structure], self.explored)
            self._only_noise[structure] = self.explored.noise.adequate and not structured_residuals(reports)
        return self._only_noise[structure]

    def rest(self, structure: Structure, term: str) -> Structure:
        """Return the best structure whose terms are among the others of this one."""
        return best_within(self.comparison, structure.minus(term))

    def material(self, structure: Structure, *, within_error: bool = False) -> bool:
        """Return whether every term matters.

        It lowers the left-out error by a quarter, or clearly and down to the noise."""
        asked = [t for t in structure.terms if t not in self.settings.require]
        rests = [*(self.rest(structure, t) for t in asked), *self.coarser(structure)]
        return bool(structure.terms) and all(self._matters(structure, rest, within_error) for rest in rests)

    def coarser(self, structure: Structure) -> list[Structure]:
        """Return the same with the coarser law in place of a refinement, of what is compared."""
        refines, known = self.explored.refines, self.comparison.squares
        found = [structure.minus(t).plus(refines[t]) for t in structure.terms if t in refines]
        return [s for s in found if s in known]

    def _matters(self, structure: Structure, rest: Structure, within_error: bool) -> bool:
        least = self.settings.min_share
        if within_error and self.comparison.likely_better(structure, rest):
            share = self.comparison.share(structure, rest)
            if share.value - share.sd <= least:
                return True
        if not self.comparison.better(structure, rest, least):
            return False
        much = self.comparison.much_better(structure, rest, least)
        return much or (self.only_noise(structure) and not self.only_noise(rest))

    def near(self) -> list[Structure]:
        """Structures that the best one does not clearly beat, the chosen one first.

        They are material; without any that is, they are those without a term beside the required ones. The chosen one
        has the fewest terms, listed laws before curves, then the fewest parameters."""
        required = set(self.settings.require)
        allowed = [s for s in self.comparison.squares if required <= set(s.terms)]
        among = [s for s in allowed if set(s.terms) > required and self.material(s)]
        among = among or [s for s in allowed if set(s.terms) == required]
        best = self.comparison.best(among)
        near = [s for s in among if s == best or not self.comparison.clearly_better(best, s)]
        if not self.only_noise(best):
            near += [s for s in among if s not in near and self._names_a_curve_of(best, s)]
        curves, fits = set(self.explored.curves), self.explored.fits
        order = {s: (len(s), len(curves & set(s.terms)), len(fits[s].optimum.free)) for s in near}
        return sorted(near, key=lambda s: (*order[s], self.comparison.scores[s]))

    def _names_a_curve_of(self, one: Structure, other: Structure) -> bool:
        """Tell whether another structure has a listed law in place of a curve of one, and is not surely much worse.

        As long as structure is left, a curve also takes up a part of what else is missing."""
        gone, new = one.new_terms(other), other.new_terms(one)
        if len(gone) != 1 or gone[0] not in self.explored.curves:
            return False
        there = self.explored.laws_in_place_of(gone[0], one.minus(*gone), [other])
        return (
            len(new) == 1
            and bool(there)
            and not self.comparison.surely_much_better(one, other, self.settings.min_share)
        )

    def close_to(self, structure: Structure) -> list[Structure]:
        """Return other structures of its size than which it is not materially better, best first.

        They are material, or may be."""
        squares, least = self.comparison.squares, self.settings.min_share
        same_size = [s for s in squares if s != structure and len(s) == len(structure)]
        found = [s for s in same_size if not self.comparison.much_better(structure, s, least)]
        found = [s for s in found if self.material(s, within_error=True)]
        return sorted(found, key=lambda s: self.comparison.scores[s])

    def smaller(self, chosen: Structure) -> tuple[str, ...]:
        """Laws that clearly lower the left-out error beside the chosen terms: those of the best structure of these."""

        def helps(s: Structure) -> bool:
            return all(self.comparison.clearly_better(s, self.rest(s, t)) for t in s.new_terms(chosen))

        larger = [
            s
            for s in self.comparison.squares
            if s.contains(chosen) and s != chosen and not set(s.new_terms(chosen)) & set(self.explored.curves)
        ]
        found = [s for s in larger if helps(s)]
        return self.comparison.best(found).new_terms(chosen) if found else ()


def residual_reports(fitted: FittedModel, explored: SearchResult) -> tuple[ResidualReport, ...]:
    """Reports on the residuals of a fit, under the noise that all structures are compared with."""
    own = fitted.with_noise(explored.noise.noise)
    return check_residuals(own.model.objective.calibration, own.model.objective.series, own.optimum, explored.floors)


def best_within(comparison: Comparison, structure: Structure) -> Structure:
    """Return the best structure that has no terms but those of another."""
    return comparison.best(s for s in comparison.squares if set(s.terms) <= set(structure.terms))
