"""Readings, inputs or both that are means over the interval before or after their time: tried by simulating means."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from aero_bayes.data.columns import Stamp
from aero_bayes.data.recording import with_means
from aero_bayes.display import join_names
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.other_reading import (
    MIN_WORST,
    Reading,
    Refits,
    after_step,
    explains_all,
    fitted_rows,
    gains_of,
    scaled_rows,
    with_finding,
)
from aero_bayes.estimate.result import Fit

#: Share of a residual's squares that may be left to first order for a refit to try the means: half of the residual.
MOST_LEFT = 0.25
#: Factor by which the residual gets smaller where more than white noise is left: what an input does within an interval
#: is not known.
MIN_FACTOR = 2.0
#: Readings of a recording that tell what is left to first order: of a mean over many of them.
SAMPLES = 1000
#: Most refits, and the factor by which one has to leave less than those before it.
MAX_TRIED, ALIKE = 3, 1.02


def without_means(fit: Fit, refits: Refits) -> Fit | None:
    """Return the fit with the finding of means that explain what it leaves; None where none do."""
    data = fit.calibration.data
    if fit.calibration.model.interface == "co-simulation":  # whose runs take as many times as long as means have nodes
        return None
    tried = []
    for stamps in _candidates(fit):
        with suppress(InputError, CannotFinishError):
            calibration = refits.calibrated([with_means(r, stamps) for r in data.recordings])
            left = _left(fit, calibration, refits.open)
            if left <= MOST_LEFT:
                tried.append((left, stamps, calibration))
    best: tuple[float, Mapping[str, Stamp], Fit] | None = None
    for _, stamps, calibration in sorted(tried, key=lambda one: round(one[0], 2))[:MAX_TRIED]:
        with suppress(CannotFinishError):
            again = refits.fitted(calibration)
            gains = gains_of(fit, again)
            good = explains_all(fit, again) or (max(gains) > MIN_FACTOR and min(gains) >= MIN_WORST)
            # Means of all channels by one time differ by a shift of it only: the end, which is usual, is tried first.
            if good and (best is None or math.prod(gains) > ALIKE * best[0]):
                best = math.prod(gains), stamps, again
    return None if best is None else with_finding(fit, _told(best[1]), best[2])


def _candidates(fit: Fit) -> list[dict[str, Stamp]]:
    """List what may be a mean, and whether its time is where its interval ends: readings, inputs, or both.

    An input that is a mean from its time on is what an input counts as without a word."""
    data = fit.calibration.data
    moving = [n for n in data.recordings[0].inputs if any(np.ptp(r.inputs[n]) > 0.0 for r in data.recordings)]
    outputs = [o for o in data.outputs if not any(o in r.means for r in data.recordings)]
    some: list[list[str]] = [[], outputs, *([[o] for o in outputs] if len(outputs) > 1 else [])]
    found: list[dict[str, Stamp]] = []
    for read in some:
        ends: dict[str, Stamp] = dict.fromkeys(read, "end")
        found += [ends, ends | dict.fromkeys(moving, "end"), dict.fromkeys(read, "beginning")]
    return [one for k, one in enumerate(found) if one and one not in found[:k]]


def _left(fit: Fit, calibration: Calibration, open_simulator: OpenSimulator) -> float:
    """Return the share of the squares that a calibration leaves, to first order about the fitted values."""
    parameters = calibration.parameters
    values = np.array([float(fit[p.name]) if p.name in fit else p.start for p in parameters])
    at = np.clip(parameters.to_search(values), *parameters.box)
    thinned = replace(calibration, data=calibration.data.thinned(SAMPLES))
    with open_simulator(thinned.problem()) as simulator:
        objective = Objective(thinned, simulator)
        run = objective.evaluate(at, range(len(parameters)))
    if run is None or run.slopes is None:
        return math.inf
    residual, slopes = scaled_rows(objective.series, run, fit.noise)
    before, rest = fitted_rows(fit)[0], after_step(slopes, residual)
    return float(np.mean(rest**2)) / max(float(np.mean(before**2)), 1e-300)


def _told(stamps: Mapping[str, Stamp]) -> Reading:
    """Return the finding: which channels are means, over the interval before or after their time."""
    names, stamp = list(stamps), next(iter(stamps.values()))
    side = "before" if stamp == "end" else "after"
    each, many = f'kind = "mean", stamp = "{stamp}"', len(names) > 1
    what = f"{join_names(names)} {'look like means' if many else 'looks like a mean'} over the interval {side} its time"
    done = f"Say so by [data.columns.{names[0]}] {each}{', and so for the others' if many else ''}."
    return Reading("mean", join_names(names), f"{what}: read as such", done, partial(with_means, stamps=stamps))
