"""Rigs that move: a pendulum, a cart, a shaft of two inertias, an oscillator, two carriages."""

from __future__ import annotations

from math import sin

from simulated_rigs.assembly import Balance, Coupling
from simulated_rigs.kinds.kind import ACTUATOR, FRICTION, Drive, Parameters, RigKind, at_zero
from simulated_rigs.plant import Plant, Values


def _pendulum(p: Parameters) -> Plant:
    inertia, damping, gravity = p["J"], p["D"], p["G"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [x[1], u[0] - damping * x[1] - gravity * sin(x[0])]

    return Plant((1.0, inertia), efforts, (0,))


PENDULUM = RigKind(
    "pendulum",
    {"J": 0.05, "D": 0.06, "G": 1.2},
    {"tau": Drive(0.0, 0.6, 1.6)},
    {"phi": Balance("rate"), "omega": Balance("motion", position="phi")},
    ("angle",),
    {"tau": "N.m", "angle": "rad"},
    0.01,
    6001,
    _pendulum,
    at_zero(2),
    (0.3, 1.5),
    (0.05, 0.0),
    {
        "in:tau": f"{ACTUATOR} offset",
        "omega": f"{FRICTION} quadratic_drag offset linear_stiffness cubic_stiffness end_stop",
        "out:angle": "gain offset lag delay",
    },
    linear=False,
)


def _cart(p: Parameters) -> Plant:
    mass, stiffness, damping = p["mass.m"], p["spring.k"], p["damper.d"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [x[1], u[0] - stiffness * x[0] - damping * x[1]]

    return Plant((1.0, mass), efforts, (0,))


CART = RigKind(
    "cart",
    {"mass.m": 1.5, "spring.k": 60.0, "damper.d": 2.0},
    {"F": Drive(0.0, 10.0, 1.0)},
    {"spring.s": Balance("rate"), "mass.v": Balance("motion", position="spring.s")},
    ("position",),
    {"F": "N", "position": "m"},
    0.01,
    6001,
    _cart,
    at_zero(2),
    (0.1, 0.35),
    (0.01, 0.0),
    {
        "in:F": f"{ACTUATOR} gain offset",
        "mass.v": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:position": "gain offset lag delay",
    },
    known=("mass.m",),
)


def _shaft(p: Parameters) -> Plant:
    j1, j2 = p["motor.J"], p["load.J"]
    k, c, d = p["shaft.c"], p["shaft.d"], p["bearing.d"]

    def efforts(x: Values, u: Values) -> list[float]:
        slip = x[0] - x[1]
        torque = k * x[2] + c * slip
        return [u[0] - torque, torque - d * x[1], slip]

    return Plant((j1, j2, 1.0), efforts, (0, 1))


SHAFT = RigKind(
    "shaft",
    {"motor.J": 0.02, "load.J": 0.05, "shaft.c": 4.0, "shaft.d": 0.02, "bearing.d": 0.04},
    {"tau": Drive(0.0, 1.5, 1.0)},
    {"motor.w": Balance("motion"), "load.w": Balance("motion"), "shaft.phi": Balance("rate")},
    ("w_motor", "w_load"),
    {"tau": "N.m", "w_motor": "rad/s", "w_load": "rad/s"},
    0.01,
    6001,
    _shaft,
    at_zero(3),
    (10.0, 10.0, 0.2),
    (0.2, 0.2, 0.0),
    {
        "in:tau": f"{ACTUATOR} offset",
        "motor.w": f"{FRICTION} viscous_friction quadratic_drag offset",
        "load.w": f"{FRICTION} quadratic_drag offset",
        "shaft.phi": "backlash",
        "out:w_motor": "gain offset lag delay",
        "out:w_load": "gain offset lag delay",
    },
    couplings={"shaft.phi": Coupling("motor.w", "load.w", "shaft.c", "shaft.d")},
)


def _oscillator(p: Parameters) -> Plant:
    m, d, k = p["m"], p["d"], p["k"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [x[1], u[0] - d * x[1] - k * x[0]]

    return Plant((1.0, m), efforts, (0,))


OSCILLATOR = RigKind(
    "oscillator",
    {"m": 1.0e-3, "d": 0.015, "k": 1.5},
    {"u": Drive(0.0, 0.6, 0.2)},
    {"x": Balance("rate"), "v": Balance("motion", position="x")},
    ("y",),
    {},
    2e-3,
    6001,
    _oscillator,
    at_zero(2),
    (0.2, 5.0),
    (0.01, 0.0),
    {
        "in:u": f"{ACTUATOR} offset",
        "v": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:y": "offset lag delay",
    },
)


def _carriages(p: Parameters) -> Plant:
    k1, k2, d1, d2 = p["k1"], p["k2"], p["d1"], p["d2"]

    def efforts(x: Values, u: Values) -> list[float]:
        pull = k2 * (x[2] - x[0]) + d2 * (x[3] - x[1])
        return [x[1], u[0] - k1 * x[0] - d1 * x[1] + pull, x[3], u[1] - pull]

    return Plant((1.0, p["m1"], 1.0, p["m2"]), efforts, (0, 2))


CARRIAGES = RigKind(
    "carriages",
    {"m1": 2.0, "m2": 1.0, "k1": 80.0, "k2": 50.0, "d1": 3.0, "d2": 0.8},
    {"f1": Drive(0.0, 15.0, 1.0), "f2": Drive(0.0, 6.0, 1.7)},
    {
        "s1": Balance("rate"),
        "v1": Balance("motion", position="s1"),
        "s2": Balance("rate"),
        "v2": Balance("motion", position="s2"),
    },
    ("x1", "x2"),
    {"f1": "N", "f2": "N", "x1": "m", "x2": "m"},
    0.01,
    6001,
    _carriages,
    at_zero(4),
    (0.14, 0.5, 0.18, 0.7),
    (0.01, 0.0, 0.01, 0.0),
    {
        "in:f1": f"{ACTUATOR} gain offset",
        "in:f2": f"{ACTUATOR} gain offset",
        "v1": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "v2": f"{FRICTION} viscous_friction quadratic_drag offset linear_stiffness cubic_stiffness",
        "out:x1": "gain offset lag delay",
        "out:x2": "gain offset lag delay",
    },
)
