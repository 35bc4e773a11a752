"""Estimates of all parameters from the Gaussian approximation at the optimum."""

from __future__ import annotations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Identifiability, Status
from aero_bayes.estimate.laplace import Laplace
from aero_bayes.estimate.parameter_estimates import Estimate, fixed_parameters
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH

_NO_INTERVAL: tuple[float | None, float | None, float | None, float | None] = (None, None, None, None)


def laplace_estimates(
    calibration: Calibration,
    values: FloatArray,
    free: tuple[int, ...],
    identifiability: Identifiability,
    laplace: Laplace,
) -> dict[str, Estimate]:
    """Compute value, central 90 % interval and status of every parameter, the model's fixed ones included.

    The interval is that of the Gaussian in search coordinates, mapped to SI units. Parameters that the data do not
    determine, and those on a bound of their search, get none."""
    slopes = calibration.parameters.jacobian(values)
    recordings = calibration.data.names
    table = {}
    for column, item in enumerate(calibration.parameters):
        status = identifiability.status[item.name] if column in free else Status.UNIDENTIFIED
        interval = _NO_INTERVAL
        if status in (Status.IDENTIFIED, Status.WEAK):
            position = free.index(column)
            mean, sd = laplace.mean[position], laplace.sd[position]
            u = mean + sd * np.array([-NORMAL_HALF_WIDTH, 0.0, NORMAL_HALF_WIDTH])
            x = np.exp(u) if item.scale == "log" else u * (item.upper - item.lower)
            low, middle, high = np.clip(x, item.lower, item.upper).tolist()
            interval = float(sd * slopes[column]), low, middle, high
        table[item.name] = Estimate(
            item.name, float(values[column]), *interval, item.unit, status, item.description,
            item.prior.describe(item.unit), item.start, item.lower, item.upper,
            _note(status, column in free, item.name, identifiability),
            recordings[item.recording] if item.recording is not None and len(recordings) > 1 else "",
        )  # fmt: skip
    return table | fixed_parameters(calibration)


def _note(status: Status, free: bool, name: str, identifiability: Identifiability) -> str:
    """Say why a parameter has no interval; empty if it has one."""
    if name in identifiability.in_steps:
        return identifiability.in_steps[name].note
    if name in identifiability.no_effect:
        return "changes no recorded output; left at its start"
    if not free:
        return "not visible in this data; left at its start"
    if status is Status.UNIDENTIFIED:
        return "the data says no more of it than the prior"
    if status is Status.AT_BOUND:
        return "ended on a bound of its search: no interval from there; widen the bound or look at the model"
    return ""
