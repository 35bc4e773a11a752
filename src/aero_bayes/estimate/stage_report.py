"""What one stage of the search found, for readers: Laplace estimates, noise, width of bands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.global_search import FittedStage
from aero_bayes.estimate.identifiability import Estimate, Identifiability, Status, fixed_parameters
from aero_bayes.estimate.laplace import (
    BLOCK_COUNT,
    MIN_BLOCK_READINGS,
    Laplace,
    LinearisedFit,
    Readings,
    blocks_of_time,
)
from aero_bayes.estimate.levenberg_marquardt import Stage
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.whiteness import residual_correlation_time
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH, StartTarget

#: Share of new readings that a band holds.
BAND_SHARE = 0.9
#: Standard deviations from which an initial value is told to be none of rest.
REST_DEVIATIONS = 3.0
#: Average length of a block that is left out, in correlation times of the residual.
BLOCK_LENGTH = 2.0


def band_factors(
    calibration: Calibration,
    series: Sequence[Series],
    optimum: Optimum,
    covariance: FloatArray,
    residuals: Sequence[FloatArray],
) -> FloatArray:
    """Compute the half-width of the 90 % band of each output, in standard deviations of a predicted reading."""
    if calibration.simulated.process is not None:  # the filter says how much each reading differs from its prediction
        return np.full(len(calibration.data.outputs), NORMAL_HALF_WIDTH)
    assert optimum.evaluation.slopes is not None
    slopes = optimum.evaluation.slopes
    fitted = [residuals[s.experiment][s.sampling.index, s.column] for s in series]
    changes = _leave_out_changes(calibration, series, optimum)
    factors = np.full(len(calibration.data.outputs), NORMAL_HALF_WIDTH)
    for column, output in enumerate(calibration.data.outputs):
        own = [k for k, s in enumerate(series) if s.column == column]
        if not own:
            continue
        noise = optimum.noise[output].sd
        sds = [np.sqrt(noise**2 + np.einsum("kn,kl,ln->n", slopes[k], covariance, slopes[k])) for k in own]
        inside = np.concatenate([np.abs(fitted[k]) / sd for k, sd in zip(own, sds, strict=True)])
        outside = [np.abs(fitted[k] - changes[k]) / sd for k, sd in zip(own, sds, strict=True)]
        factors[column] = max(
            NORMAL_HALF_WIDTH, float(np.quantile(inside, BAND_SHARE)), conformal_quantile(outside, BAND_SHARE)
        )
    return factors


def conformal_quantile(scores: Sequence[FloatArray], share: float) -> float:
    """Compute the value that a new score exceeds with probability ``1 - share`` at most, from correlated scores."""
    every = np.concatenate(scores)
    independent = every.size / residual_correlation_time(scores)
    return float(np.quantile(every, min(share * (1.0 + 1.0 / independent), 1.0)))


def _leave_out_changes(calibration: Calibration, series: Sequence[Series], optimum: Optimum) -> list[FloatArray]:
    """Compute the change of each fitted output (n,) when the recording, or the only one's block, is left out.

    Initial values and delays that belong to one recording stay as fitted to all its readings."""
    assert optimum.evaluation.slopes is not None
    parameters = calibration.parameters
    shared = [k for k, j in enumerate(optimum.free) if parameters.items[j].recording is None]
    linear = LinearisedFit.of(optimum, parameters, shared)
    plain = np.concatenate([by[shared] for by in optimum.evaluation.slopes], axis=1)
    changes = np.zeros(plain.shape[1])
    for left in linear.without(_parts(series, linear.leverage, optimum)):
        changes[left.readings] = left.step @ plain[:, left.readings]
    return np.split(changes, np.cumsum([s.sampling.size for s in series])[:-1])


def _parts(series: Sequence[Series], leverage: FloatArray, optimum: Optimum) -> list[Readings]:
    """Return what is left out in turn: each recording.

    Of a single one, blocks that are long beside the residual's memory."""
    lengths = [residual_correlation_time([r]) for r in optimum.evaluation.residual]
    least = math.ceil(BLOCK_LENGTH * sum(lengths))
    by_recording = blocks_of_time(series, leverage, BLOCK_COUNT, max(least, MIN_BLOCK_READINGS))
    if len(by_recording) > 1:
        return [np.concatenate(blocks) for blocks in by_recording]
    return by_recording[0]


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
            _note(status, column in free, item.name, identifiability) or _off_rest(item, values[column], interval[0]),
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
    together = (m for d in identifiability.flat if name in d.members for m in d.members)
    if fixed := [m for m in dict.fromkeys(together) if identifiability.status[m] is Status.AT_BOUND]:
        return f"the interval holds with {join_names(fixed)} on its bound only"
    return ""


def _off_rest(item: Parameter, value: float, sd: float | None) -> str:
    """Say that a state that the model starts at rest was not; empty for any other parameter."""
    if not isinstance(item.target, StartTarget) or item.start != 0.0 or not sd or abs(value) < REST_DEVIATIONS * sd:
        return ""
    return f"the model starts at 0, which is {abs(value) / sd:.1f} standard deviations off"


@dataclass(frozen=True)
class StageReport(Stage):
    """Where a stage of the local search ended: cost, values and RMS error by output."""

    cost: float
    values: Mapping[str, float]
    rms: Mapping[str, float]


def stage_report(fitted: FittedStage, parameters: ParameterSet, series: Sequence[Series]) -> StageReport:
    """Return values in SI units and errors by output, over all recordings, at the optimum of a stage."""
    residuals: dict[str, list[FloatArray]] = {}
    own = [s for s in series if s.output in fitted.stage.outputs]
    for s, residual in zip(own, fitted.optimum.evaluation.residual, strict=True):
        residuals.setdefault(s.output, []).append(residual)
    rms = {o: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for o, parts in residuals.items()}
    values = parameters.from_search(fitted.optimum.coordinates)
    found = dict(zip(parameters.names, values.tolist(), strict=True))
    return StageReport(fitted.stage.parameters, fitted.stage.outputs, fitted.cost, found, rms)
