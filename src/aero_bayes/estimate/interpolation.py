"""Choose how an input runs between its samples: it holds its value, or it is interpolated linearly.

A converter holds a commanded voltage (zero-order hold). A measured force is a sample of a smooth signal, for which
linear interpolation is closer. The fit decides for each input that changes at most samples; an input that jumps now and
then was commanded in steps, and holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.data.experiment import to_experiment
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import swarm as pso
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.progressive_horizon import GOOD_FIT_RATIO, OpenSimulator, floor_ratio
from aero_bayes.simulation.interface import Interpolation
from aero_bayes.simulation.model import Model

#: Least share of an input's changes that follow another change at once, for linear interpolation to make sense.
MIN_FOLLOWING_SHARE = 0.5
#: Gain in log-likelihood at which another interpolation of an input is preferred.
MIN_LOG_LIKELIHOOD_GAIN = 10.0


def moving_inputs(data: MeasuredData, model: Model) -> tuple[str, ...]:
    """List inputs that may be linear between their samples: most of their changes follow another change at once."""
    changes: dict[str, int] = {}
    follow: dict[str, int] = {}
    for recording in data.recordings:
        for name, values in recording.inputs.items():
            changed = np.diff(values) != 0.0
            changes[name] = changes.get(name, 0) + int(changed.sum())
            follow[name] = follow.get(name, 0) + int((changed[1:] & changed[:-1]).sum())
    discrete = {variable.name for variable in model.inputs if variable.discrete}
    return tuple(n for n, count in changes.items() if follow[n] > MIN_FOLLOWING_SHARE * count and n not in discrete)


def _with_interpolation(calibration: Calibration, interpolation: Mapping[str, Interpolation]) -> Calibration:
    """Return the calibration with another interpolation of some of its inputs."""
    at_rest = calibration.model.declared.recording.zero_at_rest
    data = calibration.data
    wanted = {**data.interpolation, **interpolation}
    experiments = []
    for experiment, recording in zip(data.experiments, data.recordings, strict=True):
        again = to_experiment(recording, (), zero_at_rest=at_rest, interpolation=wanted)
        experiments.append(replace(experiment, inputs=again.inputs))
    return replace(calibration, data=data.with_experiments(experiments))


def _with_linear_inputs(calibration: Calibration) -> Calibration | None:
    """Return the calibration with linear interpolation of its moving inputs; None if there are none."""
    moving = moving_inputs(calibration.data, calibration.model)
    return _with_interpolation(calibration, dict.fromkeys(moving, "linear")) if moving else None


def with_other_interpolation(calibration: Calibration) -> Calibration | None:
    """Return the calibration with the other interpolation of its moving inputs; None if there are none."""
    if "linear" not in calibration.data.interpolation.values():
        return _with_linear_inputs(calibration)
    return _with_interpolation(calibration, dict.fromkeys(calibration.data.interpolation, "hold"))


def choose_interpolation(
    search: GlobalSearch, result: GlobalSearchResult, open_simulator: OpenSimulator, rng: np.random.Generator
) -> tuple[Calibration, Optimum] | None:
    """Choose the likelier interpolation of each input, hold or linear; None if no input changes.

    With inputs that hold, a fit can have a wrong optimum, such as a resonance above the Nyquist frequency that appears
    at the samples as an alias below it."""
    before, here = search.objective.calibration, result.optimum
    if (linear := _with_linear_inputs(before)) is None:
        return None
    # It may be at a wrong optimum: the other interpolation then starts anew.
    far = floor_ratio(search.objective, here.evaluation.residual) > GOOD_FIT_RATIO
    found = _better_fit(search, here, linear, open_simulator, (rng, result.swarm) if far else None)
    best, here = (before, here) if found is None else (linear, found)
    moving = moving_inputs(before.data, before.model)
    for name in moving if len(moving) > 1 else ():
        other = _with_interpolation(best, {name: "hold" if best.data.interpolation[name] == "linear" else "linear"})
        found = _better_fit(search, here, other, open_simulator)
        best, here = (best, here) if found is None else (other, found)
    return None if best is before else (best, here)


def _better_fit(
    search: GlobalSearch, here: Optimum, other: Calibration, open_simulator: OpenSimulator,
    anew: tuple[np.random.Generator, pso.SwarmResult | None] | None = None,
) -> Optimum | None:  # fmt: skip
    """Return the best fit of another calibration if it is likelier.

    From a known optimum, and from the start if ``anew``."""
    enough = here.log_likelihood + MIN_LOG_LIKELIHOOD_GAIN
    with open_simulator(other.problem()) as simulator:
        study = search.objective.with_calibration(other, simulator)
        if anew is not None:
            with suppress(CannotFinishError):
                found = GlobalSearch(study, search.settings).run(here.free, open_simulator, *anew).optimum
                if found.log_likelihood > enough:
                    return found
        found = GlobalSearch(study, search.settings).refit(here.coordinates, here.free, here.noise)
    return found if found.log_likelihood > enough else None
