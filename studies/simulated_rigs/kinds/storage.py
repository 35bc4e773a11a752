"""Rigs that store a liquid or heat: two tanks, a heated plate, two reservoirs."""

from __future__ import annotations

from math import sqrt

from simulated_rigs.assembly import Balance
from simulated_rigs.kinds.kind import ONE_WAY, Drive, Parameters, RigKind
from simulated_rigs.plant import Plant, Values

#: Temperature of the surroundings in K.
AMBIENT = 293.15


def _tanks(p: Parameters) -> Plant:
    k1, k2, k3, k4 = p["k1"], p["k2"], p["k3"], p["k4"]

    def efforts(x: Values, u: Values) -> list[float]:
        upper, lower = sqrt(max(x[0], 0.0)), sqrt(max(x[1], 0.0))
        return [k3 * u[0] - k1 * upper, k2 * upper - k4 * lower]

    return Plant((1.0, 1.0), efforts, (1,))


def _tanks_rest(p: Parameters) -> list[float]:
    upper = p["k3"] * 3.0 / p["k1"]
    return [upper**2, (p["k2"] * upper / p["k4"]) ** 2]


TANKS = RigKind(
    "tanks",
    {"k1": 0.05, "k2": 0.05, "k3": 0.03, "k4": 0.05},
    {"u": Drive(3.0, 1.8, 90.0)},
    {"h1": Balance("storage", neighbour="h2"), "h2": Balance("storage", neighbour="h1")},
    ("y",),
    {},
    4.0,
    1501,
    _tanks,
    _tanks_rest,
    (1.3, 1.1),
    (0.3, 0.3),
    {
        "in:u": f"{ONE_WAY} offset",
        "h1": "linear_loss square_loss overflow offset exchange",
        "h2": "linear_loss square_loss overflow offset",
        "out:y": "offset lag delay",
    },
    linear=False,
)


def _heat(p: Parameters) -> Plant:
    between, loss = p["wall.G"], p["skin.G"]

    def efforts(x: Values, u: Values) -> list[float]:
        flow = between * (x[0] - x[1])
        return [u[0] - flow, flow - loss * (x[1] - AMBIENT)]

    return Plant((p["heater.C"], p["plate.C"]), efforts, (0, 1))


HEAT = RigKind(
    "heat",
    {"heater.C": 300.0, "plate.C": 900.0, "wall.G": 1.5, "skin.G": 0.8},
    {"P": Drive(60.0, 55.0, 400.0)},
    {
        "heater.T": Balance("storage", reference=AMBIENT, neighbour="plate.T"),
        "plate.T": Balance("storage", reference=AMBIENT, neighbour="heater.T"),
    },
    ("T_heater", "T_plate"),
    {"P": "W", "T_heater": "K", "T_plate": "K"},
    5.0,
    2401,
    _heat,
    lambda p: [AMBIENT + 60.0 / p["skin.G"] + 60.0 / p["wall.G"], AMBIENT + 60.0 / p["skin.G"]],
    (20.0, 10.0),
    (3.0, 3.0),
    {
        "in:P": f"{ONE_WAY} offset",
        "heater.T": "linear_loss square_loss offset radiation",
        "plate.T": "square_loss offset radiation",
        "out:T_heater": "offset lag delay",
        "out:T_plate": "offset lag delay",
    },
)


def _reservoirs(p: Parameters) -> Plant:
    pipe, outlet = p["pipe.c"], p["outlet.c"]

    def efforts(x: Values, u: Values) -> list[float]:
        flow = pipe * (x[0] - x[1])
        return [u[0] - flow, flow - outlet * x[1]]

    return Plant((p["first.A"], p["second.A"]), efforts, (0, 1))


RESERVOIRS = RigKind(
    "reservoirs",
    {"first.A": 0.02, "second.A": 0.04, "pipe.c": 4.0e-4, "outlet.c": 3.0e-4},
    {"q": Drive(1.5e-4, 1.2e-4, 150.0)},
    {"first.h": Balance("storage", neighbour="second.h"), "second.h": Balance("storage", neighbour="first.h")},
    ("level_1", "level_2"),
    {"q": "m3/s", "level_1": "m", "level_2": "m"},
    1.0,
    4001,
    _reservoirs,
    lambda p: [1.5e-4 / p["outlet.c"] + 1.5e-4 / p["pipe.c"], 1.5e-4 / p["outlet.c"]],
    (0.2, 0.1),
    (0.03, 0.03),
    {
        "in:q": f"{ONE_WAY} offset",
        "first.h": "linear_loss root_loss square_loss overflow offset",
        "second.h": "root_loss square_loss overflow offset",
        "out:level_1": "gain offset lag delay",
        "out:level_2": "gain offset lag delay",
    },
)
