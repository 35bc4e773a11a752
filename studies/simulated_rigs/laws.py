"""The library's laws as a bench has them: textbook formulas, exact and, where the physics is, not smooth.

A law of size zero is absent. Sizes are relative to what happens at the place without the law (:class:`Scale`), so that
one table serves every rig.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import copysign, exp, sqrt

import numpy as np
from numpy.random import Generator

from simulated_rigs.assembly import Assembly
from simulated_rigs.plant import DryFriction, Overflow, Regions, Values
from simulated_rigs.signals import delayed, lagged, play, rate_limited, static

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Scale:
    """What happens at a place without the law.

    Parameters
    ----------
    spread, largest, lowest, highest, mean : float
        Of the signal there (input, output or state): standard deviation, largest absolute value, range, mean.
    effort : float
        Standard deviation of what changes the state.
    time : float
        How long the signal takes to change by its spread, in s.
    duration : float
        Length of the recording in s.
    position, farthest : float
        Standard deviation and largest absolute value of the state whose derivative this is (0 where there is none).
    difference : float
        Standard deviation of the difference to the neighbour.
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


Draw = Callable[[Generator, float, Scale], dict[str, float]]
Install = Callable[[Assembly, str, Parameters, float], None]


@dataclass(frozen=True)
class LawKind:
    """One law.

    Parameters
    ----------
    id, place : str
        ``place`` is ``input``, ``output``, ``balance`` or ``coupling``.
    draw : callable
        (generator, size, scale) -> parameters; whatever else it draws is independent of the size.
    install : callable
        (assembly, name of the place, parameters, slack) puts it there; ``slack`` is how far the signal there may be
        on the wrong side of an event.
    most : float
        The largest size that makes sense.
    """

    id: str
    place: str
    draw: Draw
    install: Install
    most: float = 100.0


def _signed(rng: Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


# Inputs: the law turns a command into what is applied.


def _gain_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = static(lambda u: (1.0 + p["g"]) * u)


def _offset_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = static(lambda u: u + p["b"])


def _dead_zone(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = static(lambda u: np.sign(u) * np.maximum(np.abs(u) - p["w"], 0.0))


def _saturation(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = static(lambda u: np.clip(u, -p["u_max"], p["u_max"]))


def _hysteresis(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(play, half_width=p["w"], share=p["share"])


def _rate_limit(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(rate_limited, fastest=p["r_max"])


def _square_law(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    """Between the command itself and its square, which are equal at ``u_n``."""
    a.actuators[name] = static(lambda u: u + p["a"] * (u * np.abs(u) / p["u_n"] - u))


def _lag_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(lagged, constant=p["T"])


def _delay_in(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    a.actuators[name] = partial(delayed, delay=p["T"])


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


# Balances: the law adds to the efforts of a state.


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
    """Dahl's model: a spring that yields at ``F_c``."""
    index, level, stiffness = a.state(name), p["F_c"], p["F_c"] / p["x_s"]
    force = a.add_state()
    # The force settles within x_s / |v|, and v reaches some 2e9 slacks.
    a.longest = min(a.longest, 0.4 * p["x_s"] / (2e9 * slack))

    def add(region: int, t: float, x: Values, u: Values, e: list[float]) -> None:
        v = x[index]
        e[index] -= x[force]
        e[force] += stiffness * (v - region * v * x[force] / level)

    a.terms.append(Regions(lambda x: x[index], 0.0, add, slack))


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

    a.terms.append(Regions(lambda x: x[position], p["x_s"], add, slack))


def _backlash(a: Assembly, name: str, p: Parameters, slack: float) -> None:
    """Play in series with an elastic coupling: no torque within it, the coupling's own beyond."""
    coupling = a.couplings[name]
    stretch, first, second = a.state(name), a.state(coupling.first), a.state(coupling.second)
    k, half = a.parameters[coupling.stiffness], p["gap"] / 2.0
    c = a.parameters[coupling.damping] if coupling.damping else 0.0

    def add(region: int, t: float, x: Values, u: Values, e: list[float]) -> None:
        gone = k * half * region if region else k * x[stretch] + c * (x[first] - x[second])
        e[first] += gone
        e[second] -= gone

    a.terms.append(Regions(lambda x: x[stretch], half, add, slack))


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
    """A resistance that grows with the heat its current has left."""
    index, rate = a.state(name), 1.0 / p["T_h"]
    rise = a.add_state()

    def add(t: float, x: Values, u: Values, e: list[float]) -> None:
        i = x[index]
        e[index] -= x[rise] * i
        e[rise] += rate * (p["r_h"] * i * i - x[rise])

    a.term(add)


def _directions(rng: Generator, size: float, s: Scale) -> dict[str, float]:
    apart = float(rng.uniform(1.25, 2.0)) ** _signed(rng)
    return {"F_plus": size * s.effort * apart, "F_minus": size * s.effort / apart}


#: (kind of place, law) -> the law; the kinds of place of balances are their families.
LAWS: dict[tuple[str, str], LawKind] = {
    (family, law.id): law
    for family, law in (
        ("input", LawKind("gain", "input", lambda g, z, s: {"g": z * _signed(g)}, _gain_in, 0.6)),
        ("input", LawKind("offset", "input", lambda g, z, s: {"b": z * s.spread * _signed(g)}, _offset_in, 2.0)),
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
        ("output", LawKind("gain", "output", lambda g, z, s: {"g": z * _signed(g)}, _gain_out, 0.6)),
        ("output", LawKind("offset", "output", lambda g, z, s: {"b": z * s.spread * _signed(g)}, _offset_out, 5.0)),
        ("output", LawKind("lag", "output", lambda g, z, s: {"T": z * s.time}, _lag_out, 3.0)),
        ("output", LawKind("delay", "output", lambda g, z, s: {"T": z * s.time}, _delay_out, 3.0)),
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
        ("motion", LawKind("offset", "balance", lambda g, z, s: {"b": z * s.effort * _signed(g)}, _constant)),
        (
            "motion",
            LawKind("linear_stiffness", "balance", lambda g, z, s: {"k": z * s.effort / s.position}, _linear_stiffness),
        ),
        (
            "motion",
            LawKind(
                "cubic_stiffness", "balance", lambda g, z, s: {"k_3": z * s.effort / s.position**3}, _cubic_stiffness
            ),
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
        ("storage", LawKind("offset", "balance", lambda g, z, s: {"b": z * s.effort * _signed(g)}, _constant)),
        ("storage", LawKind("exchange", "balance", lambda g, z, s: {"k": z * s.effort / s.difference}, _exchange)),
        (
            "storage",
            LawKind(
                "radiation", "balance", lambda g, z, s: {"k": z * s.effort / (4.0 * s.mean**3 * s.spread)}, _radiation
            ),
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
}
