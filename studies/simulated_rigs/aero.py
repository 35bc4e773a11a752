"""Recordings of the simulated AERO, as its own models name them: the kind of rig, the input's delay, the sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from simulated_rigs.designs import InputDesign, equal_steps, random_levels
from simulated_rigs.kinds import AERO
from simulated_rigs.sensors import SensorNoise, readings, white
from simulated_rigs.signals import Signal, held_command
from simulated_rigs.truth import LawPlace, LawTruth, assembled

UNITS = {"time": "s", "V_m": "V", "i_m": "A", "omega_m": "rad/s", "theta": "rad"}
#: The half-quadrotor bench of the public step recording: one motor, other propellers and a stiffer body.
HALF_QUAD = {**AERO.parameters, "k_t": 8.2e-7, "K_sp": 0.09, "D_p": 0.0056, "R_a": 9.6, "motors": 1.0}


def scaled(**factors: float) -> dict[str, float]:
    """Return the AERO's parameters, some times a factor."""
    return {name: value * factors.get(name, 1.0) for name, value in AERO.parameters.items()}


def pivot_friction(level: float) -> LawTruth:
    """Return dry friction of the pivot, in N m."""
    return LawTruth("coulomb_friction", LawPlace("balance", "q"), {"F_c": level})


@dataclass(frozen=True)
class Truth:
    """A whole simulated AERO: what its model lacks, the delay of its amplifier in s, and its parameters."""

    laws: tuple[LawTruth, ...] = ()
    input_delay: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=lambda: AERO.parameters)

    def run(self, time: FloatArray, volts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Simulate from rest without noise: outputs, shape (n, 3), and states, of which the last is the rotor's angle.

        Each voltage holds to the next sample and is applied ``input_delay`` s late.
        """
        rig = assembled(AERO, self.parameters, self.laws)
        rig.add({"w": rig.state("w"), "angle": rig.add_state()}, {}, angle="w")

        def late(time: FloatArray, values: FloatArray) -> Signal:
            """Apply nothing until the first voltage arrives."""
            return held_command(np.append(time[0], time + self.input_delay), np.append(0.0, values))

        if self.input_delay > 0.0:
            rig.actuators["V_m"] = late
        return rig.run(time, volts[:, None], (0.0, 0.0, 0.0, 0.0))


def even_times(duration: float, rate_hz: float) -> FloatArray:
    """Return even sample times from 0 to ``duration`` s, both ends included."""
    return np.arange(round(duration * rate_hz) + 1) / rate_hz


def simulate_recording(
    truth: Truth,
    design: InputDesign,
    noise: Mapping[str, SensorNoise],
    rng: Generator,
    *,
    duration: float = 60.0,
    rate_hz: float = 100.0,
    name: str = "simulated",
) -> Recording:
    """Record a rig, ``duration`` s at ``rate_hz``; outputs without ``noise`` are read as they are."""
    time = even_times(duration, rate_hz)
    volts = design.volts(time)
    outputs, states = truth.run(time, volts)
    clean = dict(zip(("i_m", "omega_m", "theta"), outputs.T, strict=True))
    measured = readings(rng, time, clean, noise, states[:, -1], states[:, 1])
    return Recording(name, time, {"V_m": volts}, measured, UNITS)


def default_truth() -> Truth:
    """Make a rig a few percent off its data sheet with 1.2 mN m of dry friction in the pivot and a 6 ms input delay."""
    parameters = scaled(R_a=1.07, c_m=0.98, J_r=0.93, J_s=0.93, k_d=1.08, k_t=0.95, D_p=0.9, K_sp=1.05)
    return Truth((pivot_friction(1.2e-3),), 0.006, parameters)


def default_recordings(seed: int = 0) -> list[Recording]:
    """Simulate two training recordings and one test recording, 60 s at 100 Hz each, all three outputs, white noise."""
    streams = np.random.default_rng([seed, 1]).spawn(5)
    designs = {
        "train_1": random_levels(streams[0], 20.0, 60.0),
        "train_2": equal_steps([6.0, 12.0, 18.0, 24.0, 12.0, 0.0, -6.0, -12.0, -18.0, -6.0, 0.0], 5.0),
        "test_1": random_levels(streams[1], 20.0, 60.0),
    }
    return [
        simulate_recording(default_truth(), design, white(), stream, name=name)
        for (name, design), stream in zip(designs.items(), streams[2:], strict=True)
    ]
