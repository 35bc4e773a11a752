"""Is a recording long enough? The slowest mode of the model that its outputs see, from the model's linearisation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, SolverSettings, StartTarget
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]

#: Span over which the linearised model is propagated, in s, and rates below which a mode counts as an integrator.
SPAN, STANDING = 1e-3, 1e-4
#: Speed at which a model counts as moving, in its unit.
SPEED, SPEED_UNITS = 1.0, ("rad/s", "m/s")
#: Share of an eigenvector from which an output is taken to see the mode.
VISIBLE = 1e-9


def check_duration(recordings: Sequence[Recording], model: Model, fixed: Mapping[str, float]) -> None:
    """Refuse recordings that end before the slowest visible mode has.

    Raises
    ------
    InputError
        Naming the recording, its length and the length of the mode; or the FMU, if it cannot be run at all.
    """
    if not model.states:
        return
    rest = np.array([state.start or 0.0 for state in model.states])
    moving = rest + np.array([SPEED if state.unit in SPEED_UNITS else 0.0 for state in model.states])
    # Smoothed dry friction holds a body that rests so firmly that it creeps for minutes; in motion it does not.
    points = [_modes(model, fixed, start) for start in (rest, moving)]
    for recording in recordings:
        seen = [name for name, values in recording.outputs.items() if np.isfinite(values).any()]
        needed = min(
            max((length for length, visible in modes if any(visible.get(name, True) for name in seen)), default=0.0)
            for modes in points
        )
        if recording.duration < needed:
            raise InputError(
                f"{recording.name}: lasts {recording.duration:.3g} s, but the slowest motion of {model.name} that "
                f"{', '.join(seen)} show takes {needed:.3g} s; expected a recording at least that long"
            )


def _modes(model: Model, fixed: Mapping[str, float], start: FloatArray) -> list[tuple[float, dict[str, bool]]]:
    """Length of each mode about a state (s,), and which states show it.

    The length in s is the period, or the time constant where the mode does not oscillate.
    """
    names = tuple(state.name for state in model.states)
    experiment = Experiment(np.array([0.0, SPAN]), names)
    targets = tuple(StartTarget(name) for name in names)
    problem = Problem(model, (experiment,), (targets,), dict(fixed), SolverSettings(1e-10, 1e-10))
    with open_simulator(problem, workers=1) as simulator:
        run = simulator.simulate(start[None], active=range(len(names)))
    if run.outcomes[0, 0] != Outcome.OK or run.sensitivities is None:
        raise InputError(
            f"{model.path}: cannot be simulated at its own start values: {Outcome(run.outcomes[0, 0]).text}; "
            "expected an FMU whose binary runs on this machine"
        )
    values, vectors = np.linalg.eig(run.sensitivities[0][0, -1])
    aliases = {v.name: names[i] for v in model.outputs if (i := model.copied_state(v.name)) is not None}
    modes = []
    for value, vector in zip(values, vectors.T, strict=True):
        if abs(value) < 1e-12:
            continue
        rate = np.log(complex(value)) / SPAN
        if abs(rate) < STANDING:
            continue
        shares = dict(zip(names, (np.abs(vector) > VISIBLE * np.abs(vector).max()).tolist(), strict=True))
        shares |= {output: shares[state] for output, state in aliases.items()}
        modes.append((2.0 * math.pi / abs(rate) if abs(rate.imag) > STANDING else 1.0 / abs(rate), shares))
    return modes
