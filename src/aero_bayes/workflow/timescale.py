"""Do a recording and a model move at the same pace? The modes of the model, from its linearisation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, Problem, SolverSettings, StartTarget
from aero_bayes.simulation.model import Model

#: Span over which the linearised model is propagated, in s.
#: Rates in 1/s below which a mode counts as an integrator, and below which it counts as standing still.
PROPAGATION_TIME, MAX_INTEGRATOR_RATE, MAX_STANDSTILL_RATE = 1e-3, 1e-6, 1e-4
#: Speed at which a model counts as moving, in its unit.
MOVING_SPEED, SPEED_UNITS = 1.0, ("rad/s", "m/s")
#: Share of an eigenvector from which an output is taken to see the mode.
MIN_EIGENVECTOR_SHARE = 1e-9


def check_duration(recordings: Sequence[Recording], model: Model, fixed: Mapping[str, float]) -> None:
    """Refuse recordings that end before the slowest visible mode has."""
    if not model.states:
        return
    rest = np.array([state.start or 0.0 for state in model.states])
    moving = rest + np.array([MOVING_SPEED if state.unit in SPEED_UNITS else 0.0 for state in model.states])
    # Smoothed dry friction holds a body that rests so firmly that it creeps for minutes; in motion it does not.
    points = [_modes(model, fixed, start) for start in (rest, moving)]
    for recording in recordings:
        seen = [name for name, values in recording.outputs.items() if np.isfinite(values).any()]
        needed = min(
            max((m.length for m in modes if abs(m.rate) >= MAX_STANDSTILL_RATE and m.seen_by(seen)), default=0.0)
            for modes in points
        )
        if recording.duration < needed:
            raise InputError(
                f"{recording.name}: lasts {recording.duration:.3g} s, but the slowest motion of {model.name} visible "
                f"in {', '.join(seen)} takes {needed:.3g} s; expected a recording at least that long"
            )


def slow_sampling_warning(recordings: Sequence[Recording], model: Model, fixed: Mapping[str, float]) -> str:
    """Say that every motion of the model as it stands is over between two samples; empty if it is not.

    Times in ms that are read as s look like this, but so does a count a day of what doubles in a day, or a model whose
    values before the fit are far off."""
    recording = max(recordings, key=lambda r: r.interval)
    signals = tuple(InputSignal(name, np.zeros(1), values[:1]) for name, values in recording.inputs.items())
    rest = np.array([state.start or 0.0 for state in model.states])
    try:
        modes = _modes(model, fixed, rest, signals) if model.states else []
    except InputError:
        return ""  # a fit may begin elsewhere
    slowest = max((m.length for m in modes), default=0.0)
    if not slowest or recording.interval <= slowest:
        return ""
    return (
        f"{recording.path or recording.name}, column time: a sample every {recording.interval:.3g} s, but the slowest "
        f"motion of {model.name} before the fit takes {slowest:.3g} s; if the times are in ms, give "
        '[data.columns.time] unit = "ms"'
    )


@dataclass(frozen=True)
class EigenMode:
    """A mode by its rate in 1/s, and which states and outputs show it."""

    rate: complex
    shown: Mapping[str, bool]

    @property
    def length(self) -> float:
        """Its period in s, or its time constant where it does not oscillate."""
        return 2.0 * math.pi / abs(self.rate) if abs(self.rate.imag) > MAX_STANDSTILL_RATE else 1.0 / abs(self.rate)

    def seen_by(self, outputs: Sequence[str]) -> bool:
        """Return whether one of the outputs shows it."""
        return any(self.shown.get(name, True) for name in outputs)


def _modes(
    model: Model, fixed: Mapping[str, float], start: FloatArray, inputs: tuple[InputSignal, ...] = ()
) -> list[EigenMode]:
    """Return the modes about a state (s,) but for integrators, with inputs at zero where they are not given."""
    names = tuple(state.name for state in model.states)
    experiment = Experiment(np.array([0.0, PROPAGATION_TIME]), names, inputs)
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
        rate = np.log(complex(value)) / PROPAGATION_TIME
        if abs(rate) < MAX_INTEGRATOR_RATE:
            continue
        shares = dict(zip(names, (np.abs(vector) > MIN_EIGENVECTOR_SHARE * np.abs(vector).max()).tolist(), strict=True))
        shares |= {output: shares[state] for output, state in aliases.items()}
        modes.append(EigenMode(rate, shares))
    return modes
