"""Laws that the library does not have, for trials in which the right answer is no name at all."""

from __future__ import annotations

from functools import partial
from math import cos, pi, sin

import numpy as np

from aero_bayes.arrays import FloatArray
from simulated_rigs.assembly import Assembly
from simulated_rigs.laws import LawKind, Parameters
from simulated_rigs.laws.kind import Scale, listed
from simulated_rigs.laws.signal_laws import mapped
from simulated_rigs.plant import Values
from simulated_rigs.signals import faded_command, held_command


def _drifting_gain(a: Assembly, name: str, p: Parameters) -> None:
    a.actuators[name] = lambda time, u: held_command(
        time, u * (1.0 + p["a"] * np.sin(2.0 * pi * time / p["T"] + p["phase"]))
    )


def _fade(a: Assembly, name: str, p: Parameters) -> None:
    """Let an actuator lose force as it grows hot from what it did before."""
    a.actuators[name] = partial(faded_command, constant=p["T"], loss=p["loss"], size=p["u_n"])


def _resonance(a: Assembly, name: str, p: Parameters) -> None:
    """Add a weakly damped mode of the sensor's mount that its reading excites."""
    column, w, damping = a.outputs.index(name), p["w_0"], p["zeta"]
    shown = a.plant.shown[column]
    position, speed = a.add_state(shown), a.add_state()

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        e[position] += x[speed]
        e[speed] += w * w * (x[shown] - x[position]) - 2.0 * damping * w * x[speed]

    def reading(t: FloatArray, y: FloatArray, x: FloatArray) -> None:
        y[:, column] += p["g"] * (x[:, position] - x[:, shown])

    a.terms.append(add)
    a.readings.append(reading)


def _cogging(a: Assembly, name: str, p: Parameters) -> None:
    index = a.state(name)
    position = a.balances[name].position
    angle = a.state(position) if position else a.add_state()

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        e[index] += p["a"] * sin(2.0 * pi * x[angle] / p["pitch"])
        if position is None:
            e[angle] += x[index]

    a.terms.append(add)


def _vibration(a: Assembly, name: str, p: Parameters) -> None:
    index = a.state(name)

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        e[index] += p["a"] * cos(2.0 * pi * t / p["T"] + p["phase"])

    a.terms.append(add)


def _drift(a: Assembly, name: str, p: Parameters) -> None:
    column = a.outputs.index(name)
    a.readings.append(lambda t, y, x: np.add(y[:, column], p["a"] * ((t - t[0]) / p["T"]) ** 2, out=y[:, column]))


def _tone(rng: np.random.Generator, size: float, s: Scale) -> dict[str, float]:
    return {"a": size * s.effort, "T": s.time * rng.uniform(2.0, 8.0), "phase": rng.uniform(0.0, 2.0 * pi)}


_WAVE = mapped(lambda u, p: u + p["a"] * np.sin(2.0 * pi * u / p["p"]))
OUTSIDE: dict[tuple[str, str], LawKind] = {
    (family, law.id): law
    for family, law in (
        listed(
            "input",
            "drifting_gain",
            lambda g, z, s: {"a": z, "T": s.duration * g.uniform(0.3, 0.8), "phase": g.uniform(0.0, 2.0 * pi)},
            _drifting_gain,
            0.6,
        ),
        listed(
            "input",
            "fade",
            lambda g, z, s: {"loss": z, "T": s.duration * g.uniform(0.05, 0.2), "u_n": s.largest},
            _fade,
            0.9,
        ),
        listed("input", "wave", lambda g, z, s: {"a": z * s.spread, "p": s.spread * g.uniform(0.6, 1.2)}, _WAVE),
        listed(
            "output",
            "resonance",
            lambda g, z, s: {"g": z, "w_0": g.uniform(1.5, 4.0) / s.time, "zeta": g.uniform(0.02, 0.15)},
            _resonance,
        ),
        listed("output", "drift", lambda g, z, s: {"a": z * s.spread, "T": s.duration}, _drift),
        listed(
            "motion",
            "cogging",
            lambda g, z, s: {"a": z * s.effort, "pitch": (s.position or s.spread * s.time) * g.uniform(0.4, 0.9)},
            _cogging,
        ),
        *(listed(family, "vibration", _tone, _vibration) for family in ("motion", "storage", "electrical")),
    )
}
