"""Laws that add to the balance of a state: of forces, flows or voltages; and play in an elastic coupling."""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, exp, sqrt

from numpy.random import Generator

from simulated_rigs.assembly import Assembly
from simulated_rigs.laws.kind import LawKind, Parameters, Scale, random_sign
from simulated_rigs.plant import DryFriction, Overflow, PiecewiseTerm, Values


def _function(a: Assembly, name: str, law: Callable[[float], float], of: str | None = None) -> None:
    """Add ``law(state)`` to a balance."""
    index, source = a.state(name), a.state(of or name)

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        e[index] += law(x[source])

    a.term(add)


def _coulomb(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.holds.append(DryFriction(a.state(name), lambda direction, speed: p["F_c"], slack))


def _contact_drop(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.holds.append(DryFriction(a.state(name), lambda direction, current: p["V_c"], slack))


def _by_direction(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    forward, back = p["F_plus"], p["F_minus"]
    a.holds.append(DryFriction(a.state(name), lambda direction, speed: forward if direction > 0 else back, slack))


def _stribeck(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    sliding, more, width = p["F_c"], p["F_s"] - p["F_c"], p["v_s"]
    a.holds.append(
        DryFriction(a.state(name), lambda direction, speed: sliding + more * exp(-((speed / width) ** 2)), slack)
    )


def _presliding(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    """Add Dahl's model: a spring that yields at ``F_c``."""
    index, level, stiffness = a.state(name), p["F_c"], p["F_c"] / p["x_s"]
    force = a.add_state()
    # The force settles within x_s / |v|, and v reaches some 2e9 slacks.
    a.longest = min(a.longest, 0.4 * p["x_s"] / (2e9 * slack))

    def add(region: int, t: float, x: Values, u: Values, e: list[float]) -> None:
        v = x[index]
        e[index] -= x[force]
        e[force] += stiffness * (v - region * v * x[force] / level)

    a.terms.append(PiecewiseTerm(lambda x: x[index], 0.0, add, slack))


def _viscous(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    _function(a, name, lambda v: -p["d"] * v)


def _quadratic_drag(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    _function(a, name, lambda v: -p["c"] * v * abs(v))


def _constant(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    _function(a, name, lambda v: p["b"])


def _linear_stiffness(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    _function(a, name, lambda x: -p["k"] * x, a.balances[name].position)


def _cubic_stiffness(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    _function(a, name, lambda x: -p["k_3"] * x**3, a.balances[name].position)


def _end_stop(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    index, position = a.state(name), a.state(a.balances[name].position or "")
    a.longest = min(a.longest, 0.1 * sqrt(a.plant.capacity[index] / p["k_s"]))

    def add(region: int, t: float, x: Values, u: Values, e: list[float]) -> None:
        if region:
            e[index] -= p["k_s"] * (x[position] - region * p["x_s"])

    a.terms.append(PiecewiseTerm(lambda x: x[position], p["x_s"], add, slack))


def _backlash(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    """Add play in series with an elastic coupling: no torque within it, the coupling's own beyond."""
    coupling = a.couplings[name]
    stretch, first, second = a.state(name), a.state(coupling.first), a.state(coupling.second)
    k, half = a.parameters[coupling.stiffness], p["gap"] / 2.0
    c = a.parameters[coupling.damping] if coupling.damping else 0.0

    def add(region: int, t: float, x: Values, u: Values, e: list[float]) -> None:
        gone = k * half * region if region else k * x[stretch] + c * (x[first] - x[second])
        e[first] += gone
        e[second] -= gone

    a.terms.append(PiecewiseTerm(lambda x: x[stretch], half, add, slack))


def _linear_loss(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    reference = a.balances[name].reference
    _function(a, name, lambda x: -p["k"] * (x - reference))


def _root_loss(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    reference = a.balances[name].reference
    _function(a, name, lambda x: -p["k"] * copysign(sqrt(abs(x - reference)), x - reference))


def _square_loss(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    reference = a.balances[name].reference
    _function(a, name, lambda x: -p["k"] * (x - reference) * abs(x - reference))


def _overflow(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    neighbour = a.balances[name].neighbour
    index = None if neighbour is None else a.state(neighbour)
    a.holds.append(Overflow(a.state(name), p["rim"], index, p["share"], slack))


def _exchange(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    index, other = a.state(name), a.state(a.balances[name].neighbour or "")

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        flow = p["k"] * (x[other] - x[index])
        e[index] += flow
        e[other] -= flow

    a.term(add)


def _radiation(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    surroundings = a.balances[name].reference ** 4
    _function(a, name, lambda x: -p["k"] * (x**4 - surroundings))


def _series_resistance(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    _function(a, name, lambda i: -p["R"] * i)


def _heating(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    """Let a resistance grow with the heat its current has left."""
    index, rate = a.state(name), 1.0 / p["T_h"]
    rise = a.add_state()

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        i = x[index]
        e[index] -= x[rise] * i
        e[rise] += rate * (p["r_h"] * i * i - x[rise])

    a.term(add)


def _directions(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    apart = float(rng.uniform(1.25, 2.0)) ** random_sign(rng)
    return {"F_plus": size * s.effort * apart, "F_minus": size * s.effort / apart}


#: Where each law acts (the family of a balance, or ``coupling``), and the law.
BALANCE_LAWS: tuple[tuple[str, LawKind], ...] = (
    ("motion", LawKind("coulomb_friction", "balance", lambda g, z, s: {"F_c": z * s.effort}, _coulomb)),
    ("motion", LawKind("friction_by_direction", "balance", _directions, _by_direction)),
    (
        "motion",
        LawKind(
            "stribeck_friction",
            "balance",
            lambda g, z, s: {
                "F_c": z * s.effort,
                "F_s": z * s.effort * float(g.uniform(1.4, 2.2)),
                "v_s": s.spread * float(g.uniform(0.1, 0.4)),
            },
            _stribeck,
        ),
    ),
    (
        "motion",
        LawKind(
            "presliding_friction",
            "balance",
            lambda g, z, s: {"F_c": z * s.effort, "x_s": s.spread * s.time * float(g.uniform(0.1, 0.5))},
            _presliding,
        ),
    ),
    ("motion", LawKind("viscous_friction", "balance", lambda g, z, s: {"d": z * s.effort / s.spread}, _viscous)),
    (
        "motion",
        LawKind("quadratic_drag", "balance", lambda g, z, s: {"c": z * s.effort / s.spread**2}, _quadratic_drag),
    ),
    ("motion", LawKind("offset", "balance", lambda g, z, s: {"b": z * s.effort * random_sign(g)}, _constant)),
    (
        "motion",
        LawKind("linear_stiffness", "balance", lambda g, z, s: {"k": z * s.effort / s.position}, _linear_stiffness),
    ),
    (
        "motion",
        LawKind("cubic_stiffness", "balance", lambda g, z, s: {"k_3": z * s.effort / s.position**3}, _cubic_stiffness),
    ),
    (
        "motion",
        LawKind(
            "end_stop",
            "balance",
            lambda g, z, s: {
                "x_s": (1.0 - z) * s.farthest,
                "k_s": float(g.uniform(10.0, 30.0)) * s.effort / s.position,
            },
            _end_stop,
            0.7,
        ),
    ),
    ("coupling", LawKind("backlash", "coupling", lambda g, z, s: {"gap": z * s.spread}, _backlash, 3.0)),
    ("storage", LawKind("linear_loss", "balance", lambda g, z, s: {"k": z * s.effort / s.spread}, _linear_loss)),
    (
        "storage",
        LawKind("root_loss", "balance", lambda g, z, s: {"k": z * s.effort / sqrt(s.spread)}, _root_loss),
    ),
    (
        "storage",
        LawKind("square_loss", "balance", lambda g, z, s: {"k": z * s.effort / s.spread**2}, _square_loss),
    ),
    (
        "storage",
        LawKind(
            "overflow",
            "balance",
            lambda g, z, s: {
                "rim": s.highest - z * (s.highest - s.lowest),
                "share": float(g.uniform(0.2, 0.9)) if g.random() < 0.5 else 0.0,
            },
            _overflow,
            0.6,
        ),
    ),
    ("storage", LawKind("offset", "balance", lambda g, z, s: {"b": z * s.effort * random_sign(g)}, _constant)),
    ("storage", LawKind("exchange", "balance", lambda g, z, s: {"k": z * s.effort / s.difference}, _exchange)),
    (
        "storage",
        LawKind("radiation", "balance", lambda g, z, s: {"k": z * s.effort / (4.0 * s.mean**3 * s.spread)}, _radiation),
    ),
    (
        "electrical",
        LawKind("series_resistance", "balance", lambda g, z, s: {"R": z * s.effort / s.spread}, _series_resistance),
    ),
    ("electrical", LawKind("contact_drop", "balance", lambda g, z, s: {"V_c": z * s.effort}, _contact_drop)),
    (
        "electrical",
        LawKind(
            "heating",
            "balance",
            lambda g, z, s: {
                "r_h": z * s.effort / s.spread / (s.spread**2 + s.mean**2),
                "T_h": s.duration * float(g.uniform(0.05, 0.3)),
            },
            _heating,
        ),
    ),
)
