"""The fit at an optimum: identifiability, covariance, curves and what is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import with_unit
from aero_bayes.estimate.delays import settle_blind
from aero_bayes.estimate.exports import structure_warnings
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.identifiability import NO_DERIVATIVE, OPEN_ENDS, Identifiability, Status, assess
from aero_bayes.estimate.intervals import Laplace, curvature_adjustment, noise_covariance, widened_covariance
from aero_bayes.estimate.levenberg_marquardt import LocalSettings, Stop
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.log_posterior import NoiseLayout
from aero_bayes.estimate.objective import Evaluation, Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH, Outcome, ParameterTarget

#: How many times as far the log-likelihood may fall at an end as a linear model says, or as little, and the least fall
#: that is looked at: below it the prior makes the interval.
MAX_FACTOR, LEAST_FALL = 4.0, 0.3
#: Largest difference of two derivatives, one over a small step and one over the interval, as a share of the small
#: one's: a model that switches has no derivative where they differ more.
MAX_DISAGREEMENT = 0.3
#: Factors between two values that look like another prefix of a unit.
THOUSAND = 600.0, 1600.0
#: Most Newton steps of the other parameters where one is at a bound.
MAX_STEPS = 4
NOT_RELIABLE = "interval not reliable: the model is not linear over it; sample the posterior"


def failed_intervals(objective: Objective, here: Optimum, laplace: Laplace) -> dict[str, str]:
    """Return what is wrong with linearised intervals, by parameter: one simulation at each end shows it.

    All other parameters are at their best there, as the linear model has it."""
    free, names = list(here.free), objective.parameters.names
    count = len(free)
    covariance = laplace.covariance[:count, :count]
    sd = np.sqrt(np.diag(covariance))
    if not count or not np.all(sd > 0.0):
        return {}
    steps = NORMAL_HALF_WIDTH * covariance / sd[:, None]
    rows = np.repeat(here.coordinates[None], 2 * count, axis=0)
    rows[:, free] += np.concatenate([steps, -steps])
    rows = np.clip(rows, *objective.parameters.box)
    moved = rows[:, free] - here.coordinates[free]
    score, information = here.whitened.score, here.whitened.information
    expected = 0.5 * np.sum((moved @ information) * moved, axis=1) - moved @ score
    failed: dict[str, str] = {}
    flat: list[int] = []
    runs = objective.residuals(rows)
    for k, found in enumerate(runs):
        if found is None or expected[k] < LEAST_FALL:
            continue
        fall = here.whitened.log_likelihood - objective.whiten(found, here.noise).log_likelihood
        if not expected[k] / MAX_FACTOR < fall < expected[k] * MAX_FACTOR:
            failed[names[free[k % count]]] = NOT_RELIABLE
        if fall < expected[k]:
            flat.append(k)
    for k in flat:
        name = names[free[k % count]]
        if failed.get(name) == NOT_RELIABLE and _reaches_bound(objective, here, rows[k], k):
            failed[name] = OPEN_ENDS[k // count]
    if objective.calibration.model.event_indicators:
        for k, (one, other) in enumerate(zip(runs[:count], runs[count:], strict=True)):
            if one is None or other is None or min(expected[k], expected[k + count]) < LEAST_FALL:
                continue
            change = objective.whiten(other, here.noise).residual - objective.whiten(one, here.noise).residual
            linear = (moved[k] - moved[k + count]) @ here.whitened.slopes
            if float(np.linalg.norm(change - linear)) > MAX_DISAGREEMENT * float(np.linalg.norm(linear)):
                # What one parameter has no derivative by, the others were not fitted to.
                return {names[j]: NO_DERIVATIVE for j in free}
    return failed


def _reaches_bound(objective: Objective, here: Optimum, row: FloatArray, k: int) -> bool:
    """Return whether the readings allow a value at a bound as well, the others at their best there.

    ``row`` is the end of its interval on this side; above for the first half of ``k``, then below."""
    free, row = np.array(here.free), row.copy()
    own, others = k % free.size, np.arange(free.size) != k % free.size
    low, high = objective.parameters.box
    row[free[own]] = (high, low)[k // free.size][free[own]]
    for _ in range(MAX_STEPS):
        found = objective.evaluate(row, here.free)
        if found is None:
            return False
        white = objective.whiten(found, here.noise)
        if here.whitened.log_likelihood - white.log_likelihood < 0.5 * NORMAL_HALF_WIDTH**2:
            return True
        step = np.linalg.lstsq(white.information[np.ix_(others, others)], white.score[others], rcond=None)[0]
        row[free[others]] += step
        row = np.clip(row, low, high)
    return False


def assess_columns(objective: Objective, here: Optimum, columns: tuple[int, ...]) -> tuple[Identifiability, Optimum]:
    """Assess which of some columns the data determine at an optimum."""
    part = ParameterSet(tuple(objective.parameters.items[j] for j in columns))
    found = _evaluated(objective, here, columns)
    white = objective.whiten(found, here.noise)
    wide = replace(here, free=columns, evaluation=found, whitened=white)
    information = white.information
    widening = curvature_adjustment(objective, wide)
    if widening is not None:
        information = widening.map.T @ information @ widening.map
    values = objective.parameters.from_search(here.coordinates)[list(columns)]
    verdict = assess(part.names, values, [p.scale == "log" for p in part], information, part.prior_sd())
    return verdict, wide


def verdict_on(objective: Objective, here: Optimum, optional: Sequence[int]) -> Identifiability:
    """Judge which free and optional columns the data determine, the free ones alone where the others cannot run."""
    columns = tuple(sorted({*here.free, *optional}))
    if columns != here.free and objective.evaluate(here.coordinates, columns) is None:
        columns = here.free
    return assess_columns(objective, here, columns)[0]


def _evaluated(objective: Objective, here: Optimum, columns: tuple[int, ...]) -> Evaluation:
    """Evaluate the optimum with the slopes by some columns; as the search did where a run fails so near to it."""
    found = objective.evaluate(here.coordinates, columns)
    if found is None:
        rows = [here.free.index(j) for j in columns]
        old = here.evaluation
        by = tuple(s[rows] for s in old.slopes) if old.slopes is not None else None
        by_sd = tuple(s[rows] for s in old.log_sd_slopes) if old.log_sd_slopes is not None else None
        found = replace(old, slopes=by, log_sd_slopes=by_sd)
    return found


def _predicted(objective: Objective, values: FloatArray, here: Optimum) -> tuple[FloatArray, ...]:
    """Compute outputs (n, m) of each experiment; where a run fails so near to the optimum, those of the search."""
    found = objective.predictions(values)
    if all(np.isfinite(y).all() for y in found):
        return found
    filled = tuple(np.full_like(y, np.nan) for y in found)
    for series, predicted in zip(objective.series, here.evaluation.predicted, strict=True):
        filled[series.experiment][series.sampling.index, series.column] = predicted
    return filled


def _laplace(objective: Objective, here: Optimum, fitted: Sequence[FloatArray]) -> Laplace:
    """Compute the Gaussian of free columns and noise at an optimum; ``fitted`` are its outputs by experiment."""
    calibration, count = objective.calibration, len(here.free)
    layout = NoiseLayout.of(calibration.data, here.noise)
    covariance = np.zeros((count + layout.size,) * 2)
    covariance[:count, :count] = widened_covariance(objective, here)
    residual = tuple(y - f for y, f in zip(calibration.data.measured, fitted, strict=True))
    times = tuple(e.time for e in calibration.data.experiments)
    covariance[count:, count:] = noise_covariance(layout, times, residual, here.noise)
    mean = np.concatenate([here.coordinates[list(here.free)], layout.pack(here.noise)])
    names = tuple(calibration.parameters.names[j] for j in here.free)
    return Laplace(names + layout.names, mean, covariance, count)


def with_identified(objective: Objective, here: Optimum) -> tuple[int, ...]:
    """Return the free columns and each optional parameter that the data identify."""
    parameters = objective.parameters
    optional = [j for j, p in enumerate(parameters) if p.free_if_identified]
    if not optional:
        return here.free
    verdict = verdict_on(objective, here, optional)
    shown = [j for j in optional if verdict.status.get(parameters.names[j]) is Status.IDENTIFIED]
    return tuple(sorted({*here.free, *shown}))


def at_optimum(fit: Fit, objective: Objective, end: Optimum) -> Fit:
    """Return the fit with another optimum of its objective over the same columns in place of its own."""
    values = fit.values.copy()
    values[list(fit.free)] = objective.parameters.from_search(end.coordinates)[list(fit.free)]
    fitted = _predicted(objective, values, end)
    return replace(
        fit, values=values, optimum=end, laplace=_laplace(objective, end, fitted),
        widening=curvature_adjustment(objective, end), fitted=fitted, modes=(),
        residuals=tuple(y - f for y, f in zip(objective.calibration.data.readings, fitted, strict=True)),
        log_posterior=end.whitened.log_likelihood + end.log_prior,
    )  # fmt: skip


def finished_fit(search: GlobalSearch, here: Optimum, seconds: float, first: GlobalSearch | Fit | None = None) -> Fit:
    """Make the fit of an optimum, with identifiability and covariance under the data's noise for any cost minimised.

    Swarm, stages and work that are told are those of the ``first`` search or fit, where this one continues it."""
    objective, settings, first = search.objective, search.settings, first or search
    calibration = objective.calibration
    if settings.cost != "posterior":
        search = GlobalSearch(objective, replace(settings, cost="posterior", local=LocalSettings(iterations=0)))
        here = search.settle_noise(replace(here, noise=search.initial_noise()))
    optional = tuple(j for j, p in enumerate(calibration.parameters) if p.free_if_identified)
    verdict = verdict_on(objective, here, optional)
    blind = {calibration.parameters.index(name) for name in verdict.no_effect}
    sampled = tuple(j for j in here.free if j not in blind)
    point, steps = settle_blind(objective, here, [j for j in here.free if j in blind])
    verdict = verdict.with_steps(steps)
    part = ParameterSet(tuple(calibration.parameters.items[j] for j in sampled))
    _, here = assess_columns(objective, replace(here, coordinates=point), sampled)
    verdict = with_bounds(verdict, part, point[list(sampled)])
    start = calibration.parameters.start
    # What is still at its start is so to the last digit.
    still = point == calibration.parameters.to_search(start)
    values = np.where(still, start, calibration.parameters.from_search(point))
    fitted = _predicted(objective, values, here)
    interrupted = here.reason is Stop.INTERRUPTED
    told = structure_warnings(calibration, objective.by_output(here.whitened.residual), here.noise)
    likelihood = here.whitened.log_likelihood
    laplace = _laplace(objective, here, fitted)
    return Fit(
        calibration=calibration,
        values=values,
        free=sampled,
        optimum=here,
        series=objective.series,
        identifiability=verdict,
        laplace=laplace,
        failed_intervals=failed_intervals(objective, here, laplace),
        widening=curvature_adjustment(objective, here),
        log_posterior=likelihood + float(part.log_prior(point[None, list(sampled)])[0]),
        fitted=fitted,
        residuals=tuple(y - f for y, f in zip(calibration.data.readings, fitted, strict=True)),
        stages=first.stages,
        swarm=first.swarm,
        iterations=first.iterations,
        start_levels=first.start_levels,
        outcomes={o: int(objective.outcomes[o]) for o in Outcome},
        warnings=(here.reason.value,) if interrupted else (*told, *unit_warnings(part, values[list(sampled)])),
        seconds=seconds,
        settings=settings,
        states=objective.smoothed_states(values),
    )


def unit_warnings(parameters: ParameterSet, values: FloatArray) -> tuple[str, ...]:
    """Ask about values that are a thousand times, or a thousandth of, where their search started: kW for W."""
    told = []
    for p, value in zip(parameters, values.tolist(), strict=True):
        ratio = value / p.start if isinstance(p.target, ParameterTarget) and p.start else 0.0
        if ratio > 0.0 and THOUSAND[0] < max(ratio, 1.0 / ratio) < THOUSAND[1]:
            much = "a thousand times" if ratio > 1.0 else "a thousandth of"
            size = with_unit(f"{value:.3g}", p.unit)
            told.append(
                f"{p.name} = {size} is about {much} the {p.start:.3g} that its search started from: is a column in "
                "another unit than it says, such as kW for W?"
            )
    return tuple(told)


def with_bounds(verdict: Identifiability, part: ParameterSet, point: FloatArray) -> Identifiability:
    """Mark parameters that ended on a bound in the verdict."""
    on_bound = {name: Status.AT_BOUND for name, at in zip(part.names, part.on_bound(point), strict=True) if at}
    return replace(verdict, status=verdict.status | on_bound)
