"""The kinds of rigs: hand-written equations, what is measured, how they are driven, and which laws may be missing.

States, inputs and outputs are named as in the Modelica model that the program is given. Laws that equal a change of the
free parameters (a second damper beside a damper, a gain where every parameter is free) are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import sin, sqrt

from simulated_rigs.assembly import Assembly, Balance, Coupling
from simulated_rigs.plant import Plant, Values

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Drive:
    """How an input is driven: around ``centre``, by up to ``height``, in units of ``clock`` s."""

    centre: float
    height: float
    clock: float


@dataclass(frozen=True)
class RigKind:
    """One kind of rig.

    Parameters
    ----------
    name : str
        Also the folder of its model.
    parameters : mapping of str to float
        Values in the Modelica file, from which the fit starts.
    known : tuple of str
        Parameters whose value in the file is right; all others are free.
    inputs : mapping of str to Drive
    states : mapping of str to Balance
    outputs : tuple of str
    units : mapping of str to str
        Of inputs and outputs; empty where the model declares none.
    step, rows : float, int
        Sample interval in s and number of samples.
    pieces : int
        Integration steps a sample.
    plant : callable
        Parameters -> equations.
    rest : callable
        Parameters -> states at rest under the drives' centres.
    sizes, shake : tuple of float
        Per state how large it usually gets, and the standard deviation of where a recording starts, about rest.
    laws : mapping of str to str
        Per place the laws that may be missing there, in one string; inputs as ``in:NAME``, outputs as ``out:NAME``.
    couplings : mapping of str to Coupling
    linear : bool
        Whether the equations without laws are linear.
    """

    name: str
    parameters: Parameters
    inputs: Mapping[str, Drive]
    states: Mapping[str, Balance]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    step: float
    rows: int
    plant: Callable[[Parameters], Plant]
    rest: Callable[[Parameters], list[float]]
    sizes: tuple[float, ...]
    shake: tuple[float, ...]
    laws: Mapping[str, str]
    known: tuple[str, ...] = ()
    pieces: int = 1
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    linear: bool = True

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that the fit may change."""
        return tuple(name for name in self.parameters if name not in self.known)

    def assemble(self, parameters: Parameters) -> Assembly:
        """The rig without laws."""
        return Assembly(
            self.plant(parameters), tuple(self.inputs), tuple(self.states), self.outputs, self.states, parameters,
            self.couplings,
        )  # fmt: skip


def _zeros(count: int) -> Callable[[Parameters], list[float]]:
    return lambda p: [0.0] * count


FRICTION = "coulomb_friction friction_by_direction stribeck_friction presliding_friction"
#: What an actuator of flow, heat or voltage may have; a drive that reverses may have a dead zone too.
ONE_WAY = "saturation rate_limit square_law lag delay hysteresis"
ACTUATOR = f"dead_zone {ONE_WAY}"


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
    _zeros(2),
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
    _zeros(2),
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
    _zeros(3),
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
    pieces=2,
    couplings={"shaft.phi": Coupling("motor.w", "load.w", "shaft.c", "shaft.d")},
)


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
    _zeros(2),
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
    _zeros(2),
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
    pieces=2,
    linear=False,
)

AMBIENT = 293.15


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
    _zeros(2),
    (0.2, 5.0),
    (0.01, 0.0),
    {
        "in:u": f"{ACTUATOR} offset",
        "v": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:y": "offset lag delay",
    },
    pieces=2,
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
    _zeros(4),
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
    pieces=2,
)

KINDS: dict[str, RigKind] = {
    kind.name: kind for kind in (PENDULUM, CART, SHAFT, MOTOR, CIRCUIT, TANKS, HEAT, RESERVOIRS, OSCILLATOR, CARRIAGES)
}
