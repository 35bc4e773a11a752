"""What recordings would have shown: the smallest size of each law at each port that would have been named."""

from __future__ import annotations

import math
from dataclasses import dataclass

from aero_bayes.search.search import Search
from aero_bayes.search.table import Terms, law_of


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
