"""The beginning of the recordings that tells as much, reading by reading, as the whole: where structures are explored.

A simulation takes as long as what it covers. Structures are explored on a part of the recordings; those that may be
chosen by it are then fitted to all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from aero_bayes.search.models import FittedModel
from aero_bayes.search.starts import with_nominal_shapes

FloatArray = NDArray[np.float64]

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
    the fit. 1 where no beginning does.

    Parameters
    ----------
    fitted : FittedModel
        The first model at its best, on a model with candidates.
    """
    model = fitted.model
    candidates = [c for c in model.candidates.values() if c.starts and c.id not in fitted.terms]
    point = with_nominal_shapes(fitted, candidates)
    columns = [*model.free(fitted.terms), *(c.columns[0] for c in candidates)]
    found = model.objective.evaluate(point, columns)
    if found is None or found.slopes is None:
        return 1.0
    for share in SHARES:
        parts = list(_compared(fitted, found.slopes, found.residual, share))
        readings = sum(count for count, _, _ in parts)
        if readings < MIN_READINGS:
            continue
        inside = np.sum([part for _, part, _ in parts], axis=0)
        whole = np.sum([all_readings for _, _, all_readings in parts], axis=0)
        seen = whole > 0.0
        if np.all(inside[seen] >= MIN_RELATIVE_INFORMATION * whole[seen] * readings / model.objective.readings):
            return share
    return 1.0


def _compared(
    fitted: FittedModel, slopes: tuple[FloatArray, ...], residual: tuple[FloatArray, ...], share: float
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Yield, for each series its readings in the part, and the information in the part and in the whole.

    The information (k + m,) is that of each of the k columns, and the squared residual of each of the m outputs.
    """
    objective = fitted.model.objective
    for series, by, r in zip(objective.series, slopes, residual, strict=True):
        experiment = objective.calibration.experiments[series.experiment]
        inside = series.sampling.index < int(share * experiment.time.size)
        unit = fitted.optimum.noise[series.output].sd
        own = np.array([output == series.output for output in objective.outputs], dtype=np.float64)
        rows = np.concatenate(((by / unit) ** 2, own[:, np.newaxis] * (r / unit) ** 2))
        yield int(inside.sum()), rows[:, inside].sum(axis=1), rows.sum(axis=1)
