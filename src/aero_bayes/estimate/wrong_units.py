"""Channels in another unit than the model's: found where a poor fit becomes a good one with one of them converted."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import DataFinding, Recording
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.progressive_horizon import OpenSimulator
from aero_bayes.estimate.result import Fit
from aero_bayes.language.units import conversion
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.model import Model

#: Units that loggers write, SI ones among them for models that are not in SI.
UNITS = (
    "K", "degC", "degF", "rad", "deg", "rev", "rad/s", "deg/s", "rpm", "m", "mm", "cm", "m/s", "mm/s", "km/h", "g",
    "m/s2", "Pa", "kPa", "mbar", "bar", "psi", "N", "kN", "mN", "N.m", "mN.m", "W", "kW", "mW", "A", "mA", "V", "mV",
    "kg/s", "kg/min", "kg/h", "g/s", "m3/s", "l/s", "l/min", "m3/h", "kg", "1", "%", "mol", "mmol",
)  # fmt: skip
#: Residual, as a share of what an output moves, from which a fit is so poor that a unit may be the reason.
POOR_SHARE = 0.2
#: Factor by which a right unit makes that share smaller at least; most units that are tried by a fit.
MIN_FACTOR, MAX_TRIED = 3.0, 3


@dataclass(frozen=True)
class _Reading:
    """A channel taken for one in another unit."""

    channel: str
    unit: str
    factor: float
    offset: float

    def of(self, recording: Recording) -> Recording:
        """Return the recording with the channel converted."""

        def converted(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
            return {n: self.factor * v + self.offset if n == self.channel else v for n, v in columns.items()}

        inputs, outputs = converted(dict(recording.inputs)), converted(dict(recording.outputs))
        return replace(recording, inputs=inputs, outputs=outputs, sha256="")


def with_unit_finding(
    fit: Fit,
    calibrated: Callable[[Sequence[Recording]], Calibration],
    fitted: Callable[[Calibration], Fit],
    open_simulator: OpenSimulator,
) -> Fit:
    """Return the fit with a finding of its data where it is poor, and good with one channel in another unit."""
    data = fit.calibration.data
    present = _share(data, fit.fitted)
    if not present > POOR_SHARE or fit.calibration.simulated.process is not None:
        return fit
    tried: list[tuple[float, _Reading, Calibration]] = []
    for reading in _readings(fit.calibration.model):
        with suppress(InputError, CannotFinishError):
            calibration = calibrated([reading.of(r) for r in data.recordings])
            tried.append((_nearest(calibration, fit, open_simulator), reading, calibration))
    best: tuple[float, _Reading, Fit] | None = None
    for _, reading, calibration in sorted(tried, key=lambda one: one[0])[:MAX_TRIED]:
        with suppress(CannotFinishError):
            again = fitted(calibration)
            share = _share(again.calibration.data, again.fitted)
            if share < (best[0] if best else present / MIN_FACTOR):
                best = share, reading, again
    if best is None:
        return fit
    share, reading, _ = best
    finding = DataFinding(
        "unit", data.names[0], reading.channel,
        f"{reading.channel} looks like {reading.unit}: read as such, the fit leaves {100.0 * share:.2g} % of what the "
        f"outputs move, and not {100.0 * present:.2g} %.",
        "all recordings" if len(data.recordings) > 1 else data.names[0],
        f'Say so by [data.columns.{reading.channel}] unit = "{reading.unit}".', False,
    )  # fmt: skip
    told = tuple(replace(r, findings=(*r.findings, finding)) for r in data.recordings)
    return replace(fit, calibration=replace(fit.calibration, data=replace(data, recordings=told)))


def _readings(model: Model) -> list[_Reading]:
    """Return each channel in each unit of its dimension."""
    found = []
    for v in (*model.inputs, *model.outputs):
        for unit in UNITS:
            change = conversion(unit, v.unit) if v.unit else None
            if change is not None and not (math.isclose(change[0], 1.0) and change[1] == 0.0):
                found.append(_Reading(v.name, unit, *change))
    return found


def _nearest(calibration: Calibration, fit: Fit, open_simulator: OpenSimulator) -> float:
    """Return what start values or fitted ones leave of a calibration, whichever is less."""
    parameters = calibration.parameters
    low, high = (np.array([getattr(p, side) for p in parameters]) for side in ("lower", "upper"))
    same = np.array([float(fit[p.name]) if p.recording is None and p.name in fit else p.start for p in parameters])
    rows = np.array([parameters.start, np.clip(same, low, high)])
    with open_simulator(calibration.problem()) as simulator:
        runs = simulator.simulate(rows)
    shares = [
        _share(calibration.data, [y[k] for y in runs.outputs])
        for k in range(len(rows))
        if np.all(runs.outcomes[k] == Outcome.OK)
    ]
    return min(shares, default=math.inf)


def _share(data: MeasuredData, outputs: Sequence[FloatArray]) -> float:
    """Compute the largest RMS residual of an output as a share of the standard deviation of its readings."""
    shares = []
    for k in range(len(data.outputs)):
        read = np.concatenate([y[:, k] for y in data.measured])
        left = read - np.concatenate([y[:, k] for y in outputs])
        seen = np.isfinite(left)
        if seen.any() and (size := float(np.std(read[seen]))) > 0.0:
            shares.append(float(np.sqrt(np.mean(left[seen] ** 2))) / size)
    return max(shares, default=0.0)
