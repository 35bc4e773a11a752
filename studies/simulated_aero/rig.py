"""The simulated AERO: a truth, a voltage and sensors become a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from simulated_aero.effects import KINDS, EffectKind
from simulated_aero.equations import RigEquations
from simulated_aero.inputs import InputDesign
from simulated_aero.integrate import AeroIntegrator
from simulated_aero.sensors import SensorNoise, Sensors, clean, quantise
from simulated_aero.truth import EffectTruth, Truth

UNITS = {"time": "s", "V_m": "V", "i_m": "A", "omega_m": "rad/s", "theta": "rad"}


@dataclass(frozen=True)
class TrueRun:
    """Undisturbed signals of a run, shape (n,) each, and the rotor's angle in rad for ripple."""

    time: FloatArray
    volts: FloatArray
    i_m: FloatArray
    omega_m: FloatArray
    theta: FloatArray
    angle: FloatArray
    speed: FloatArray


def even_times(duration: float, rate_hz: float) -> FloatArray:
    """Return even sample times from 0 to ``duration`` s, both ends included."""
    return np.arange(round(duration * rate_hz) + 1) / rate_hz


def equations_of(truth: Truth, kinds: Mapping[str, EffectKind] = KINDS) -> RigEquations:
    """Assemble the equations of a rig. Raises InputError for an effect that is not in ``kinds``."""
    equations = RigEquations.of(truth)
    for effect in truth.effects:
        kind = kinds.get(effect.id)
        if kind is None:
            raise InputError(f"bench: no effect {effect.id}")
        kind.truth(**effect.parameters)
        kind.install(equations, effect.parameters)
    return equations


def simulate_truth(
    truth: Truth,
    design: InputDesign,
    time: FloatArray,
    theta_start: float | None = None,
    *,
    kinds: Mapping[str, EffectKind] = KINDS,
) -> TrueRun:
    """Simulate a rig without noise.

    Parameters
    ----------
    truth : Truth
    design : InputDesign
        Commanded voltage, held from each sample to the next and applied ``truth.input_delay`` s late.
    time : ndarray, shape (n,)
        Sample times in s.
    theta_start : float, optional
        Pitch in rad from which the body is let go; by default where it rests undriven. Rotor and body start at rest.
    kinds : mapping of str to EffectKind
        The effects that the rig may have, by id; those of the catalogue by default.

    Raises
    ------
    InputError
        For an effect that is not in ``kinds``.
    """
    equations = equations_of(truth, kinds)
    commands = design.volts(time)
    changes = np.concatenate(([True], commands[1:] != commands[:-1]))
    jump_times = time[changes] + truth.input_delay
    jump_volts = np.array([equations.applied(command) for command in commands[changes].tolist()])
    delayed = np.maximum(time - equations.pitch_delay, time[0])
    grid = _union(time, delayed, jump_times, end=time[-1])
    index = np.searchsorted(jump_times, grid + 1e-10, side="right")
    volts = np.concatenate(([equations.applied(0.0)], jump_volts))[index]
    integrator = AeroIntegrator(equations)
    start = integrator.rest_angle() if theta_start is None else theta_start
    states = integrator.run(grid, volts, integrator.start(start))
    at, late = np.searchsorted(grid, time - 1e-10), np.searchsorted(grid, delayed - 1e-10)
    speed = states[at, 1]
    return TrueRun(
        time=time,
        volts=commands,
        i_m=states[at, 0] + equations.current_offset,
        omega_m=speed if equations.speed_state is None else states[at, 4 + equations.speed_state],
        theta=states[late, 2] + equations.pitch_offset,
        angle=states[at, 4],
        speed=speed,
    )


def measure(run: TrueRun, sensors: Sensors, rng: Generator, name: str = "simulated") -> Recording:
    """Add what the sensors do to a run: noise, quantisation, gaps."""
    streams = rng.spawn(4)
    readings: dict[str, FloatArray] = {}
    channels: tuple[tuple[str, FloatArray, SensorNoise], ...] = (
        ("i_m", run.i_m, sensors.i_m),
        ("omega_m", _tachometer(run, sensors), sensors.omega_m),
        ("theta", run.theta, sensors.theta),
    )
    for stream, (output, values, noise) in zip(streams, channels, strict=False):
        measured = values + noise.sample(stream, run.time, run.angle, run.speed)
        if output == "theta" and sensors.encoder_counts:
            measured = quantise(measured, sensors.encoder_counts)
        if noise.missing:
            measured = np.where(streams[3].random(measured.size) < noise.missing, np.nan, measured)
        readings[output] = measured
    return Recording(name, run.time, {"V_m": run.volts}, readings, UNITS)


def simulate_recording(
    truth: Truth,
    design: InputDesign,
    sensors: Sensors | None = None,
    rng: Generator | None = None,
    *,
    duration: float = 60.0,
    rate_hz: float = 100.0,
    name: str = "simulated",
    kinds: Mapping[str, EffectKind] = KINDS,
) -> Recording:
    """Simulate one recording of a rig, ``duration`` s at ``rate_hz``; see :func:`simulate_truth` and :func:`measure`.

    ``rng`` is needed where ``sensors`` has noise.
    """
    run = simulate_truth(truth, design, even_times(duration, rate_hz), kinds=kinds)
    chosen = sensors or clean()
    if rng is None:
        if chosen != clean():
            raise InputError("bench: noise needs a random generator")
        rng = np.random.default_rng(0)
    return measure(run, chosen, rng, name)


def effect(id: str, **parameters: float) -> EffectTruth:
    """Make an effect of the catalogue by its id. Raises InputError for unknown names."""
    kind = KINDS.get(id)
    if kind is None:
        raise InputError(f"bench: no effect {id}")
    return kind.truth(**parameters)


def _tachometer(run: TrueRun, sensors: Sensors) -> FloatArray:
    if not sensors.tachometer_counts:
        return run.omega_m
    step = 2.0 * np.pi / sensors.tachometer_counts
    counts = np.floor(run.angle / step)
    window = max(1, round(sensors.tachometer_window / float(np.median(np.diff(run.time)))))
    earlier = np.maximum(np.arange(run.time.size) - window, 0)
    elapsed = np.maximum(run.time - run.time[earlier], np.diff(run.time).min())
    speed: FloatArray = (counts - counts[earlier]) * step / elapsed
    return speed


def _union(*parts: FloatArray, end: float) -> FloatArray:
    """Join the times of all parts up to ``end``, sorted, those closer than 1e-10 s taken as one."""
    grid = np.sort(np.concatenate(parts))
    grid = grid[(grid >= parts[0][0]) & (grid <= end)]
    distinct: FloatArray = grid[np.concatenate(([True], np.diff(grid) > 1e-10))]
    return distinct
