"""Another way to read data, or to hold values: what it is, what it changes, and how it is told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.find_table import DataFinding, FindingKind
from aero_bayes.data.recording import Recording
from aero_bayes.display import join_names, with_unit
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.objective import Evaluation, Series
from aero_bayes.estimate.residual_tests import structured_residuals
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Outcome, ParameterTarget

#: Factor by which a residual gets smaller at least where only noise is left then; no output gets worse. Correlated
#: noise may hide what is missing: where it is left, the factor has to be as large as where more than noise is.
MIN_CLEAN_FACTOR, MIN_CORRELATED_FACTOR, MIN_WORST = 1.5, 3.0, 0.9
#: Values of parameters that a finding tells.
MOST_VALUES = 4


#: Factors by which a fit of another reading makes the residuals smaller, and whether it leaves structure.
Tried = tuple[list[float], bool]


@dataclass(frozen=True, eq=False)
class Refits:
    """How a fit is done again, with other recordings or another calibration.

    ``each_fitted`` gives what a function tells of the fit of each calibration that another one lets pass, else None."""

    calibrated: Callable[[Sequence[Recording]], Calibration]
    fitted: Callable[[Calibration], Fit]
    open: OpenSimulator
    each_fitted: Callable[
        [Sequence[Calibration], Callable[[Calibration], bool], Callable[[Fit], Tried]], Iterable[Tried | None]
    ]


@dataclass(frozen=True)
class Reading:
    """Another way to read the data."""

    kind: FindingKind
    channel: str
    what: str
    done: str
    recorded: Callable[[Recording], Recording] = lambda recording: recording
    calibrated: Callable[[Calibration], Calibration] = lambda calibration: calibration


def change_of(fit: Fit, again: Fit) -> dict[str, tuple[float, float]]:
    """Compute RMS residuals before and after, in the unit of the output, which reading may have changed."""
    before, after = (
        residual_shares(fit.calibration.data, fit.fitted),
        residual_shares(again.calibration.data, again.fitted),
    )
    rms = fit.rms
    return {o: (rms[o], rms[o] * max(after[o] / before[o], 1e-12)) for o in before if o in after and before[o] > 0.0}


def gains_of(fit: Fit, again: Fit) -> list[float]:
    """Compute the factors by which another fit makes residuals smaller."""
    return [before / after for before, after in change_of(fit, again).values()] or [0.0]


def residual_shares(data: MeasuredData, outputs: Sequence[FloatArray]) -> dict[str, float]:
    """Compute the RMS residual of each output as a share of the standard deviation of its readings."""
    shares = {}
    for k, name in enumerate(data.outputs):
        read = np.concatenate([y[:, k] for y in data.measured])
        left = read - np.concatenate([y[:, k] for y in outputs])
        seen = np.isfinite(left)
        if seen.any() and (size := float(np.std(read[seen]))) > 0.0:
            shares[name] = float(np.sqrt(np.mean(left[seen] ** 2))) / size
    return shares


def with_finding(fit: Fit, reading: Reading, again: Fit) -> Fit:
    """Return the fit with the finding: what it does to the residual, and the values with it."""
    data, units, change = fit.calibration.data, fit.calibration.model.units, change_of(fit, again)
    output = max(change, key=lambda o: change[o][0] / change[o][1])
    before, after = (with_unit(f"{size:.2g}", units.get(output, "")) for size in change[output])
    where = "all recordings" if len(data.recordings) > 1 else data.names[0]
    free = [again.calibration.parameters.items[j] for j in again.free]
    own = [p for p in free if isinstance(p.target, ParameterTarget)][:MOST_VALUES]
    values = join_names([f"{p.name} = {with_unit(f'{again[p.name].value:.4g}', p.unit)}" for p in own])
    then = f", and {values}" if values else ""
    what = f"{reading.what}, the residual of {output} falls from {before} to {after}{then}."
    return told_fit(fit, DataFinding(reading.kind, data.names[0], reading.channel, what, where, reading.done, False))


def told_fit(fit: Fit, finding: DataFinding) -> Fit:
    """Return the fit with a finding at its recordings."""
    data = fit.calibration.data
    told = tuple(replace(r, findings=(finding, *r.findings)) for r in data.recordings)
    return replace(fit, calibration=replace(fit.calibration, data=replace(data, recordings=told)))


def explains_all(fit: Fit, again: Fit, least: float = MIN_CLEAN_FACTOR) -> bool:
    """Return whether another fit leaves nothing but noise, smaller by ``least`` in an output, and larger in none."""
    gains = gains_of(fit, again)
    if any(n.kind == "ou" for n in again.noise.values()):
        least = max(least, MIN_CORRELATED_FACTOR)
    clean = not any(n.model_error for n in again.noise.values()) and not structured_residuals(again.reports)
    return clean and max(gains) >= least and min(gains) >= MIN_WORST


def scaled_rows(
    series: Sequence[Series], run: Evaluation, noise: Mapping[str, OutputNoise]
) -> tuple[FloatArray, FloatArray]:
    """Return residual (N,) and slopes (k, N) of a run in standard deviations of a noise, all series end to end."""
    sd = [noise[s.output].sd for s in series]
    assert run.slopes is not None
    residual = np.concatenate([r / size for r, size in zip(run.residual, sd, strict=True)])
    return residual, np.concatenate([rows / size for rows, size in zip(run.slopes, sd, strict=True)], axis=1)


def fitted_rows(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return :func:`scaled_rows` of a fit at its optimum."""
    return scaled_rows(fit.series, fit.optimum.evaluation, fit.noise)


def changed_outputs(
    fit: Fit, name: str, changed: Callable[[FloatArray], FloatArray], open_simulator: OpenSimulator
) -> list[FloatArray] | None:
    """Return by how much each series of a fit moves with an input's values changed; None where a run fails."""
    data = fit.calibration.data
    moved = data.with_experiments(
        replace(e, inputs=tuple(replace(s, values=changed(s.values)) if s.name == name else s for s in e.inputs))
        for e in data.experiments
    )
    with open_simulator(replace(fit.calibration, data=moved).problem()) as simulator:
        run = simulator.simulate(fit.values[np.newaxis])
    if np.any(run.outcomes != Outcome.OK):
        return None
    before = zip(fit.series, fit.optimum.evaluation.predicted, strict=True)
    return [run.outputs[s.experiment][0, s.sampling.index, s.column] - predicted for s, predicted in before]


def changed_columns(
    recording: Recording, change: Callable[[dict[str, FloatArray]], dict[str, FloatArray]]
) -> Recording:
    inputs, outputs = change(dict(recording.inputs)), change(dict(recording.outputs))
    return replace(recording, inputs=inputs, outputs=outputs, sha256="")


def converted(channel: str, factor: float, offset: float, recording: Recording) -> Recording:
    """Return the recording with ``factor * value + offset`` in one channel."""
    return changed_columns(recording, lambda c: {n: factor * v + offset if n == channel else v for n, v in c.items()})


def after_step(design: FloatArray, residual: FloatArray) -> FloatArray:
    """Return what one Newton step of least squares along rows of slopes (k, n) leaves of a residual (n,)."""
    step = np.linalg.lstsq(design.T, residual, rcond=1e-8)[0] if len(design) else np.zeros(0)
    return np.asarray(residual - step @ design)
