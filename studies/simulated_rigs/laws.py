"""The library's laws as simulated rigs have them: textbook formulas, exact and, where the physics is, not smooth.

A law of size zero is absent. Sizes are relative to what happens at the place without the law (:class:`Scale`), so that
one table serves every rig. :data:`OUTSIDE` are laws that the library does not have, for trials in which the right
answer is no name at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from simulated_rigs.rig import ARRAYS, Assembly, DryFriction, Overflow, Parameters, function, with_values
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


#: (assembly, name of the place, parameters) puts the law there.
Install = Callable[[Assembly, str, Parameters], None]


@dataclass(frozen=True)
class LawKind:
    """How a law's parameters are drawn, how it is put into a rig, and the largest size that makes sense.

    Parameters are expressions of ``size`` and of the place's :class:`Scale`, of ``uniform(a, b)``, ``random()`` and
    ``sign()``, which is 1 or -1. What begins with an underscore is drawn for those after it.
    """

    parameters: Mapping[str, str]
    install: Install
    most: float = 100.0

    def draw(self, rng: Generator, size: float, scale: Scale) -> dict[str, float]:
        """Draw the parameters; whatever is random in them is independent of the size."""
        names: dict[str, Any] = {**vars(scale), "size": size, "sqrt": sqrt, "pi": pi}
        names |= {"uniform": rng.uniform, "random": rng.random, "sign": lambda: 1.0 if rng.random() < 0.5 else -1.0}
        for name, expression in self.parameters.items():
            names[name] = float(eval(expression, names))
        return {name: names[name] for name in self.parameters if not name.startswith("_")}


def _mapped(law: str) -> Install:
    """Make a law that maps each value ``u`` of a command, at its time ``t``."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        applied = function("t, u", with_values(law, {}, p), ARRAYS)
        a.actuators[name] = lambda time, values: held_command(time, applied(time, values))

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


def _read(law: str) -> Install:
    """Make a law that turns times ``t`` and true values ``y`` into readings."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        column, shown = a.column(name), function("t, y", with_values(law, {}, p), ARRAYS)
        a.readings.append(lambda t, y, x: np.copyto(y[:, column], shown(t, y[:, column])))

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


def _friction(level: str) -> Install:
    """Make dry friction of a level over direction ``d`` and speed ``v``."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        found = function("d, v", with_values(level, {}, p))
        if any(found(side, 0.0) for side in (-1, 1)):
            a.holds.append(DryFriction(a.state(name), found))

    return install


def _overflow(a: Assembly, name: str, p: Parameters) -> None:
    neighbour = a.kind.states[name].neighbour
    a.holds.append(Overflow(a.state(name), p["rim"], None if neighbour is None else a.state(neighbour), p["share"]))


def _cogging(a: Assembly, name: str, p: Parameters) -> None:
    turned = {} if a.kind.states[name].position else {"position": "x"}
    _efforts(x="a*sin(2.0*pi*position/pitch)", **turned)(a, name, p)


#: What play takes away from an elastic coupling: no torque within it, the coupling's own beyond.
_PLAY = "(stiffness*x + damping*(first - second) if abs(x) <= gap/2.0 else stiffness*copysign(gap/2.0, x))"


_OFFSET = LawKind({"b": "size*effort*sign()"}, _efforts(x="b"))
_PHASE = "uniform(0.0, 2.0*pi)"
#: Where each law acts (``input``, ``output``, ``coupling`` or the family of a balance), its id, and the law.
LAWS: dict[tuple[str, str], LawKind] = {
    ("input", "gain"): LawKind({"g": "size*sign()"}, _mapped("(1.0 + g)*u"), 0.6),
    ("input", "offset"): LawKind({"b": "size*spread*sign()"}, _mapped("u + b"), 2.0),
    ("input", "dead_zone"): LawKind({"w": "size*largest"}, _mapped("sign(u)*maximum(abs(u) - w, 0.0)"), 0.7),
    ("input", "saturation"): LawKind({"u_max": "(1.0 - size)*largest"}, _mapped("clip(u, -u_max, u_max)"), 0.7),
    ("input", "rate_limit"): LawKind(
        {"r_max": "spread/(size*time)"}, _followed("command", _actuator(limited_rate, fastest="r_max")), 30.0
    ),
    # The command itself and its square, which are equal at u_n, mixed.
    ("input", "square_law"): LawKind({"a": "size", "u_n": "largest"}, _mapped("u + a*(u*abs(u)/u_n - u)"), 1.5),
    ("input", "lag"): LawKind({"T": "size*time"}, _followed("(command - x)/T"), 20.0),
    ("input", "delay"): LawKind({"T": "size*time"}, _actuator(delayed_command, delay="T"), 10.0),
    ("input", "hysteresis"): LawKind(
        {"share": "size", "w": "spread*uniform(0.2, 0.8)"},
        _actuator(command_with_play, half_width="w", share="share"),
        1.0,
    ),
    ("output", "gain"): LawKind({"g": "size*sign()"}, _read("y*(1.0 + g)"), 0.6),
    ("output", "offset"): LawKind({"b": "size*spread*sign()"}, _read("y + b"), 5.0),
    ("output", "lag"): LawKind({"T": "size*time"}, _lag_out, 3.0),
    ("output", "delay"): LawKind({"T": "size*time"}, _delay_out, 3.0),
    ("motion", "coulomb_friction"): LawKind({"F_c": "size*effort"}, _friction("F_c")),
    ("motion", "friction_by_direction"): LawKind(
        {"_apart": "uniform(1.25, 2.0)**sign()", "F_plus": "size*effort*_apart", "F_minus": "size*effort/_apart"},
        _friction("F_plus if d > 0 else F_minus"),
    ),
    ("motion", "stribeck_friction"): LawKind(
        {"F_c": "size*effort", "F_s": "F_c*uniform(1.4, 2.2)", "v_s": "spread*uniform(0.1, 0.4)"},
        _friction("F_c + (F_s - F_c)*exp(-((v/v_s)**2))"),
    ),
    # Dahl's model: a spring that yields at F_c.
    ("motion", "presliding_friction"): LawKind(
        {"F_c": "size*effort", "x_s": "spread*time*uniform(0.1, 0.5)"},
        _efforts(x="-force", force="(F_c*x - abs(x)*force)/x_s"),
    ),
    ("motion", "viscous_friction"): LawKind({"d": "size*effort/spread"}, _efforts(x="-d*x")),
    ("motion", "quadratic_drag"): LawKind({"c": "size*effort/spread**2"}, _efforts(x="-c*x*abs(x)")),
    ("motion", "offset"): _OFFSET,
    ("motion", "linear_stiffness"): LawKind({"k": "size*effort/position"}, _efforts(x="-k*position")),
    ("motion", "cubic_stiffness"): LawKind({"k_3": "size*effort/position**3"}, _efforts(x="-k_3*position**3")),
    ("motion", "end_stop"): LawKind(
        {"x_s": "(1.0 - size)*farthest", "k_s": "uniform(10.0, 30.0)*effort/position"},
        _efforts(x="-k_s*(position - min(max(position, -x_s), x_s))"),
        0.7,
    ),
    ("coupling", "backlash"): LawKind({"gap": "size*spread"}, _efforts(first=_PLAY, second=f"-{_PLAY}"), 3.0),
    ("storage", "linear_loss"): LawKind({"k": "size*effort/spread"}, _efforts(x="-k*(x - reference)")),
    ("storage", "root_loss"): LawKind(
        {"k": "size*effort/sqrt(spread)"}, _efforts(x="-k*copysign(sqrt(abs(x - reference)), x - reference)")
    ),
    ("storage", "square_loss"): LawKind(
        {"k": "size*effort/spread**2"}, _efforts(x="-k*(x - reference)*abs(x - reference)")
    ),
    ("storage", "overflow"): LawKind(
        {"rim": "highest - size*(highest - lowest)", "share": "uniform(0.2, 0.9) if random() < 0.5 else 0.0"},
        _overflow,
        0.6,
    ),
    ("storage", "offset"): _OFFSET,
    ("storage", "exchange"): LawKind(
        {"k": "size*effort/difference"}, _efforts(x="k*(neighbour - x)", neighbour="-k*(neighbour - x)")
    ),
    ("storage", "radiation"): LawKind(
        {"k": "size*effort/(4.0*mean**3*spread)"}, _efforts(x="-k*(x**4 - reference**4)")
    ),
    ("electrical", "series_resistance"): LawKind({"R": "size*effort/spread"}, _efforts(x="-R*x")),
    ("electrical", "contact_drop"): LawKind({"V_c": "size*effort"}, _friction("V_c")),
    # A resistance grows with the heat that its current has left.
    ("electrical", "heating"): LawKind(
        {"r_h": "size*effort/spread/(spread**2 + mean**2)", "T_h": "duration*uniform(0.05, 0.3)"},
        _efforts(x="-warmer*x", warmer="(r_h*x*x - warmer)/T_h"),
    ),
}
_VIBRATION = LawKind(
    {"a": "size*effort", "T": "time*uniform(2.0, 8.0)", "phase": _PHASE}, _efforts(x="a*cos(2.0*pi*t/T + phase)")
)
OUTSIDE: dict[tuple[str, str], LawKind] = {
    ("input", "drifting_gain"): LawKind(
        {"a": "size", "T": "duration*uniform(0.3, 0.8)", "phase": _PHASE},
        _mapped("u*(1.0 + a*sin(2.0*pi*t/T + phase))"),
        0.6,
    ),
    # An actuator loses force as it grows hot from what it did before.
    ("input", "fade"): LawKind(
        {"loss": "size", "T": "duration*uniform(0.05, 0.2)", "u_n": "largest"},
        _actuator(faded_command, constant="T", loss="loss", size="u_n"),
        0.9,
    ),
    ("input", "wave"): LawKind({"a": "size*spread", "p": "spread*uniform(0.6, 1.2)"}, _mapped("u + a*sin(2.0*pi*u/p)")),
    ("output", "resonance"): LawKind(
        {"g": "size", "w_0": "uniform(1.5, 4.0)/time", "zeta": "uniform(0.02, 0.15)"}, _resonance
    ),
    ("output", "drift"): LawKind({"a": "size*spread", "T": "duration"}, _read("y + a*((t - t[0])/T)**2")),
    ("motion", "cogging"): LawKind(
        {"a": "size*effort", "pitch": "(position or spread*time)*uniform(0.4, 0.9)"}, _cogging
    ),
    ("motion", "vibration"): _VIBRATION,
    ("storage", "vibration"): _VIBRATION,
    ("electrical", "vibration"): _VIBRATION,
}
