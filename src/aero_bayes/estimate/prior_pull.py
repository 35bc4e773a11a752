"""A prior that the readings contradict: without it the misfit goes, and the value moves by many of its deviations."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.display import join_names
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.other_reading import MIN_WORST, Reading, Refits, explains_all, fitted_rows, with_finding
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import LogUniform, Uniform
from aero_bayes.estimate.result import Fit

#: Standard deviations of a prior by which a value has to be off it, at the fit or one step of the readings alone on.
MIN_PULL = 3.0


def without_wrong_prior(fit: Fit, refits: Refits) -> Fit | None:
    """Return the fit with the finding of priors that are the cause of its misfit; None where they are not."""
    items = fit.calibration.parameters.items
    pulled = _pulled(fit)
    # One prior by one, the farthest first; then all of them.
    for dropped in dict.fromkeys([*((j,) for j in pulled), tuple(pulled)]):
        if not dropped:
            continue
        with suppress(CannotFinishError):
            again = refits.fitted(_without_priors(fit, dropped))
            off = {items[j].name: items[j].prior.deviations(float(again.values[j])) for j in dropped}
            if explains_all(fit, again, MIN_WORST) and max(off.values()) > MIN_PULL:
                return with_finding(fit, _told([items[j] for j in dropped], off), again)
    return None


def _pulled(fit: Fit) -> list[int]:
    """List columns whose priors the fit, or a step of the readings alone from it, is far off: the farthest first."""
    parameters = fit.calibration.parameters
    residual, slopes = fitted_rows(fit)
    step = np.linalg.lstsq(slopes.T, residual, rcond=1e-8)[0] if len(slopes) else np.zeros(0)
    point = parameters.to_search(fit.values)
    point[list(fit.free)] += step
    there = parameters.from_search(np.clip(point, *parameters.box))
    off = {j: max(parameters.items[j].prior.deviations(float(v[j])) for v in (fit.values, there)) for j in fit.free}
    return sorted((j for j in off if off[j] > MIN_PULL), key=lambda j: -off[j])


def _without_priors(fit: Fit, dropped: tuple[int, ...]) -> Calibration:
    """Return the calibration that starts at the fit, with some priors as wide as the bounds."""
    calibration = fit.calibration

    def flat(p: Parameter) -> Parameter:
        return replace(p, prior=LogUniform(p.lower, p.upper) if p.scale == "log" else Uniform(p.lower, p.upper))

    started = calibration.parameters.with_start(fit.values).items
    new = ParameterSet(tuple(flat(p) if j in dropped else p for j, p in enumerate(started)))
    return replace(calibration, parameters=new)


def _told(dropped: list[Parameter], off: dict[str, float]) -> Reading:
    """Return the finding: which priors, and by how many of their deviations the values are off them."""
    priors = join_names([f"{p.prior.describe(p.unit)} for {p.name}" for p in dropped])
    moved = join_names([f"{name} moves by {size:.2g} of its standard deviations" for name, size in off.items()])
    what = f"The readings contradict {'a prior' if len(dropped) == 1 else 'priors'}, {priors}. Without it, {moved}"
    done = "Check the value that the prior states; widen the prior or leave it out."
    return Reading("prior", join_names([p.name for p in dropped]), what, done)
