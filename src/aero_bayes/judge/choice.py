"""The choice of a structure by its error on readings that were left out: place, then name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from aero_bayes.check.residual_tests import ResidualReport, structured_residuals
from aero_bayes.judge.judge import ChoiceSettings, Judge, best_within, residual_reports
from aero_bayes.search.comparison import Comparison, Share
from aero_bayes.search.explored import SearchResult
from aero_bayes.search.models import FittedModel
from aero_bayes.search.structure import Structure, law_of
from aero_bayes.simulation.interface import DelayTarget


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen structure, and what it was chosen from."""

    fitted: FittedModel
    near: tuple[Structure, ...]
    smaller: tuple[str, ...]
    comparison: Comparison
    ranking: Comparison
    before: tuple[ResidualReport, ...]
    after: tuple[ResidualReport, ...]
    explored: SearchResult
    settings: ChoiceSettings
    refused: tuple[Structure, ...] = ()
    undecided: tuple[str, ...] = ()

    @cached_property
    def _judge(self) -> Judge:
        """What is material among the structures that were fitted again."""
        return Judge(self.explored, self.comparison, self.settings)

    @property
    def structure(self) -> Structure:
        return self.fitted.structure

    @property
    def terms(self) -> tuple[str, ...]:
        """The chosen terms, those first that would be missed most."""
        return tuple(sorted(self.structure.terms, key=lambda t: (self.share(t).value, t)))

    def share(self, term: str) -> Share:
        """Left-out error with a chosen term over that without it."""
        return self.comparison.share(self.structure, best_within(self.comparison, self.structure.minus(term)))

    def alike(self, term: str) -> tuple[str, ...]:
        """Return a chosen term and those that the data do not tell from it, best first.

        A curve at its port and a refinement hold it as a special case: they are not listed."""
        explored, rest = self.explored, set(self.structure.terms) - {term}
        others = [s for s in self._alternatives if rest < set(s.terms) and term not in s.terms]
        swapped = [next(iter(set(s.terms) - rest)) for s in sorted(others, key=lambda s: self.comparison.scores[s])]
        own = explored.ports.get(term)
        kept = [
            o
            for o in swapped
            if explored.refines.get(o) != term and not (o in explored.curves and explored.ports.get(o) == own)
        ]
        return tuple(dict.fromkeys((term, *kept)))

    @cached_property
    def _alternatives(self) -> tuple[Structure, ...]:
        """Structures of the same size that the data do not tell from the chosen one, which comes first.

        They are those near it. As long as structure is left, they are those that are not materially worse, too: a
        further missing effect may turn such a difference."""
        delays = {law_of(t) for t in self.structure.terms if self._moves_an_input(t)}

        def may_turn(structure: Structure) -> bool:
            new = structure.new_terms(self.structure)
            return self._is_incomplete or (len(new) == 1 and law_of(new[0]) in delays)

        close = [s for s in self._judge.close_to(self.structure) if may_turn(s)]
        every = dict.fromkeys((self.structure, *self.near, *close))
        return tuple(s for s in every if len(s) == len(self.structure))

    @cached_property
    def _is_incomplete(self) -> bool:
        """Whether structure is left."""
        return bool(structured_residuals(self.after))

    def _moves_an_input(self, term: str) -> bool:
        """Return whether a law is a shift of a recorded input in time."""
        items, candidate = self.fitted.model.objective.parameters.items, self.fitted.model.candidates.get(term)
        columns = candidate.columns if candidate is not None and law_of(term) else ()
        return any(isinstance(items[j].target, DelayTarget) for j in columns)

    @property
    def unsure(self) -> Structure | None:
        """Where nothing is chosen: the best structure with a term that lowers the error by a quarter, not clearly."""
        much = [
            s
            for s in self.comparison.squares
            if len(s) == 1 and self.comparison.much_better(s, self.structure, self.settings.min_share)
        ]
        return self.comparison.best(much) if much and not self.structure.terms else None

    def looks_like(self, term: str) -> str:
        """Return the law at a curve's port that comes near the curve; empty where none does."""
        rest, squares = self.structure.minus(term), self.ranking.squares
        without = best_within(self.ranking, rest)
        there = self.explored.laws_in_place_of(term, rest, squares)
        laws = [s for s in there if self.ranking.much_better(s, without, self.settings.min_share)]
        return self.ranking.best(laws).new_terms(rest)[0] if laws else ""

    def share_of_smaller(self, term: str) -> Share:
        """Left-out error with a smaller term beside the chosen ones over that without it."""
        whole = self.structure.plus(*self.smaller)
        return self.ranking.share(whole, best_within(self.ranking, whole.minus(term)))

    def wins_of_smaller(self, term: str) -> float:
        """Share of resampled blocks in which a smaller term helps."""
        whole = self.structure.plus(*self.smaller)
        return self.ranking.wins([whole, best_within(self.ranking, whole.minus(term))])[whole]

    def at(self, structure: Structure) -> Choice:
        """Return the choice of another structure; no smaller effects are known beside it."""
        judge = self._judge
        own = [s for s in self.comparison.squares if len(s) == len(structure) and s not in self.refused]
        near = [s for s in own if judge.material(s) and not self.comparison.clearly_better(structure, s)]
        fitted = self.explored.fits[structure]
        return replace(
            self, fitted=fitted, near=(structure, *(s for s in near if s != structure)), smaller=(),
            after=residual_reports(fitted, self.explored),
        )  # fmt: skip

    def refuse(self) -> Choice | None:
        """Return the next choice where unseen readings refuse this one; None where nothing is left.

        First come material structures with a part of its terms, then those that training readings do not tell from it:
        the order is that of the training readings, and unseen ones only refuse."""
        refused = (*self.refused, self.structure)
        judge, first = self._judge, refused[0]
        parts = [
            s for s in self.comparison.squares if s.terms and set(s.terms) < set(first.terms) and judge.material(s)
        ]
        parts.sort(key=lambda s: self.comparison.scores[s])
        left = [s for s in (*parts, *self.near) if s.terms and not any(s.contains(other) for other in refused)]
        return replace(self, refused=refused).at(left[0]) if left else None

    def told_whole(self) -> list[Choice]:
        """Return the choices of other structures near it all of whose terms are told."""
        others = [self.at(s) for s in self.near[1:]]
        return [c for c in others if c.told().structure == c.structure]

    def told(self) -> Choice:
        """Return the choice with those terms only whose place, or whose law, all structures have that do as well.

        Of structures that do equally well one is taken whose terms are all told, if there is one. Else what is not told
        is ``undecided``: one of these terms is missing, and the data do not tell at which place."""
        rivals, fits = self._as_good(), self.explored.fits
        most = len(fits[self.structure].optimum.free)
        for s in sorted(rivals, key=lambda s: (s != self.structure, self.comparison.scores[s])):
            allowed = s == self.structure or (len(fits[s].optimum.free) <= most and self._judge.material(s))
            if allowed and self._told_terms(s, rivals) == s.terms:
                return self if s == self.structure else replace(self.at(s), near=(s, *(n for n in self.near if n != s)))
        kept = self._told_terms(self.structure, rivals)
        open_terms = [t for t in self.terms if t not in kept]
        told = Structure(kept)
        others = [t for s in rivals for t in s.terms if t not in self._shared_terms(s, told, rivals)]
        undecided = tuple(dict.fromkeys((*self.undecided, *open_terms, *others)))
        return replace(self, undecided=undecided).at(self._material_part(kept))

    def _material_part(self, kept: Sequence[str]) -> Structure:
        """Return the best material structure of terms that are told, or of what refines them.

        Without any, it is the one with all of them, unless the first model predicts better."""
        judge, required, refines = self._judge, set(self.settings.require), self.explored.refines
        told = required | set(kept)

        def is_told(structure: Structure) -> bool:
            laws = {t if t in told else refines.get(t, t) for t in structure.terms}
            return required <= set(structure.terms) and laws <= told and len(laws) == len(structure)

        inside = [s for s in self.comparison.squares if is_told(s)]
        material = [s for s in inside if set(s.terms) > required and judge.material(s)]
        # Without what is open beside them, terms that are told may lower the error by less than a quarter.
        every = [s for s in inside if set(s.terms) == required | set(kept)]
        return self.comparison.best(material or [*every, *(s for s in inside if set(s.terms) == required)])

    def _told_terms(self, structure: Structure, rivals: Sequence[Structure]) -> tuple[str, ...]:
        """Terms of a structure whose place or law is in all others.

        A curve explains almost anything that a law leaves, so that beside a law it does not tell a further place."""
        required, curves = self.settings.require, self.explored.curves
        shared = [self._shared_terms(structure, s, rivals) for s in rivals]
        told = tuple(t for t in structure.terms if t in required or all(t in own for own in shared))
        laws = tuple(t for t in told if t not in curves or t in required)
        return laws if set(laws) - set(required) else told

    def _shared_terms(self, structure: Structure, other: Structure, rivals: Sequence[Structure]) -> set[str]:
        """Terms of a structure for each of which another one has a term of its own that claims the same."""
        shared = set(structure.terms) & set(other.terms)
        left = [t for t in other.terms if t not in shared]
        for term in structure.terms:
            like = next((t for t in left if self._claims_the_same(structure, term, t, rivals)), None)
            if term not in shared and like is not None:
                shared.add(term)
                left.remove(like)
        return shared

    def _as_good(self) -> list[Structure]:
        """Its alternatives with no more parameters, or that predict better.

        Where only noise is left, those with more parameters have to do so by one standard error: else they are listed,
        but do not keep the simpler one from being told."""
        fits, comparison, own = self.explored.fits, self.comparison, self.structure
        most = len(fits[own].optimum.free)

        def better(structure: Structure) -> bool:
            if self._is_incomplete:
                return comparison.scores[structure] < comparison.scores[own]
            return comparison.likely_better(structure, own)

        return [s for s in self._alternatives if len(fits[s].optimum.free) <= most or better(s)]

    def _claims_the_same(self, structure: Structure, term: str, other: str, rivals: Sequence[Structure]) -> bool:
        """Tell whether another term has this one's law, if at another place, or may be told beside it at its place.

        A curve claims its place only. Refinements of one law claim that law. Two other laws at one place are told as
        alternatives if one can take the place of the other, all else the same, and is material there."""
        explored, law = self.explored, law_of(other)
        if law == law_of(term) and term not in explored.curves:
            return True
        if explored.refines.get(term, term) == explored.refines.get(other, other):
            return True
        ports, curves = explored.ports, explored.curves
        if term in ports and ports.get(term) == ports.get(other) and (term in curves or other in curves):
            return True
        rest = structure.minus(term)
        here = {t for s in rivals for t in s.new_terms(rest) if t in ports and ports.get(t) == ports.get(term)}
        beside = [rest.plus(t) for t in here - {term, *curves} if law_of(t) == law]
        return any(s in rivals and self._judge.material(s) for s in beside)

    @property
    def wins(self) -> float:
        """Share of resampled blocks in which the chosen structure is the best of its size.

        Structures that hold it as a special case do not count."""
        explored = self.explored
        own = {explored.ports.get(t) for t in self.structure.terms}

        def special(term: str) -> bool:
            curve = term in explored.curves and explored.ports.get(term) in own
            return term not in self.structure.terms and (curve or explored.refines.get(term) in self.structure.terms)

        among = [
            s
            for s in self.comparison.squares
            if s == self.structure
            or (len(s) <= len(self.structure) and s.terms != self.structure.terms and not any(map(special, s.terms)))
        ]
        return self.comparison.wins(among)[self.structure]
