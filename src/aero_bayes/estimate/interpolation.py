"""What inputs do between samples, hold or linear: as it is set, or as the data are likelier."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.data.recording import Recording, to_experiment
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import swarm as pso
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.local_fit import GOOD_FIT_RATIO, OpenSimulator, Optimum, floor_ratio
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.simulation.interface import Interpolation
from aero_bayes.simulation.model import Model

#: Least share of an input's changes that follow another change at once, for linear interpolation to make sense.
MIN_FOLLOWING_SHARE = 0.5
#: Gain in log-likelihood at which another interpolation of an input is preferred.
MIN_LOG_LIKELIHOOD_GAIN = 10.0


def moving_inputs(recording: Recording, model: Model) -> tuple[str, ...]:
    """List inputs that may be linear between the samples of a recording: most changes follow another at once."""
    discrete = {variable.name for variable in model.inputs if variable.discrete}
    moving = []
    for name, values in recording.inputs.items():
        changed = np.diff(values) != 0.0
        if name not in discrete and (changed[1:] & changed[:-1]).sum() > MIN_FOLLOWING_SHARE * changed.sum():
            moving.append(name)
    return tuple(moving)


def _moving_anywhere(calibration: Calibration) -> list[str]:
    names = (name for r in calibration.data.recordings for name in moving_inputs(r, calibration.model))
    return list(dict.fromkeys(names))


def with_interpolation(
    calibration: Calibration, interpolation: Mapping[str, Interpolation], only: Collection[int] | None = None
) -> Calibration:
    """Return the calibration with another interpolation of some of its inputs, in some of its recordings.

    Each recording is looked at by itself: what was commanded in steps in one of them holds there."""
    at_rest = calibration.model.declared.recording.zero_at_rest
    data = calibration.data
    experiments = list(data.experiments)
    for k, recording in enumerate(data.recordings):
        if only is None or k in only:
            now = {signal.name: signal.interpolation for signal in experiments[k].inputs}
            moving = moving_inputs(recording, calibration.model)
            wanted = now | {n: how if n in moving else "hold" for n, how in interpolation.items()}
            again = to_experiment(recording, (), zero_at_rest=at_rest, interpolation=wanted)
            experiments[k] = replace(experiments[k], inputs=again.inputs)
    return replace(calibration, data=data.with_experiments(experiments))


def interpolation_for(recording: Recording, data: MeasuredData, model: Model) -> dict[str, Interpolation]:
    """Return what the inputs of a recording that was not fitted do between its samples.

    An input that is linear in the fitted data holds where it jumps now and then, unless it was linear there, too."""
    moving = set(moving_inputs(recording, model))
    for experiment, fitted in zip(data.experiments, data.recordings, strict=True):
        linear = {signal.name for signal in experiment.inputs if signal.interpolation == "linear"}
        moving |= linear - set(moving_inputs(fitted, model))
    return {name: how if name in moving else "hold" for name, how in data.interpolation.items()}


def first_moves_in(calibration: Calibration, new: Mapping[int, Recording]) -> tuple[list[str], list[int]]:
    """Return inputs that move in ``new`` recordings only, by their places, of which no fit tells; and these places."""
    known = set(_moving_anywhere(calibration))
    first = {k: set(moving_inputs(recording, calibration.model)) - known for k, recording in new.items()}
    return sorted(set[str]().union(*first.values())), [k for k, names in first.items() if names]


def choose_interpolation(
    search: GlobalSearch, here: Optimum, open_simulator: OpenSimulator, rng: np.random.Generator
) -> tuple[Calibration, Optimum] | None:
    """Choose the likelier interpolation of each input, hold or linear; None if no input changes.

    With inputs that hold, a fit can have a wrong optimum, such as a resonance above the Nyquist frequency that appears
    at the samples as an alias below it."""
    before = search.objective.calibration
    moving = _moving_anywhere(before)
    if not moving:
        return None
    linear = with_interpolation(before, dict.fromkeys(moving, "linear"))
    # It may be at a wrong optimum: the other interpolation then starts anew.
    far = floor_ratio(search.objective, here.evaluation.residual) > GOOD_FIT_RATIO
    found = _better_fit(search, here, linear, open_simulator, (rng, search.swarm) if far else None)
    best, here = (before, here) if found is None else (linear, found)
    for name in moving if len(moving) > 1 else ():
        other = with_interpolation(best, {name: "hold" if best.data.interpolation[name] == "linear" else "linear"})
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
                found = GlobalSearch(study, search.settings).run(here.free, open_simulator, *anew)
                if found.log_likelihood > enough:
                    return found
        found = GlobalSearch(study, search.settings).refit(here.coordinates, here.free, here.noise)
    return found if found.log_likelihood > enough else None
