"""What recordings would have shown: the smallest size of each law at each port that would have been named."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from aero_bayes.data import noise_floors
from aero_bayes.estimate.filter_objective import objective_of
from aero_bayes.estimate.result import Fit
from aero_bayes.laws.model_family import ModelFamily
from aero_bayes.parallel import ParallelMap
from aero_bayes.search.models import ModelSource
from aero_bayes.search.search import Control, Library, Search
from aero_bayes.search.table import Terms, law_of
from aero_bayes.simulation import WorkerPool, open_simulator


@dataclass(frozen=True)
class Limit:
    """The smallest size of a law at a port that would have been named: a value of its first parameter.

    Its signature in the outputs, once the free parameters have readjusted, raises the error that the model leaves by
    what a material term has to lower it."""

    law: str
    port: str
    parameter: str
    smallest: float
    unit: str


def limits_of(search: Search, model: Terms) -> tuple[Limit, ...]:
    """What the recordings would have shown beside a structure; what no size shows is left out."""
    return tuple(
        Limit(law_of(id_), found.port, found.parameter[0], found.smallest, found.parameter[1])
        for id_, found in sorted(search.screened.get(model, {}).items())
        if math.isfinite(found.smallest) and id_ not in search.source.held
    )


def limits_of_fit(fit: Fit, family: ModelFamily) -> tuple[Limit, ...]:
    """What the recordings of a fit show of each law at each port of its model, beside what the fit leaves."""
    with WorkerPool(0) as pool:
        open_ = partial(open_simulator, pool=pool)
        objective = lambda own: objective_of(own, open_(own.problem()))  # noqa: E731
        source = ModelSource(family, fit.calibration, fit.free, objective, open_, {})
        placed = family.prepare(fit.calibration, fit.optimum, open_)
        laws = tuple(t for t in placed if t not in family.curves())
        floors = noise_floors(fit.calibration.data.recordings, fit.outputs)
        control = Control(ParallelMap(pool), {}, lambda: False, lambda what, share: None)
        search = Search(source, Library(laws, {}, ()), floors, control)
        search.begin(dict(zip(fit.calibration.parameters.names, fit.values.tolist(), strict=True)))
        search.screen((), laws)
        search.models.close()
        return limits_of(search, ())
