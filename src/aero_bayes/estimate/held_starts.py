"""Initial values that the model fixes and a recording contradicts.

A state that no sensor reads starts where the model says. Where that is wrong, other parameters, and any law that is
tried beside them, take up the difference, which fades with the state. A Newton step from a fit says which to free."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.data.find_table import DataFinding
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration, recording_suffix
from aero_bayes.estimate.held_values import searched_too, slopes_beside
from aero_bayes.estimate.initial_states import held_start, state_sizes
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.other_reading import Refits, told_fit
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import StartTarget

#: Share of the squares that a start takes with it at least; robust standard deviations by which it is elsewhere.
MIN_GONE, MIN_DEVIATIONS = 0.1, 3.0
#: Most starts that are fitted, and samples of a recording that they are fitted to.
MOST_TRIED, SAMPLES = 2, 1000


def held_starts(calibration: Calibration) -> dict[str, tuple[Parameter, ...]]:
    """Return, by state, the initial values that could be estimated of those that the model fixes, one a recording."""
    data, model = calibration.data, calibration.model
    known = {state for p in calibration.parameters for state in p.starts}
    known |= {p.target.state for p in calibration.parameters if isinstance(p.target, StartTarget)}
    known |= {state for experiment in data.experiments for state in experiment.start}
    free = [state for state in model.states if state.name not in known]
    if not free:
        return {}
    sizes = state_sizes(model, data.experiments[0], free)
    suffixes = [recording_suffix(data.recordings, k) for k in range(len(data.recordings))]
    return {
        state.name: tuple(held_start(model, state, sizes[state.name], end, k) for k, end in enumerate(suffixes))
        for state in free
    }


def with_start_finding(fit: Fit, refits: Refits) -> Fit:
    """Return the fit with a finding where its residual is no noise, and a start of the model is contradicted."""
    if fit.calibration.process is not None or not any(n.model_error or n.kind == "ou" for n in fit.noise.values()):
        return fit
    with suppress(CannotFinishError):
        for state, own in likely_starts(fit, refits.open)[:MOST_TRIED]:
            wider = searched_too(fit.calibration, own)
            again = refits.fitted(replace(wider, data=wider.data.thinned(SAMPLES)))
            if finding := _finding(fit, again, state, own):
                return told_fit(fit, finding)
    return fit


def likely_starts(fit: Fit, open_simulator: OpenSimulator) -> list[tuple[str, tuple[Parameter, ...]]]:
    """Return the starts whose change by a Newton step takes a share of the squares with it, the best first."""
    if not (held := held_starts(fit.calibration)):
        return []
    every = [p for own in held.values() for p in own]
    if (known := slopes_beside(fit, every, open_simulator)) is None:
        return []
    residual, slopes = known
    slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=1), 1e-300)[:, None]

    def left(rows: list[int]) -> float:
        design = np.vstack([slopes[: len(fit.free)], slopes[rows]])
        rest = residual - np.linalg.lstsq(design.T, residual, rcond=1e-8)[0] @ design
        return float(rest @ rest)

    now = left([])
    column = {p.name: len(fit.free) + k for k, p in enumerate(every)}
    gone = {state: 1.0 - left([column[p.name] for p in own]) / now for state, own in held.items()}
    ordered = sorted((s for s in gone if gone[s] > MIN_GONE), key=lambda s: -gone[s])
    return [(state, held[state]) for state in ordered]


def _finding(fit: Fit, again: Fit, state: str, own: tuple[Parameter, ...]) -> DataFinding | None:
    """Return what a start that was fitted shows; None where it does not."""
    before, after, units = fit.rms, again.rms, fit.calibration.model.units
    output = max(before, key=lambda o: before[o] / max(after[o], 1e-300))
    far = [p for p in own if (sd := again[p.name].sd) and abs(again[p.name].value - p.start) > MIN_DEVIATIONS * sd]
    if not far or after[output] ** 2 > (1.0 - MIN_GONE) * before[output] ** 2:
        return None
    values = join_names([with_unit(f"{again[p.name].value:.5g}", p.unit) for p in far])
    sizes = [with_unit(f"{size[output]:.2g}", units.get(output, "")) for size in (before, after)]
    what = (
        f"{state} starts at {with_unit(f'{own[0].start:.5g}', own[0].unit)} in the model, which the data contradict: "
        f"started at {values}, the residual of {output} falls from {sizes[0]} to {sizes[1]}"
    )
    names = fit.calibration.data.names
    where = "all recordings" if len(far) == len(names) > 1 else ", ".join(names[p.recording or 0] for p in far)
    done = 'Let the fit estimate it by initial_states = "estimated".'
    return DataFinding("value", names[0], state, what, where, done, False)
