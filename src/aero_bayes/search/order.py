"""The order of structures in a search: their errors on left-out readings by the closed form, each computed once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.search.comparison import Comparison
from aero_bayes.search.left_out import CommonBlocks, newton_errors
from aero_bayes.search.models import FittedModel
from aero_bayes.search.structure import Structure


class LeftOutOrder:
    """Compares fits under one noise by one Newton step for each block that is left out."""

    def __init__(self, like: FittedModel) -> None:
        self._blocks = CommonBlocks.of([like])
        self._errors: dict[Structure, tuple[Optimum, FloatArray]] = {}
        self._comparison: Comparison | None = None

    def of(self, fits: Mapping[Structure, FittedModel]) -> Comparison:
        """Compare fits; those whose errors are not finite are left out."""
        new = [s for s, f in fits.items() if s not in self._errors or self._errors[s][0] is not f.optimum]
        if new or self._comparison is None:
            self._errors |= {s: (fits[s].optimum, newton_errors(fits[s], self._blocks)) for s in new}
            squares = {s: self._errors[s][1] for s in fits if np.all(np.isfinite(self._errors[s][1]))}
            self._comparison = Comparison(squares, self._blocks.outputs, self._blocks.least)
        return self._comparison
