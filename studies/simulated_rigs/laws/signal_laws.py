"""Laws of inputs, which turn a command into what is applied, and of outputs, which turn a value into a reading."""

from __future__ import annotations

from functools import partial

import numpy as np

from simulated_rigs.assembly import Assembly
from simulated_rigs.laws.kind import LawKind, Parameters, random_sign
from simulated_rigs.signals import (
    command_with_play,
    delayed_command,
    lagged_command,
    mapped_command,
    rate_limited_command,
)

# Inputs: the law turns a command into what is applied.


def _gain_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = mapped_command(lambda u: (1.0 + p["g"]) * u)


def _offset_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = mapped_command(lambda u: u + p["b"])


def _dead_zone(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = mapped_command(lambda u: np.sign(u) * np.maximum(np.abs(u) - p["w"], 0.0))


def _saturation(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = mapped_command(lambda u: np.clip(u, -p["u_max"], p["u_max"]))


def _hysteresis(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(command_with_play, half_width=p["w"], share=p["share"])


def _rate_limit(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(rate_limited_command, fastest=p["r_max"])


def _square_law(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    """Mix the command itself and its square, which are equal at ``u_n``."""
    a.actuators[name] = mapped_command(lambda u: u + p["a"] * (u * np.abs(u) / p["u_n"] - u))


def _lag_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(lagged_command, constant=p["T"])


def _delay_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(delayed_command, delay=p["T"])


# Outputs: the law turns what is there into what is shown.


def _gain_out(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    column = a.outputs.index(name)
    a.readings.append(lambda t, y, x: np.multiply(y[:, column], 1.0 + p["g"], out=y[:, column]))


def _offset_out(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    column = a.outputs.index(name)
    a.readings.append(lambda t, y, x: np.add(y[:, column], p["b"], out=y[:, column]))


def _lag_out(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.lags[name] = p["T"]


def _delay_out(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.delays[name] = p["T"]


#: Where each law acts (``input`` or ``output``), and the law.
SIGNAL_LAWS: tuple[tuple[str, LawKind], ...] = (
    ("input", LawKind("gain", "input", lambda g, z, s: {"g": z * random_sign(g)}, _gain_in, 0.6)),
    ("input", LawKind("offset", "input", lambda g, z, s: {"b": z * s.spread * random_sign(g)}, _offset_in, 2.0)),
    ("input", LawKind("dead_zone", "input", lambda g, z, s: {"w": z * s.largest}, _dead_zone, 0.7)),
    ("input", LawKind("saturation", "input", lambda g, z, s: {"u_max": (1.0 - z) * s.largest}, _saturation, 0.7)),
    (
        "input",
        LawKind("rate_limit", "input", lambda g, z, s: {"r_max": s.spread / (z * s.time)}, _rate_limit, 30.0),
    ),
    ("input", LawKind("square_law", "input", lambda g, z, s: {"a": z, "u_n": s.largest}, _square_law, 1.5)),
    ("input", LawKind("lag", "input", lambda g, z, s: {"T": z * s.time}, _lag_in, 20.0)),
    ("input", LawKind("delay", "input", lambda g, z, s: {"T": z * s.time}, _delay_in, 10.0)),
    (
        "input",
        LawKind(
            "hysteresis",
            "input",
            lambda g, z, s: {"share": z, "w": s.spread * float(g.uniform(0.2, 0.8))},
            _hysteresis,
            1.0,
        ),
    ),
    ("output", LawKind("gain", "output", lambda g, z, s: {"g": z * random_sign(g)}, _gain_out, 0.6)),
    ("output", LawKind("offset", "output", lambda g, z, s: {"b": z * s.spread * random_sign(g)}, _offset_out, 5.0)),
    ("output", LawKind("lag", "output", lambda g, z, s: {"T": z * s.time}, _lag_out, 3.0)),
    ("output", LawKind("delay", "output", lambda g, z, s: {"T": z * s.time}, _delay_out, 3.0)),
)
