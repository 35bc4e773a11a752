"""Rigs with a circuit: a motor with its load, and a coil with a capacitor."""

from __future__ import annotations

from simulated_rigs.assembly import Balance
from simulated_rigs.kinds.kind import ACTUATOR, FRICTION, Drive, Parameters, RigKind, at_zero
from simulated_rigs.plant import Plant, Values


def _motor(p: Parameters) -> Plant:
    r, k, d = p["R"], p["k_m"], p["d"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [u[0] - r * x[0] - k * x[1], k * x[0] - d * x[1]]

    return Plant((p["L"], p["J"]), efforts, (0, 1))


MOTOR = RigKind(
    "motor",
    {"R": 2.0, "L": 0.02, "k_m": 0.08, "J": 2.0e-4, "d": 2.0e-4},
    {"V": Drive(0.0, 12.0, 0.1)},
    {"i": Balance("electrical"), "w": Balance("motion")},
    ("current", "speed"),
    {"V": "V", "current": "A", "speed": "rad/s"},
    1e-3,
    6001,
    _motor,
    at_zero(2),
    (2.5, 50.0),
    (0.0, 2.0),
    {
        "in:V": f"{ACTUATOR} offset",
        "i": "contact_drop heating",
        "w": f"{FRICTION} quadratic_drag offset",
        "out:current": "offset lag delay",
        "out:speed": "offset lag delay",
    },
)


def _circuit(p: Parameters) -> Plant:
    conductance = 1.0 / p["load.R"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [u[0] - x[1], x[0] - conductance * x[1]]

    return Plant((p["coil.L"], p["capacitor.C"]), efforts, (1, 0))


CIRCUIT = RigKind(
    "circuit",
    {"coil.L": 0.1, "capacitor.C": 1.0e-3, "load.R": 20.0},
    {"u": Drive(0.0, 10.0, 0.15)},
    {"coil.i": Balance("electrical"), "capacitor.v": Balance("storage")},
    ("v_out", "i_in"),
    {"u": "V", "v_out": "V", "i_in": "A"},
    1e-3,
    6001,
    _circuit,
    at_zero(2),
    (0.4, 6.0),
    (0.0, 0.3),
    {
        "in:u": f"{ACTUATOR} gain offset",
        "coil.i": "series_resistance contact_drop heating",
        "capacitor.v": "square_loss offset",
        "out:v_out": "gain offset lag delay",
        "out:i_in": "offset lag delay",
    },
)
