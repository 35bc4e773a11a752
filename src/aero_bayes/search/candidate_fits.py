"""Fits on models that have candidate terms built in, switched off: where larger structures are fitted from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from aero_bayes.errors import CannotFinishError
from aero_bayes.search.compared_fits import ComparedFits
from aero_bayes.search.edits import Direction, term_directions
from aero_bayes.search.explored import Library
from aero_bayes.search.models import FittedModel, ModelCache
from aero_bayes.search.structure import Structure


@dataclass(eq=False)
class CandidateFits:
    """Fits of explored structures on models with further candidate terms."""

    cache: ModelCache
    known: ComparedFits
    skipped: dict[str, None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._fits: dict[tuple[Structure, tuple[str, ...]], FittedModel | None] = {}

    def clear(self) -> None:
        """Forget the fits, which were made under an earlier noise."""
        self._fits.clear()

    def of(self, fitted: FittedModel, extra: tuple[str, ...]) -> FittedModel | None:
        """Return the same fit on a model that has further candidate terms built in, switched off."""
        key = fitted.structure, extra
        if key not in self._fits:
            try:
                model = self.cache.of(fitted.structure, extra)
                start = model.coordinates_of(fitted.values, fitted.terms)
                self._fits[key] = model.fit(fitted.structure, start, self.known.noise.noise, self.known.tempered)
            except CannotFinishError:
                # Even switched off, a law may make the model too stiff to simulate.
                self.skipped |= dict.fromkeys(t for t in extra if t not in fitted.terms)
                self._fits[key] = None
        return self._fits[key]

    def base_of(self, structure: Structure, origin: Structure, library: Library) -> FittedModel | None:
        """Return the largest explored structure within this one, on the model of the new terms; None if it cannot be
        simulated."""
        inside = [s for s in self.known.fits if structure.contains(s) and s != structure] or [origin]
        scores = self.known.order().scores
        base = max(inside, key=lambda s: (len(s), -scores.get(s, math.inf), s.terms))
        new = structure.new_terms(base)
        extra = tuple(dict.fromkeys(id_ for t in new for id_ in library.group_of(t)))
        return self.of(self.known.fits[base], extra)

    def directions(self, fitted: FittedModel, library: Library) -> list[Direction]:
        """Linearised response to each offered term."""
        found: list[Direction] = []
        for group in library.groups:
            if set(group) & set(library.curves):
                continue
            moved = self.of(fitted, tuple(group))
            if moved is not None:
                found += [d for d in term_directions(moved) if d.id in group]
        return found
