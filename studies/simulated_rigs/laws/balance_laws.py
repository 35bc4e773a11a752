"""Laws that add to the balance of a state: of forces, flows or voltages; and play in an elastic coupling."""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, exp, sqrt

from numpy.random import Generator

from simulated_rigs.assembly import Assembly
from simulated_rigs.laws.kind import Parameters, Scale, listed, random_sign
from simulated_rigs.plant import DryFriction, Overflow, Values

Install = Callable[[Assembly, str, Parameters], None]


def _function(law: Callable[[float, Parameters], float], of_position: bool = False) -> Install:
    """Make a law that adds a function of a state, or of the state whose derivative that is, to the state's balance."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        index, source = a.state(name), a.state((a.balances[name].position or "") if of_position else name)

        def add(t: float, x: Values, u: Values, e: list[float]) -> None:
            e[index] += law(x[source], p)

        a.terms.append(add)

    return install


def _loss(law: Callable[[float], float]) -> Install:
    """Make a loss of ``k`` times an odd function, given for what is positive, of the state above its reference."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        level = a.balances[name].reference
        _function(lambda x, p: -p["k"] * copysign(law(abs(x - level)), x - level))(a, name, p)

    return install


def _friction(level: Callable[[int, float, Parameters], float]) -> Install:
    """Make dry friction of a level over direction and speed."""

    def install(a: Assembly, name: str, p: Parameters) -> None:
        if any(level(side, 0.0, p) for side in (-1, 1)):
            a.holds.append(DryFriction(a.state(name), lambda direction, speed: level(direction, speed, p)))

    return install


def _presliding(a: Assembly, name: str, p: Parameters) -> None:
    """Add Dahl's model: a spring that yields at ``F_c``."""
    index, level, force = a.state(name), p["F_c"], a.add_state()
    stiffness = level / p["x_s"]

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        v = x[index]
        e[index] -= x[force]
        e[force] += stiffness * (v - abs(v) * x[force] / level)

    if level:
        a.terms.append(add)


def _beyond(value: float, half: float) -> float:
    """Return how far a value stands beyond a band about zero."""
    return value - min(max(value, -half), half)


def _backlash(a: Assembly, name: str, p: Parameters) -> None:
    """Add play in series with an elastic coupling: no torque within it, the coupling's own beyond."""
    coupling, half = a.couplings[name], p["gap"] / 2.0
    stretch, first, second = a.state(name), a.state(coupling.first), a.state(coupling.second)
    k, c = a.parameters[coupling.stiffness], a.parameters[coupling.damping] if coupling.damping else 0.0

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        inside = abs(x[stretch]) <= half
        gone = k * x[stretch] + c * (x[first] - x[second]) if inside else k * copysign(half, x[stretch])
        e[first] += gone
        e[second] -= gone

    a.terms.append(add)


def _overflow(a: Assembly, name: str, p: Parameters) -> None:
    neighbour = a.balances[name].neighbour
    a.holds.append(Overflow(a.state(name), p["rim"], None if neighbour is None else a.state(neighbour), p["share"]))


def _exchange(a: Assembly, name: str, p: Parameters) -> None:
    index, other = a.state(name), a.state(a.balances[name].neighbour or "")

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        flow = p["k"] * (x[other] - x[index])
        e[index] += flow
        e[other] -= flow

    a.terms.append(add)


def _radiation(a: Assembly, name: str, p: Parameters) -> None:
    surroundings = a.balances[name].reference ** 4
    _function(lambda x, p: -p["k"] * (x**4 - surroundings))(a, name, p)


def _heating(a: Assembly, name: str, p: Parameters) -> None:
    """Let a resistance grow with the heat its current has left."""
    index, rate, rise = a.state(name), 1.0 / p["T_h"], a.add_state()

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        i = x[index]
        e[index] -= x[rise] * i
        e[rise] += rate * (p["r_h"] * i * i - x[rise])

    a.terms.append(add)


def _directions(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    apart = float(rng.uniform(1.25, 2.0)) ** random_sign(rng)
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


def _force(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"b": size * s.effort * random_sign(rng)}


def _dahl(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    return {"F_c": size * s.effort, "x_s": s.spread * s.time * float(rng.uniform(0.1, 0.5))}


_OFFSET = _function(lambda x, p: p["b"])
#: Where each law acts (the family of a balance, or ``coupling``), and the law.
BALANCE_LAWS = (
    listed("motion", "coulomb_friction", lambda g, z, s: {"F_c": z * s.effort}, _friction(lambda d, v, p: p["F_c"])),
    listed(
        "motion",
        "friction_by_direction",
        _directions,
        _friction(lambda d, v, p: p["F_plus"] if d > 0 else p["F_minus"]),
    ),
    listed(
        "motion",
        "stribeck_friction",
        _stribeck,
        _friction(lambda d, v, p: p["F_c"] + (p["F_s"] - p["F_c"]) * exp(-((v / p["v_s"]) ** 2))),
    ),
    listed("motion", "presliding_friction", _dahl, _presliding),
    listed(
        "motion",
        "viscous_friction",
        lambda g, z, s: {"d": z * s.effort / s.spread},
        _function(lambda v, p: -p["d"] * v),
    ),
    listed(
        "motion",
        "quadratic_drag",
        lambda g, z, s: {"c": z * s.effort / s.spread**2},
        _function(lambda v, p: -p["c"] * v * abs(v)),
    ),
    listed("motion", "offset", _force, _OFFSET),
    listed(
        "motion",
        "linear_stiffness",
        lambda g, z, s: {"k": z * s.effort / s.position},
        _function(lambda x, p: -p["k"] * x, True),
    ),
    listed(
        "motion",
        "cubic_stiffness",
        lambda g, z, s: {"k_3": z * s.effort / s.position**3},
        _function(lambda x, p: -p["k_3"] * x**3, True),
    ),
    listed("motion", "end_stop", _stop, _function(lambda x, p: -p["k_s"] * _beyond(x, p["x_s"]), True), 0.7),
    listed("coupling", "backlash", lambda g, z, s: {"gap": z * s.spread}, _backlash, 3.0),
    listed("storage", "linear_loss", lambda g, z, s: {"k": z * s.effort / s.spread}, _loss(lambda x: x)),
    listed("storage", "root_loss", lambda g, z, s: {"k": z * s.effort / sqrt(s.spread)}, _loss(sqrt)),
    listed("storage", "square_loss", lambda g, z, s: {"k": z * s.effort / s.spread**2}, _loss(lambda x: x * x)),
    listed("storage", "overflow", _rim, _overflow, 0.6),
    listed("storage", "offset", _force, _OFFSET),
    listed("storage", "exchange", lambda g, z, s: {"k": z * s.effort / s.difference}, _exchange),
    listed("storage", "radiation", lambda g, z, s: {"k": z * s.effort / (4.0 * s.mean**3 * s.spread)}, _radiation),
    listed(
        "electrical",
        "series_resistance",
        lambda g, z, s: {"R": z * s.effort / s.spread},
        _function(lambda i, p: -p["R"] * i),
    ),
    listed("electrical", "contact_drop", lambda g, z, s: {"V_c": z * s.effort}, _friction(lambda d, i, p: p["V_c"])),
    listed("electrical", "heating", _rise, _heating),
)
