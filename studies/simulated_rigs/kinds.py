"""The kinds of rigs of the many-rig trial, by name.

States, inputs and outputs are named as in the Modelica model that the program is given. Laws that equal a change of the
free parameters (a second damper beside a damper, a gain where every parameter is free) are left out.
"""

from __future__ import annotations

from math import sin, sqrt

from simulated_rigs.rig import Balance, Coupling, Drive, Parameters, Plant, RigKind, Values

#: Laws of dry friction, which any sliding or turning part may have.
FRICTION = "coulomb_friction friction_by_direction stribeck_friction presliding_friction"
#: What an actuator of flow, heat or voltage may have; a drive that reverses may have a dead zone too.
ONE_WAY = "saturation rate_limit square_law lag delay hysteresis"
ACTUATOR = f"dead_zone {ONE_WAY}"
#: Temperature of the surroundings in K.
AMBIENT = 293.15


def _pendulum(p: Parameters) -> Plant:
    inertia, damping, gravity = p["J"], p["D"], p["G"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [x[1], u[0] - damping * x[1] - gravity * sin(x[0])]

    return Plant((1.0, inertia), efforts, (0,))


PENDULUM = RigKind(
    "pendulum",
    {"J": 0.05, "D": 0.06, "G": 1.2},
    {"tau": Drive(0.0, 0.6, 1.6, "N.m")},
    {"phi": Balance("rate", 0.3, 0.05), "omega": Balance("motion", 1.5, position="phi")},
    {"angle": "rad"},
    0.01,
    6001,
    _pendulum,
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
    {"F": Drive(0.0, 10.0, 1.0, "N")},
    {"spring.s": Balance("rate", 0.1, 0.01), "mass.v": Balance("motion", 0.35, position="spring.s")},
    {"position": "m"},
    0.01,
    6001,
    _cart,
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
    {"tau": Drive(0.0, 1.5, 1.0, "N.m")},
    {
        "motor.w": Balance("motion", 10.0, 0.2),
        "load.w": Balance("motion", 10.0, 0.2),
        "shaft.phi": Balance("rate", 0.2),
    },
    {"w_motor": "rad/s", "w_load": "rad/s"},
    0.01,
    6001,
    _shaft,
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
    {"x": Balance("rate", 0.2, 0.01), "v": Balance("motion", 5.0, position="x")},
    {"y": ""},
    2e-3,
    6001,
    _oscillator,
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
    {"f1": Drive(0.0, 15.0, 1.0, "N"), "f2": Drive(0.0, 6.0, 1.7, "N")},
    {
        "s1": Balance("rate", 0.14, 0.01),
        "v1": Balance("motion", 0.5, position="s1"),
        "s2": Balance("rate", 0.18, 0.01),
        "v2": Balance("motion", 0.7, position="s2"),
    },
    {"x1": "m", "x2": "m"},
    0.01,
    6001,
    _carriages,
    {
        "in:f1": f"{ACTUATOR} gain offset",
        "in:f2": f"{ACTUATOR} gain offset",
        "v1": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "v2": f"{FRICTION} viscous_friction quadratic_drag offset linear_stiffness cubic_stiffness",
        "out:x1": "gain offset lag delay",
        "out:x2": "gain offset lag delay",
    },
)


def _motor(p: Parameters) -> Plant:
    r, k, d = p["R"], p["k_m"], p["d"]

    def efforts(x: Values, u: Values) -> list[float]:
        return [u[0] - r * x[0] - k * x[1], k * x[0] - d * x[1]]

    return Plant((p["L"], p["J"]), efforts, (0, 1))


MOTOR = RigKind(
    "motor",
    {"R": 2.0, "L": 0.02, "k_m": 0.08, "J": 2.0e-4, "d": 2.0e-4},
    {"V": Drive(0.0, 12.0, 0.1, "V")},
    {"i": Balance("electrical", 2.5), "w": Balance("motion", 50.0, 2.0)},
    {"current": "A", "speed": "rad/s"},
    1e-3,
    6001,
    _motor,
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
    {"u": Drive(0.0, 10.0, 0.15, "V")},
    {"coil.i": Balance("electrical", 0.4), "capacitor.v": Balance("storage", 6.0, 0.3)},
    {"v_out": "V", "i_in": "A"},
    1e-3,
    6001,
    _circuit,
    {
        "in:u": f"{ACTUATOR} gain offset",
        "coil.i": "series_resistance contact_drop heating",
        "capacitor.v": "square_loss offset",
        "out:v_out": "gain offset lag delay",
        "out:i_in": "offset lag delay",
    },
)


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
    {"h1": Balance("storage", 1.3, 0.3, neighbour="h2"), "h2": Balance("storage", 1.1, 0.3, neighbour="h1")},
    {"y": ""},
    4.0,
    1501,
    _tanks,
    {
        "in:u": f"{ONE_WAY} offset",
        "h1": "linear_loss square_loss overflow offset exchange",
        "h2": "linear_loss square_loss overflow offset",
        "out:y": "offset lag delay",
    },
    resting=_tanks_rest,
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
    {"P": Drive(60.0, 55.0, 400.0, "W")},
    {
        "heater.T": Balance("storage", 20.0, 3.0, reference=AMBIENT, neighbour="plate.T"),
        "plate.T": Balance("storage", 10.0, 3.0, reference=AMBIENT, neighbour="heater.T"),
    },
    {"T_heater": "K", "T_plate": "K"},
    5.0,
    2401,
    _heat,
    {
        "in:P": f"{ONE_WAY} offset",
        "heater.T": "linear_loss square_loss offset radiation",
        "plate.T": "square_loss offset radiation",
        "out:T_heater": "offset lag delay",
        "out:T_plate": "offset lag delay",
    },
    resting=lambda p: [AMBIENT + 60.0 / p["skin.G"] + 60.0 / p["wall.G"], AMBIENT + 60.0 / p["skin.G"]],
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
    {"q": Drive(1.5e-4, 1.2e-4, 150.0, "m3/s")},
    {
        "first.h": Balance("storage", 0.2, 0.03, neighbour="second.h"),
        "second.h": Balance("storage", 0.1, 0.03, neighbour="first.h"),
    },
    {"level_1": "m", "level_2": "m"},
    1.0,
    4001,
    _reservoirs,
    {
        "in:q": f"{ONE_WAY} offset",
        "first.h": "linear_loss root_loss square_loss overflow offset",
        "second.h": "root_loss square_loss overflow offset",
        "out:level_1": "gain offset lag delay",
        "out:level_2": "gain offset lag delay",
    },
    resting=lambda p: [1.5e-4 / p["outlet.c"] + 1.5e-4 / p["pipe.c"], 1.5e-4 / p["outlet.c"]],
)


def _aero(p: Parameters) -> Plant:
    """Write the driven motor; the second one is its mirror image, of opposite sign on the opposite arm.

    ``motors`` says how many there are; two where it is not given.
    """
    r, c, k_d, damping, stiffness = p["R_a"], p["c_m"], p["k_d"], p["D_p"], p["K_sp"]
    gain = p.get("motors", 2.0) * p["D_t"] * p["k_t"]

    def efforts(x: Values, u: Values) -> list[float]:
        i, w, theta, q = x[0], x[1], x[2], x[3]
        square = w * abs(w)
        return [u[0] - r * i - c * w, c * i - k_d * square, q, gain * square - damping * q - stiffness * theta]

    return Plant((p["L_a"], p["J_r"] + p["J_s"], 1.0, p["J_p"]), efforts, (0, 1, 2))


#: Parameters are named as in the paper and those of the AERO's documents. ``k_t`` is what the documented thrust gain of
#: 0.0011 N m/V asks of two propellers with a quadratic law at 24 V, ``k_d`` what 0.08 A at 376 rad/s asks of the motor.
AERO = RigKind(
    "aero",
    {
        "R_a": 8.4,
        "L_a": 1.16e-3,
        "c_m": 0.042,
        "J_r": 4.0e-6,
        "J_s": 4.0e-6,
        "k_d": 2.4e-8,
        "k_t": 2.9e-7,
        "J_p": 0.0219,
        "D_p": 0.0071,
        "K_sp": 0.0375,
        "D_t": 0.158,
    },
    {"V_m": Drive(0.0, 20.0, 1.0, "V")},
    {
        "i": Balance("electrical", 0.5),
        "w": Balance("motion", 200.0),
        "theta": Balance("rate", 0.2),
        "q": Balance("motion", 0.2, position="theta"),
    },
    {"i_m": "A", "omega_m": "rad/s", "pitch": "rad"},
    0.01,
    6001,
    _aero,
    {
        "in:V_m": f"{ACTUATOR} offset",
        "i": "contact_drop heating",
        "w": f"{FRICTION} viscous_friction offset",
        "q": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:i_m": "offset lag delay",
        "out:omega_m": "offset lag delay",
        "out:pitch": "offset lag delay",
    },
    known=("L_a", "J_s", "J_p", "D_t"),
    linear=False,
    method="LSODA",
    hold=50,
)

KINDS: dict[str, RigKind] = {
    kind.name: kind
    for kind in (PENDULUM, CART, SHAFT, MOTOR, CIRCUIT, TANKS, HEAT, RESERVOIRS, OSCILLATOR, CARRIAGES, AERO)
}
