"""The simulated AERO with the effects of its catalogue and its sensors, and the recordings of ``make``.

The states that a law at a port adds to are those of the driven motor; its current, speed and thrust stand for both.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from math import cos
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, write_csv
from aero_bayes.errors import InputError
from aero_bayes.files import write_whole
from simulated_rigs.assembly import Assembly
from simulated_rigs.designs import InputDesign, equal_steps, random_levels
from simulated_rigs.kinds.aero import AERO, Parameters
from simulated_rigs.laws import Parameters as LawParameters
from simulated_rigs.plant import Values
from simulated_rigs.sensors import SensorNoise, Sensors, clean, quantise, white
from simulated_rigs.signals import PiecewiseSignal, held_command
from simulated_rigs.truth import LawPlace, law_kind

UNITS = {"time": "s", "V_m": "V", "i_m": "A", "omega_m": "rad/s", "theta": "rad"}


@dataclass(frozen=True)
class EffectTruth:
    """An effect of a simulated AERO: its id in the catalogue, where it acts, and how large it is (SI units)."""

    id: str
    port: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Truth:
    """A whole simulated AERO: two motors driven against each other or one, and the delay of its amplifier in s."""

    system: Literal["one_dof", "half_quad"] = "one_dof"
    parameters: Parameters = field(default_factory=Parameters)
    effects: tuple[EffectTruth, ...] = ()
    input_delay: float = 0.0
    note: str = field(default="simulated", compare=False)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a file beside the recordings; they are never in the recordings."""
        return asdict(self)


Install = Callable[[Assembly, LawParameters], None]


@dataclass(frozen=True)
class EffectKind:
    """One effect of the catalogue. It vanishes when the first of its parameters is zero."""

    id: str
    port: str
    parameters: tuple[str, ...]
    install: Install

    def truth(self, **parameters: float) -> EffectTruth:
        """Make an effect of this kind. Raises InputError for missing or unknown parameters."""
        if set(parameters) != set(self.parameters):
            wanted, given = ", ".join(self.parameters), ", ".join(parameters) or "none"
            raise InputError(f"bench: {self.id} takes {wanted}, not {given}")
        return EffectTruth(self.id, self.port, parameters)


def _law(law: str, place: str, name: str, *names: str) -> Install:
    """Make an effect of a law that all rigs may have; ``names`` are the law's names of the effect's parameters."""

    def install(a: Assembly, p: LawParameters) -> None:
        found = law_kind(AERO, law, LawPlace(place, name))
        found.install(a, name, dict(zip(names, p.values(), strict=True)))

    return install


def _term(add: Callable[[LawParameters, Values], float], reach: Callable[[Assembly], float] = lambda a: 1.0) -> Install:
    """Make an effect that adds a torque to the body: of its parameters and the states, times ``reach``."""

    def install(a: Assembly, p: LawParameters) -> None:
        factor = reach(a)

        def term(t: float, x: Values, u: Values, e: list[float]) -> None:
            e[3] += factor * add(p, x)

        a.terms.append(term)

    return install


def _arm(a: Assembly) -> float:
    """Return the length in m on which one propeller's thrust would pitch the body as all of them do."""
    return a.parameters.get("motors", 2.0) * a.parameters["D_t"]


def _thrust_gain(a: Assembly) -> float:
    return _arm(a) * a.parameters["k_t"]


def _inflow(a: Assembly, p: LawParameters) -> None:
    loss = _arm(a) * a.parameters["D_t"]
    _term(lambda p, x: -loss * p["k_v"] * abs(x[1]) * x[3])(a, p)


def _thrust_lag(a: Assembly, p: LawParameters) -> None:
    if p["T_f"] <= 0.0:
        return
    gain, rate, lagged = _thrust_gain(a), 1.0 / p["T_f"], a.add_state()

    def term(t: float, x: Values, u: Values, e: list[float]) -> None:
        behind = x[lagged] - gain * x[1] * abs(x[1])
        e[3] += behind
        e[lagged] -= rate * behind

    a.terms.append(term)


def _saturation(a: Assembly, p: LawParameters) -> None:
    if p["s_sat"] > 0.0:
        _law("saturation", "input", "V_m", "u_max")(a, {"u_max": 1.0 / p["s_sat"]})


_CATALOGUE: tuple[tuple[str, str, str, Install], ...] = (
    ("supply_resistance", "electrical", "R_s", _law("series_resistance", "balance", "i", "R")),
    ("brush_drop", "electrical", "V_b", _law("contact_drop", "balance", "i", "V_c")),
    ("winding_heating", "electrical", "r_h T_h", _law("heating", "balance", "i", "r_h", "T_h")),
    ("amplifier_deadzone", "electrical", "V_dz", _law("dead_zone", "input", "V_m", "w")),
    ("amplifier_saturation", "electrical", "s_sat", _saturation),
    ("rotor_coulomb_friction", "rotor", "tau_r", _law("coulomb_friction", "balance", "w", "F_c")),
    ("rotor_viscous_friction", "rotor", "d_r", _law("viscous_friction", "balance", "w", "d")),
    ("thrust_inflow_loss", "thrust", "k_v", _inflow),
    ("thrust_lag", "thrust", "T_f", _thrust_lag),
    ("thrust_asymmetry", "thrust", "a_f", _term(lambda p, x: p["a_f"] * x[1] * x[1], _thrust_gain)),
    ("pivot_coulomb_friction", "body", "tau_c", _law("coulomb_friction", "balance", "q", "F_c")),
    ("pivot_presliding_friction", "body", "tau_p theta_p", _law("presliding_friction", "balance", "q", "F_c", "x_s")),
    ("body_quadratic_drag", "body", "c_b", _law("quadratic_drag", "balance", "q", "c")),
    ("gravity_offset", "body", "tau_g", _term(lambda p, x: p["tau_g"] * cos(x[2]))),
    ("cubic_stiffness", "body", "k_3", _law("cubic_stiffness", "balance", "q", "k_3")),
    ("current_offset", "sensor", "b_i", _law("offset", "output", "i_m", "b")),
    ("speed_lag", "sensor", "T_w", _law("lag", "output", "omega_m", "T")),
    ("pitch_delay", "sensor", "T_d", _law("delay", "output", "pitch", "T")),
    ("pitch_offset", "sensor", "b_th", _law("offset", "output", "pitch", "b")),
)
#: The effects of the catalogue by id, exact and, where the physics is, not smooth; and one that no catalogue lists.
KINDS = {id: EffectKind(id, port, tuple(names.split()), install) for id, port, names, install in _CATALOGUE}
STALL = EffectKind("propeller_stall", "thrust", ("s",), _term(lambda p, x: -p["s"] * x[1] ** 3, _thrust_gain))


def effect(id: str, **parameters: float) -> EffectTruth:
    """Make an effect by its id. Raises InputError for unknown names."""
    return _kind(id).truth(**parameters)


def _kind(id: str) -> EffectKind:
    if id not in KINDS and id != STALL.id:
        raise InputError(f"bench: no effect {id}")
    return KINDS.get(id, STALL)


@dataclass(frozen=True)
class TrueRun:
    """Undisturbed signals of a run, shape (n,) each, and the rotor's angle in rad and speed in rad/s for ripple."""

    time: FloatArray
    volts: FloatArray
    i_m: FloatArray
    omega_m: FloatArray
    theta: FloatArray
    angle: FloatArray
    speed: FloatArray


def even_times(duration: float, rate_hz: float) -> FloatArray:
    """Return even sample times from 0 to ``duration`` s, both ends included."""
    return np.arange(round(duration * rate_hz) + 1) / rate_hz


def _assembled(truth: Truth) -> tuple[Assembly, int]:
    """Put the rig together, with the rotor's angle; also the index of that state."""
    rig = AERO.assemble({**asdict(truth.parameters), "motors": 2.0 if truth.system == "one_dof" else 1.0})
    for one in truth.effects:
        kind = _kind(one.id)
        kind.truth(**one.parameters)
        before = len(rig.actuators)
        kind.install(rig, {name: one.parameters[name] for name in kind.parameters})
        if before and len(rig.actuators) == before and one.id.startswith("amplifier"):
            raise InputError("bench: one effect of the amplifier at a time")
    angle = rig.add_state()

    def turn(t: float, x: Values, u: Values, e: list[float]) -> None:
        e[angle] += x[1]

    rig.terms.append(turn)
    inner = rig.actuators.get("V_m", held_command)

    def late(time: FloatArray, values: FloatArray) -> PiecewiseSignal:
        """Apply nothing until the first voltage arrives."""
        given, none = inner(time, values), np.zeros(1)
        breaks = np.append(time[:1], given.breaks + truth.input_delay)
        return PiecewiseSignal(breaks, np.append(none, given.base), *2 * (np.zeros(breaks.size),))

    if truth.input_delay > 0.0:
        rig.actuators["V_m"] = late
    return rig, angle


def _rest_angle(rig: Assembly) -> float:
    """Find the pitch angle in rad at which the undriven body is in balance."""
    theta, stiffness = 0.0, rig.parameters["K_sp"]
    for _ in range(60):
        x = [0.0, 0.0, theta, 0.0, *(0.0 for _ in rig.extra)]
        e = rig.plant.efforts(x, [0.0]) + [0.0] * len(rig.extra)
        for term in rig.terms:
            term(0.0, x, [0.0], e)
        theta += e[3] / stiffness
    return theta


def simulate_truth(
    truth: Truth,
    design: InputDesign,
    time: FloatArray,
    theta_start: float | None = None,
    *,
    torque: FloatArray | None = None,
) -> TrueRun:
    """Simulate a rig without noise, at sample times ``time`` in s, shape (n,).

    The voltage of ``design`` is held from each sample to the next and applied ``truth.input_delay`` s late, as are the
    values of ``torque``, N m on the body, without delay. The body is let go at the pitch ``theta_start``, by default
    where it rests undriven. Raises InputError for an effect that is not known.
    """
    rig, angle = _assembled(truth)
    if torque is not None:
        rig.push("q", torque)
    volts = design.volts(time)
    start = (0.0, 0.0, _rest_angle(rig) if theta_start is None else theta_start, 0.0)
    outputs, states = rig.run(time, volts[:, None], start)
    i_m, omega_m, theta = outputs.T
    return TrueRun(time, volts, i_m, omega_m, theta, states[:, angle], states[:, 1])


def measure(run: TrueRun, sensors: Sensors, rng: Generator, name: str = "simulated") -> Recording:
    """Add what the sensors do to a run: noise, quantisation, gaps."""
    streams = rng.spawn(4)
    readings: dict[str, FloatArray] = {}
    channels: tuple[tuple[str, FloatArray, SensorNoise], ...] = (
        ("i_m", run.i_m, sensors.i_m),
        ("omega_m", run.omega_m, sensors.omega_m),
        ("theta", run.theta, sensors.theta),
    )
    for stream, (output, values, noise) in zip(streams, channels, strict=False):
        measured = values + noise.sample(stream, run.time, run.angle, run.speed)
        if output == "theta" and sensors.encoder_counts:
            measured = quantise(measured, sensors.encoder_counts)
        if noise.missing:
            measured = np.where(streams[3].random(measured.size) < noise.missing, np.nan, measured)
        readings[output] = measured
    return Recording(name, run.time, {"V_m": run.volts}, readings, UNITS)


def simulate_recording(
    truth: Truth,
    design: InputDesign,
    sensors: Sensors | None = None,
    rng: Generator | None = None,
    *,
    duration: float = 60.0,
    rate_hz: float = 100.0,
    name: str = "simulated",
) -> Recording:
    """Simulate one recording of a rig, ``duration`` s at ``rate_hz``; see :func:`simulate_truth` and :func:`measure`.

    ``rng`` is needed where ``sensors`` has noise.
    """
    run = simulate_truth(truth, design, even_times(duration, rate_hz))
    chosen = sensors or clean()
    if rng is None:
        if chosen != clean():
            raise InputError("bench: noise needs a random generator")
        rng = np.random.default_rng(0)
    return measure(run, chosen, rng, name)


@dataclass(frozen=True)
class SimulatedSet:
    """Recordings of one simulated AERO, for fitting and for judging, and what it truly is."""

    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    truth: Truth
    sensors: Sensors

    def write(self, folder: Path | str) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
        """Write ``<name>.csv`` for every recording and ``simulated.json``, which holds the truth.

        Returns the paths of the training and of the test recordings. Nothing in the CSV files tells that they are
        simulated or what they carry.
        """
        root = Path(folder)
        train, test = (
            tuple(write_csv(recording, root / f"{recording.name}.csv") for recording in part)
            for part in (self.train, self.test)
        )
        label = {
            "simulated": True,
            "recordings": [recording.name for recording in (*self.train, *self.test)],
            "truth": self.truth.to_dict(),
            "noise": self.sensors.label,
        }
        write_whole(root / "simulated.json", json.dumps(label, indent=1) + "\n")
        return train, test


def default_truth() -> Truth:
    """Make a rig a few percent off its data sheet with 1.2 mN m of dry friction in the pivot and a 6 ms input delay."""
    parameters = Parameters().scaled(
        {"R_a": 1.07, "c_m": 0.98, "J": 0.93, "k_d": 1.08, "k_t": 0.95, "D_p": 0.9, "K_sp": 1.05}
    )
    return Truth("one_dof", parameters, (effect("pivot_coulomb_friction", tau_c=1.2e-3),), 0.006)


def default_recordings(seed: int = 0) -> SimulatedSet:
    """Simulate two training recordings and one test recording, 60 s at 100 Hz each, all three outputs, white noise."""
    streams = np.random.default_rng([seed, 1]).spawn(5)
    truth, sensors = default_truth(), white()
    designs = (
        ("train_1", random_levels(streams[0], 20.0, 60.0)),
        ("train_2", equal_steps([6.0, 12.0, 18.0, 24.0, 12.0, 0.0, -6.0, -12.0, -18.0, -6.0, 0.0], 5.0)),
        ("test_1", random_levels(streams[1], 20.0, 60.0)),
    )
    made = [
        simulate_recording(truth, design, sensors, stream, name=name)
        for (name, design), stream in zip(designs, streams[2:], strict=True)
    ]
    return SimulatedSet((made[0], made[1]), (made[2],), truth, sensors)
