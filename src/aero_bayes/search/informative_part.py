"""The beginning of the recordings that tells as much, reading by reading, as the whole: where structures are explored.

A simulation takes as long as what it covers. Structures are explored on a part of the recordings; those that may be
chosen by it are then fitted to all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.objective import Evaluation, Objective
from aero_bayes.search.models import FittedModel
from aero_bayes.search.starts import with_nominal_shapes
from aero_bayes.sensors import OutputNoise

#: Shares of the recordings that are looked at, smallest first.
SHARES = (0.1, 0.15, 0.2, 0.3, 0.4)
#: Readings that the part has at least: some hundred independent ones where the residual is correlated over several.
MIN_READINGS = 800
#: Smallest information of the part on any parameter or term, per reading and relative to that of the whole. The same
#: for the squared residual of each output: what is missing must show there.
MIN_RELATIVE_INFORMATION = 0.5


def informative_share(fitted: FittedModel) -> float:
    """Return the smallest share of each recording, from its beginning, that tells as much per reading as the whole.

    The information is Fisher's, of the free parameters and of the magnitudes of the candidates that the model has, at
    the fit. 1 where no beginning does."""
    model = fitted.model
    candidates = [c for c in model.candidates.values() if c.starts and c.id not in fitted.terms]
    point = with_nominal_shapes(fitted, candidates)
    columns = [*model.free(fitted.terms), *(c.columns[0] for c in candidates)]
    found = model.objective.evaluate(point, columns)
    if found is None or found.slopes is None:
        return 1.0
    for share in SHARES:
        shares = [share] * len(model.objective.calibration.data.experiments)
        if tells_enough(model.objective, found, fitted.optimum.noise, shares, MIN_READINGS):
            return share
    return 1.0


def tells_enough(
    objective: Objective, found: Evaluation, noise: Mapping[str, OutputNoise], shares: Sequence[float], least: int = 1
) -> bool:
    """Return whether the beginnings of the recordings tell as much per reading as the whole."""
    parts = list(_compared(objective, found, noise, shares))
    readings = sum(count for count, _, _ in parts)
    inside = np.sum([part for _, part, _ in parts], axis=0)
    whole = np.sum([all_readings for _, _, all_readings in parts], axis=0)
    enough = inside >= MIN_RELATIVE_INFORMATION * whole * readings / objective.readings
    return readings >= least and bool(np.all(enough[whole > 0.0]))


def _compared(
    objective: Objective, found: Evaluation, noise: Mapping[str, OutputNoise], shares: Sequence[float]
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Yield, for each series its readings in the part, and the information in the part and in the whole.

    The information (k + m,) is that of each of the k columns, and the squared residual of each of the m outputs."""
    assert found.slopes is not None
    for series, by, r in zip(objective.series, found.slopes, found.residual, strict=True):
        rows = objective.calibration.data.experiments[series.experiment].time.size
        inside = series.sampling.index < int(shares[series.experiment] * rows)
        unit = noise[series.output].sd
        own = np.array([output == series.output for output in objective.outputs], dtype=np.float64)
        squares = np.concatenate(((by / unit) ** 2, own[:, np.newaxis] * (r / unit) ** 2))
        yield int(inside.sum()), squares[:, inside].sum(axis=1), squares.sum(axis=1)
