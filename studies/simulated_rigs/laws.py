"""The library's laws as simulated rigs have them: textbook formulas, exact and, where the physics is, not smooth.

A law of size zero is absent. Sizes are relative to what happens at the place without the law (:class:`Scale`), so that
one table serves every rig. :data:`OUTSIDE` are laws that the library does not have, for trials in which the right
answer is no name at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import exp, pi, sqrt

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from simulated_rigs.rig import Assembly, DryFriction, Overflow, Parameters
from simulated_rigs.signals import (
    Signal,
    command_with_play,
    delayed_command,
    faded_command,
    held_command,
    limited_rate,
)


@dataclass(frozen=True)
class Scale:
    """What happens at a place without the law.

    ``spread`` to ``mean`` are of the signal there, ``effort`` is the standard deviation of what changes the state,
    ``time`` how long (s) the signal takes to change by its spread, ``duration`` the recording's length in s;
    ``position`` and ``farthest`` are standard deviation and largest size of the state whose derivative this is, and
    ``difference`` is the standard deviation of the difference to the neighbour (0 where there is none).
    """

    spread: float
    largest: float
    lowest: float
    highest: float
    mean: float
    effort: float
    time: float
    duration: float
    position: float = 0.0
    farthest: float = 0.0
    difference: float = 0.0


#: (generator, size, scale) -> parameters; whatever else it draws is independent of the size.
Draw = Callable[[Generator, float, Scale], dict[str, float]]
#: (assembly, name of the place, parameters) puts the law there.
Install = Callable[[Assembly, str, Parameters], None]


@dataclass(frozen=True)
class LawKind:
    """How a law's parameters are drawn, how it is put into a rig, and the largest size that makes sense."""

    draw: Draw
    install: Install
    most: float = 100.0


def _sign(rng: Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _mapped(law: Callable[[FloatArray, Parameters], FloatArray]) -> Install:
    """Make a law that maps each value of a command by itself."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        a.actuators[name] = lambda time, values: held_command(time, law(values, p))

    return install


def _actuator(make: Callable[..., Signal], **names: str) -> Install:
    """Make a law of what ``make`` does to a command; ``names`` are the law's parameters that it takes."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        a.actuators[name] = partial(make, **{taken: p[own] for taken, own in names.items()})

    return install


def _followed(rate: str, command: Install | None = None) -> Install:
    """Make a law whose input is a state that starts at the first command and changes at a rate of it."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        state, column = a.add_state(name), list(a.kind.inputs).index(name)
        a.add({"x": state}, p, x=rate.replace("command", f"u[{column}]"))
        a.acting[name] = f"x[{state}]"
        if command is not None:
            command(a, name, p)

    return install


def _drifting_gain(a: Assembly, name: str, p: Parameters) -> None:
    a.actuators[name] = lambda time, u: held_command(
        time, u * (1.0 + p["a"] * np.sin(2.0 * pi * time / p["T"] + p["phase"]))
    )


def _read(law: Callable[[FloatArray, FloatArray, Parameters], FloatArray]) -> Install:
    """Make a law that turns times and true values into readings."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        column = a.column(name)
        a.readings.append(lambda t, y, x: np.copyto(y[:, column], law(t, y[:, column], p)))

    return install


def _lag_out(a: Assembly, name: str, p: Parameters) -> None:
    """Show a state that follows the true one, settled at its first value."""
    column, true = a.column(name), a.plant.shown[a.column(name)]
    behind = a.add_state(true)
    if p["T"] > 0.0:
        a.add({"x": true, "behind": behind}, p, behind="(x - behind)/T")
        a.readings.append(lambda t, y, x: np.copyto(y[:, column], x[:, behind]))
        a.method = "LSODA"  # a short lag is stiff


def _delay_out(a: Assembly, name: str, p: Parameters) -> None:
    a.delays[name] = p["T"]


def _resonance(a: Assembly, name: str, p: Parameters) -> None:
    """Add a weakly damped mode of the sensor's mount that its reading excites."""
    column, shown = a.column(name), a.plant.shown[a.column(name)]
    places = {"x": shown, "place": a.add_state(shown), "speed": a.add_state()}
    a.add(places, p, place="speed", speed="w_0*w_0*(x - place) - 2.0*zeta*w_0*speed")

    def reading(t: FloatArray, y: FloatArray, x: FloatArray) -> None:
        y[:, column] += p["g"] * (x[:, places["place"]] - x[:, shown])

    a.readings.append(reading)


def _efforts(**expressions: str) -> Install:
    """Make a law of what it adds to the efforts of states.

    ``x`` is the state at its place; ``position``, ``neighbour``, ``first`` and ``second`` are what that state has, and
    other names are new states, which start at zero."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        balance, coupling = a.kind.states[name], a.kind.couplings.get(name)
        beside = {"x": name, "position": balance.position, "neighbour": balance.neighbour}
        values = {**p, "reference": balance.reference}
        if coupling is not None:
            beside |= {"first": coupling.first, "second": coupling.second}
            values |= {n: a.parameters[getattr(coupling, n)] for n in ("stiffness", "damping")}
        places = {own: a.state(state) for own, state in beside.items() if state}
        a.add(places | {own: a.add_state() for own in expressions if own not in places}, values, **expressions)

    return install


def _friction(level: Callable[[int, float, Parameters], float]) -> Install:
    """Make dry friction of a level over direction and speed."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        if any(level(side, 0.0, p) for side in (-1, 1)):
            a.holds.append(DryFriction(a.state(name), lambda direction, speed: level(direction, speed, p)))

    return install


def _overflow(a: Assembly, name: str, p: Parameters) -> None:
    neighbour = a.kind.states[name].neighbour
    a.holds.append(Overflow(a.state(name), p["rim"], None if neighbour is None else a.state(neighbour), p["share"]))


def _cogging(a: Assembly, name: str, p: Parameters) -> None:
    turned = {} if a.kind.states[name].position else {"position": "x"}
    _efforts(x="a*sin(2.0*pi*position/pitch)", **turned)(a, name, p)


#: What play takes away from an elastic coupling: no torque within it, the coupling's own beyond.
_PLAY = "(stiffness*x + damping*(first - second) if abs(x) <= gap/2.0 else stiffness*copysign(gap/2.0, x))"


def _directions(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    apart = float(rng.uniform(1.25, 2.0)) ** _sign(rng)
    return {"F_plus": size * s.effort * apart, "F_minus": size * s.effort / apart}


def _stribeck(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    level = size * s.effort
    return {"F_c": level, "F_s": level * float(rng.uniform(1.4, 2.2)), "v_s": s.spread * float(rng.uniform(0.1, 0.4))}


def _rim(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    share = float(rng.uniform(0.2, 0.9)) if rng.random() < 0.5 else 0.0
    return {"rim": s.highest - size * (s.highest - s.lowest), "share": share}


def _stop(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"x_s": (1.0 - size) * s.farthest, "k_s": float(rng.uniform(10.0, 30.0)) * s.effort / s.position}


def _rise(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    strength = size * s.effort / s.spread / (s.spread**2 + s.mean**2)
    return {"r_h": strength, "T_h": s.duration * float(rng.uniform(0.05, 0.3))}


def _dahl(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"F_c": size * s.effort, "x_s": s.spread * s.time * float(rng.uniform(0.1, 0.5))}


def _fading(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"loss": size, "T": s.duration * rng.uniform(0.05, 0.2), "u_n": s.largest}


def _slow_gain(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"a": size, "T": s.duration * rng.uniform(0.3, 0.8), "phase": rng.uniform(0.0, 2.0 * pi)}


def _mount(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"g": size, "w_0": rng.uniform(1.5, 4.0) / s.time, "zeta": rng.uniform(0.02, 0.15)}


def _teeth(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"a": size * s.effort, "pitch": (s.position or s.spread * s.time) * rng.uniform(0.4, 0.9)}


def _tone(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"a": size * s.effort, "T": s.time * rng.uniform(2.0, 8.0), "phase": rng.uniform(0.0, 2.0 * pi)}


_OFFSET = LawKind(lambda g, z, s: {"b": z * s.effort * _sign(g)}, _efforts(x="b"))
#: Where each law acts (``input``, ``output``, ``coupling`` or the family of a balance), its id, and the law.
LAWS: dict[tuple[str, str], LawKind] = {
    ("input", "gain"): LawKind(lambda g, z, s: {"g": z * _sign(g)}, _mapped(lambda u, p: (1.0 + p["g"]) * u), 0.6),
    ("input", "offset"): LawKind(lambda g, z, s: {"b": z * s.spread * _sign(g)}, _mapped(lambda u, p: u + p["b"]), 2.0),
    ("input", "dead_zone"): LawKind(
        lambda g, z, s: {"w": z * s.largest},
        _mapped(lambda u, p: np.sign(u) * np.maximum(np.abs(u) - p["w"], 0.0)),
        0.7,
    ),
    ("input", "saturation"): LawKind(
        lambda g, z, s: {"u_max": (1.0 - z) * s.largest},
        _mapped(lambda u, p: np.clip(u, -p["u_max"], p["u_max"])),
        0.7,
    ),
    ("input", "rate_limit"): LawKind(
        lambda g, z, s: {"r_max": s.spread / (z * s.time)},
        _followed("command", _actuator(limited_rate, fastest="r_max")),
        30.0,
    ),
    # The command itself and its square, which are equal at u_n, mixed.
    ("input", "square_law"): LawKind(
        lambda g, z, s: {"a": z, "u_n": s.largest},
        _mapped(lambda u, p: u + p["a"] * (u * np.abs(u) / p["u_n"] - u)),
        1.5,
    ),
    ("input", "lag"): LawKind(lambda g, z, s: {"T": z * s.time}, _followed("(command - x)/T"), 20.0),
    ("input", "delay"): LawKind(lambda g, z, s: {"T": z * s.time}, _actuator(delayed_command, delay="T"), 10.0),
    ("input", "hysteresis"): LawKind(
        lambda g, z, s: {"share": z, "w": s.spread * float(g.uniform(0.2, 0.8))},
        _actuator(command_with_play, half_width="w", share="share"),
        1.0,
    ),
    ("output", "gain"): LawKind(lambda g, z, s: {"g": z * _sign(g)}, _read(lambda t, y, p: y * (1.0 + p["g"])), 0.6),
    ("output", "offset"): LawKind(
        lambda g, z, s: {"b": z * s.spread * _sign(g)}, _read(lambda t, y, p: y + p["b"]), 5.0
    ),
    ("output", "lag"): LawKind(lambda g, z, s: {"T": z * s.time}, _lag_out, 3.0),
    ("output", "delay"): LawKind(lambda g, z, s: {"T": z * s.time}, _delay_out, 3.0),
    ("motion", "coulomb_friction"): LawKind(lambda g, z, s: {"F_c": z * s.effort}, _friction(lambda d, v, p: p["F_c"])),
    ("motion", "friction_by_direction"): LawKind(
        _directions, _friction(lambda d, v, p: p["F_plus"] if d > 0 else p["F_minus"])
    ),
    ("motion", "stribeck_friction"): LawKind(
        _stribeck, _friction(lambda d, v, p: p["F_c"] + (p["F_s"] - p["F_c"]) * exp(-((v / p["v_s"]) ** 2)))
    ),
    ("motion", "presliding_friction"): LawKind(
        _dahl,
        # Dahl's model: a spring that yields at F_c.
        _efforts(x="-force", force="(F_c*x - abs(x)*force)/x_s"),
    ),
    ("motion", "viscous_friction"): LawKind(lambda g, z, s: {"d": z * s.effort / s.spread}, _efforts(x="-d*x")),
    ("motion", "quadratic_drag"): LawKind(lambda g, z, s: {"c": z * s.effort / s.spread**2}, _efforts(x="-c*x*abs(x)")),
    ("motion", "offset"): _OFFSET,
    ("motion", "linear_stiffness"): LawKind(
        lambda g, z, s: {"k": z * s.effort / s.position}, _efforts(x="-k*position")
    ),
    ("motion", "cubic_stiffness"): LawKind(
        lambda g, z, s: {"k_3": z * s.effort / s.position**3}, _efforts(x="-k_3*position**3")
    ),
    ("motion", "end_stop"): LawKind(_stop, _efforts(x="-k_s*(position - min(max(position, -x_s), x_s))"), 0.7),
    ("coupling", "backlash"): LawKind(
        lambda g, z, s: {"gap": z * s.spread}, _efforts(first=_PLAY, second=f"-{_PLAY}"), 3.0
    ),
    ("storage", "linear_loss"): LawKind(
        lambda g, z, s: {"k": z * s.effort / s.spread}, _efforts(x="-k*(x - reference)")
    ),
    ("storage", "root_loss"): LawKind(
        lambda g, z, s: {"k": z * s.effort / sqrt(s.spread)},
        _efforts(x="-k*copysign(sqrt(abs(x - reference)), x - reference)"),
    ),
    ("storage", "square_loss"): LawKind(
        lambda g, z, s: {"k": z * s.effort / s.spread**2}, _efforts(x="-k*(x - reference)*abs(x - reference)")
    ),
    ("storage", "overflow"): LawKind(_rim, _overflow, 0.6),
    ("storage", "offset"): _OFFSET,
    ("storage", "exchange"): LawKind(
        lambda g, z, s: {"k": z * s.effort / s.difference},
        _efforts(x="k*(neighbour - x)", neighbour="-k*(neighbour - x)"),
    ),
    ("storage", "radiation"): LawKind(
        lambda g, z, s: {"k": z * s.effort / (4.0 * s.mean**3 * s.spread)}, _efforts(x="-k*(x**4 - reference**4)")
    ),
    ("electrical", "series_resistance"): LawKind(lambda g, z, s: {"R": z * s.effort / s.spread}, _efforts(x="-R*x")),
    ("electrical", "contact_drop"): LawKind(lambda g, z, s: {"V_c": z * s.effort}, _friction(lambda d, i, p: p["V_c"])),
    ("electrical", "heating"): LawKind(
        _rise,
        # A resistance grows with the heat that its current has left.
        _efforts(x="-warmer*x", warmer="(r_h*x*x - warmer)/T_h"),
    ),
}
_VIBRATION = LawKind(_tone, _efforts(x="a*cos(2.0*pi*t/T + phase)"))
OUTSIDE: dict[tuple[str, str], LawKind] = {
    ("input", "drifting_gain"): LawKind(_slow_gain, _drifting_gain, 0.6),
    # An actuator loses force as it grows hot from what it did before.
    ("input", "fade"): LawKind(_fading, _actuator(faded_command, constant="T", loss="loss", size="u_n"), 0.9),
    ("input", "wave"): LawKind(
        lambda g, z, s: {"a": z * s.spread, "p": s.spread * g.uniform(0.6, 1.2)},
        _mapped(lambda u, p: u + p["a"] * np.sin(2.0 * pi * u / p["p"])),
    ),
    ("output", "resonance"): LawKind(_mount, _resonance),
    ("output", "drift"): LawKind(
        lambda g, z, s: {"a": z * s.spread, "T": s.duration},
        _read(lambda t, y, p: y + p["a"] * ((t - t[0]) / p["T"]) ** 2),
    ),
    ("motion", "cogging"): LawKind(_teeth, _cogging),
    ("motion", "vibration"): _VIBRATION,
    ("storage", "vibration"): _VIBRATION,
    ("electrical", "vibration"): _VIBRATION,
}
