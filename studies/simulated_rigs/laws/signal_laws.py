"""Laws of inputs, which turn a command into what is applied, and of outputs, which turn a value into a reading."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from simulated_rigs.assembly import Assembly
from simulated_rigs.laws.kind import Install, Parameters, listed, random_sign
from simulated_rigs.plant import Values
from simulated_rigs.signals import (
    FloatArray,
    command_with_play,
    delayed_command,
    held_command,
    lagged_command,
    rate_limited_command,
)


def mapped(law: Callable[[FloatArray, Parameters], FloatArray]) -> Install:
    """Make a law that maps each value of a command by itself."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        a.actuators[name] = lambda time, values: held_command(time, law(values, p))

    return install


def _hysteresis(a: Assembly, name: str, p: Parameters) -> None:
    a.actuators[name] = partial(command_with_play, half_width=p["w"], share=p["share"])


def _rate_limit(a: Assembly, name: str, p: Parameters) -> None:
    a.actuators[name] = partial(rate_limited_command, fastest=p["r_max"])


def _lag_in(a: Assembly, name: str, p: Parameters) -> None:
    a.actuators[name] = partial(lagged_command, constant=p["T"])


def _delay_in(a: Assembly, name: str, p: Parameters) -> None:
    a.actuators[name] = partial(delayed_command, delay=p["T"])


def _gain_out(a: Assembly, name: str, p: Parameters) -> None:
    column = a.outputs.index(name)
    a.readings.append(lambda t, y, x: np.multiply(y[:, column], 1.0 + p["g"], out=y[:, column]))


def _offset_out(a: Assembly, name: str, p: Parameters) -> None:
    column = a.outputs.index(name)
    a.readings.append(lambda t, y, x: np.add(y[:, column], p["b"], out=y[:, column]))


def _lag_out(a: Assembly, name: str, p: Parameters) -> None:
    """Show a state that follows the true one, settled at its first value."""
    column, constant = a.outputs.index(name), p["T"]
    true = a.plant.shown[column]
    behind = a.add_state(true)

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        e[behind] += (x[true] - x[behind]) / constant

    if constant > 0.0:
        a.terms.append(add)
        a.readings.append(lambda t, y, x: np.copyto(y[:, column], x[:, behind]))
        a.method = "LSODA"  # a short lag is stiff


def _delay_out(a: Assembly, name: str, p: Parameters) -> None:
    a.delays[name] = p["T"]


_DEAD_ZONE = mapped(lambda u, p: np.sign(u) * np.maximum(np.abs(u) - p["w"], 0.0))
# The command itself and its square, which are equal at u_n, mixed.
_SQUARE_LAW = mapped(lambda u, p: u + p["a"] * (u * np.abs(u) / p["u_n"] - u))
#: Where each law acts (``input`` or ``output``), and the law.
SIGNAL_LAWS = (
    listed("input", "gain", lambda g, z, s: {"g": z * random_sign(g)}, mapped(lambda u, p: (1.0 + p["g"]) * u), 0.6),
    listed(
        "input", "offset", lambda g, z, s: {"b": z * s.spread * random_sign(g)}, mapped(lambda u, p: u + p["b"]), 2.0
    ),
    listed("input", "dead_zone", lambda g, z, s: {"w": z * s.largest}, _DEAD_ZONE, 0.7),
    listed(
        "input",
        "saturation",
        lambda g, z, s: {"u_max": (1.0 - z) * s.largest},
        mapped(lambda u, p: np.clip(u, -p["u_max"], p["u_max"])),
        0.7,
    ),
    listed("input", "rate_limit", lambda g, z, s: {"r_max": s.spread / (z * s.time)}, _rate_limit, 30.0),
    listed("input", "square_law", lambda g, z, s: {"a": z, "u_n": s.largest}, _SQUARE_LAW, 1.5),
    listed("input", "lag", lambda g, z, s: {"T": z * s.time}, _lag_in, 20.0),
    listed("input", "delay", lambda g, z, s: {"T": z * s.time}, _delay_in, 10.0),
    listed(
        "input",
        "hysteresis",
        lambda g, z, s: {"share": z, "w": s.spread * float(g.uniform(0.2, 0.8))},
        _hysteresis,
        1.0,
    ),
    listed("output", "gain", lambda g, z, s: {"g": z * random_sign(g)}, _gain_out, 0.6),
    listed("output", "offset", lambda g, z, s: {"b": z * s.spread * random_sign(g)}, _offset_out, 5.0),
    listed("output", "lag", lambda g, z, s: {"T": z * s.time}, _lag_out, 3.0),
    listed("output", "delay", lambda g, z, s: {"T": z * s.time}, _delay_out, 3.0),
)
