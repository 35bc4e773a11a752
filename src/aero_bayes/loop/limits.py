"""What the recordings would have shown: the smallest size of each law at each port that would have been named."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from aero_bayes.search.screen import Screened
from aero_bayes.search.table import law_of


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

    def to_dict(self) -> dict[str, object]:
        return vars(self)


def limits_of(screened: Mapping[str, Screened]) -> tuple[Limit, ...]:
    """The limits from the screening of terms beside the model that came out; what no size shows is left out."""
    return tuple(
        Limit(law_of(id_), found.port, found.parameter[0], found.smallest, found.parameter[1])
        for id_, found in sorted(screened.items())
        if math.isfinite(found.smallest) and not id_.startswith("value@")
    )
