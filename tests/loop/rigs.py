"""Rigs that lack a law, simulated here by formulas and Runge-Kutta steps, and what a loop has to say of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from closed_form import held
from scipy.linalg import expm

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.loop import LoopResult, LoopSettings, close_loop

#: A function of the fitted values of the law's parameters, the truth, and the largest difference.
Known = tuple[Callable[[Sequence[float]], float], float, float]


@dataclass(frozen=True)
class Rig:
    """A model that lacks a law, with recordings that have it.

    ``known`` are facts of the law's parameters, ``values`` true values of the model's own, with the largest relative
    difference. ``before`` and ``after`` are the least error on test readings without the law, and the largest with it.
    """

    model: str
    recorded: Callable[[str, int], Recording]
    seeds: tuple[int, int]
    free: tuple[str, ...]
    laws: tuple[str, ...]
    effect: str
    known: tuple[Known, ...] = ()
    values: dict[str, tuple[float, float]] = field(default_factory=dict)
    output: str = ""
    before: float = 0.0
    after: float = np.inf
    most: int = 2
    start: str = "auto"
    effects: tuple[str, ...] | None = None

    @property
    def settings(self) -> LoopSettings:
        calibration = CalibrationSettings(initial_states=self.start)  # type: ignore[arg-type]
        return LoopSettings(
            fit=FitSettings(method="local", calibration=calibration), parameters=self.free, laws=self.laws or None,
            effects=self.effects, max_effects=self.most,
        )  # fmt: skip

    def recordings(self) -> list[Recording]:
        return [self.recorded(name, seed) for name, seed in zip("ab", self.seeds, strict=True)]

    def closed(self, folder: Path, workers: int = 0) -> LoopResult:
        path = folder / f"{self.model.split()[1]}.mo"
        path.write_text(self.model, encoding="utf-8")
        train, test = self.recordings()
        return close_loop([train], [test], model=path, settings=self.settings, workers=workers)


def first(values: Sequence[float]) -> float:
    return values[0]


def steps(count: int, hold: int, most: float, seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-most, most, count), hold)


def noise(seed: int, size: int) -> np.ndarray:
    return np.random.default_rng(seed + 1000).normal(size=size)


METER = """model Meter "A lag and its reading"
  parameter Real T(unit = "s", min = 0) = 1;
  parameter Real K = 2;
  input Real u(unit = "V");
  output Real y(unit = "V");
  Real x(unit = "V", start = 0, fixed = true);
equation
  T*der(x) + x = K*u;
  y = x;
end Meter;
"""


def meter(name: str, seed: int) -> Recording:
    """A first-order lag, exact; the instrument is full at 1.5 V."""
    rng = np.random.default_rng(seed)
    u, decay = np.repeat(rng.uniform(-1.2, 1.2, 40), 20), np.exp(-0.05 / 0.8)
    x = np.zeros(u.size)
    for n in range(u.size - 1):
        x[n + 1] = decay * x[n] + (1.0 - decay) * 2.2 * u[n]
    read = np.minimum(x, 1.5) + rng.normal(0.0, 0.01, u.size)
    return Recording(name, 0.05 * np.arange(u.size), {"u": u}, {"y": read})


GEARED = """model Geared "A motor with a gear"
  parameter Real J(unit = "kg.m2", min = 0) = 2e-3;
  parameter Real d(unit = "N.m.s/rad", min = 0) = 4e-3;
  input Real tau(unit = "N.m");
  output Real w(unit = "rad/s", start = 0, fixed = true);
equation
  J*der(w) = tau - d*w;
end Geared;
"""


def geared(name: str, seed: int) -> Recording:
    """Set-valued friction of 0.02 N.m and 0.3 of the load, stepped in time by impulses (Moreau), with noise."""
    rng = np.random.default_rng(seed)
    tau = np.repeat(rng.uniform(-0.5, 0.5, 60), 25)
    step, speed, found = 0.01 / 50, 0.0, []
    for torque in tau:
        found.append(speed)
        for _ in range(50):
            load = torque - 5e-3 * speed
            free, most = speed + step / 1.5e-3 * load, step / 1.5e-3 * (0.02 + 0.3 * abs(load))
            speed = np.sign(free) * max(abs(free) - most, 0.0)
    return Recording(name, 0.01 * np.arange(tau.size), {"tau": tau}, {"w": found + 0.2 * rng.normal(size=tau.size)})


MOTOR = """model Motor "A motor that turns both ways"
  parameter Real T(unit = "s", min = 0) = 0.3;
  parameter Real k(unit = "rad/(s.V)", min = 0) = 1;
  input Real u(unit = "V");
  output Real w(unit = "rad/s", start = 0, fixed = true);
equation
  T*der(w) = k*u - w;
end Motor;
"""


def motor(name: str, seed: int) -> Recording:
    """The speed from step to step in closed form, without its sign, as a counter of pulses has it."""
    u, speed = steps(40, 20, 5.0, seed), [0.0]
    for level in u[:-1]:
        speed.append(1.4 * level + (speed[-1] - 1.4 * level) * np.exp(-0.02 / 0.2))
    return Recording(name, 0.02 * np.arange(u.size), {"u": u}, {"w": np.abs(speed) + 0.02 * noise(seed, u.size)})


BODY = """model Body "A body in air"
  parameter Real m(unit = "kg", min = 0) = 0.03;
  parameter Real d(unit = "N.s/m", min = 0) = 0.02;
  output Real z(unit = "m", start = 40, fixed = true);
  Real v(unit = "m/s", start = 2, fixed = true);
equation
  der(z) = v;
  m*der(v) = -d*v;
end Body;
"""


def body(name: str, seed: int) -> Recording:
    """A fall against drag in closed form: m 0.03 kg, d 0.015 N s/m, weight 0.2943 N, thrown up at 2 m/s from 40 m."""
    t = 0.05 * np.arange(80)
    end = -0.2943 / 0.015
    z = 40.0 + end * t + (2.0 - end) * 2.0 * (1.0 - np.exp(-t / 2.0))
    return Recording(name, t, {}, {"z": z + 0.02 * np.random.default_rng(seed).normal(size=t.size)})


CULTURE = """model Culture "A culture that is fed"
  parameter Real r(unit = "1/s", min = 0) = 1.2e-4;
  parameter Real y(min = 0) = 1;
  input Real feed(unit = "kg/(m3.s)");
  output Real x(unit = "kg/m3", start = 0.5, fixed = true, min = 0);
equation
  der(x) = r*x + y*feed;
end Culture;
"""


def culture(name: str, seed: int) -> Recording:
    """Without what ends the growth a culture does best without any growth: a rate near zero has no slope."""
    rng = np.random.default_rng(seed)
    feed = np.repeat(rng.choice([0.0, 0.5e-4, 1e-4], 6), 20)
    x = held(lambda x, u: 2e-4 * x + u - 1e-5 * x**2, rng.uniform(0.3, 1.0), feed, 900.0, 20)
    return Recording(name, 900.0 * np.arange(120), {"feed": feed}, {"x": x + rng.normal(0.0, 0.1, 120)})


SPRING = """model Spring "A mass on a spring"
  parameter Real m(unit = "kg", min = 0) = 2;
  parameter Real c(unit = "N.s/m", min = 0) = 10;
  parameter Real k(unit = "N/m", min = 0) = 5e4;
  input Real F(unit = "N");
  output Real y(unit = "m");
protected
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  m*der(v) = F - c*v - k*x;
  y = x;
end Spring;
"""


def spring(name: str, seed: int) -> Recording:
    """A resonance whose hardening force is larger than the linear one: the first fit is far off."""
    rng, samples = np.random.default_rng(seed), 4000 if name == "a" else 1500
    frequency = np.fft.rfftfreq(samples, 1.0 / 750.0)
    band = (frequency >= 5.0) & (frequency <= 150.0)
    force = np.fft.irfft(np.where(band, np.exp(2j * np.pi * rng.random(frequency.size)), 0.0), samples)
    force *= 20.0 / force.std()

    def slope(x, f):
        return np.array([x[1], (f - 10.0 * x[1] - 5e4 * x[0] - 1.2e10 * x[0] ** 3) / 2.0])

    y = held(slope, np.zeros(2), force, 1.0 / 750.0, 20)[:, 0]
    return Recording(name, np.arange(samples) / 750.0, {"F": force}, {"y": y + rng.normal(0.0, 1e-6, samples)})


CART = """model Cart "A mass on a spring, both its position and its speed are read"
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0.1, fixed = true);
  output Real v(unit = "m/s", start = 0, fixed = true);
  parameter Real k(unit = "N/m", min = 0) = 10;
  parameter Real d(unit = "N.s/m", min = 0) = 0.5;
equation
  der(x) = v;
  der(v) = F - k*x - d*v;
end Cart;
"""


def cart(name: str, seed: int) -> Recording:
    """One run with the position read through a lag, by the matrix exponential; its last part starts in motion."""
    rng = np.random.default_rng(seed)
    system = np.zeros((4, 4))
    system[0, 1] = 1.0
    system[1] = [-13.0, -0.4, 0.0, 1.0]
    system[2] = [20.0, 0.0, -20.0, 0.0]
    forward = expm(0.02 * system)
    force = np.repeat(rng.normal(0.0, 3.0, 100), 15)
    z = np.zeros((force.size, 4))
    z[0] = [0.1, 0.0, 0.1, force[0]]
    for k in range(force.size - 1):
        z[k + 1] = forward @ z[k]
        z[k + 1, 3] = force[k + 1]
    x, v = z[:, 2] + rng.normal(0.0, 2e-3, force.size), z[:, 1] + rng.normal(0.0, 1e-2, force.size)
    rows = slice(0, 1000) if name == "a" else slice(1000, None)
    return Recording(name, 0.02 * np.arange(force[rows].size), {"F": force[rows]}, {"x": x[rows], "v": v[rows]})


TANK = """model Tank "A tank that runs out through a hole, its level is read"
  input Real q(unit = "m3/s");
  output Real h(unit = "m", start = 2, min = 0, fixed = true);
  parameter Real A(unit = "m2", min = 0) = 1;
  parameter Real c(min = 0) = 0.4;
equation
  A*der(h) = q - c*sqrt(h);
end Tank;
"""


def tank(name: str, seed: int) -> Recording:
    """A sensor that is off by 250 times its noise from the first reading on: the level starts where none says."""
    rng = np.random.default_rng(seed)
    inflow = np.repeat(rng.uniform(0.35, 0.8, 40), 20)
    level = held(lambda h, q: (q - 0.45 * np.sqrt(h)) / 1.3, 1.6 if name == "a" else 2.4, inflow, 0.5, 10)
    return Recording(name, 0.5 * np.arange(800), {"q": inflow}, {"h": level + 0.5 + rng.normal(0.0, 2e-3, 800)})


ROOM = """model Room
  parameter Real C_a(unit = "J/K", min = 0) = 8e5;
  parameter Real C_w(unit = "J/K", min = 0) = 8e6;
  parameter Real R_a(unit = "K/W", min = 0) = 0.005;
  input Real Q(unit = "W");
  output Real T(unit = "K", start = 0, fixed = true);
  Real T_w(unit = "K", start = 0, fixed = true);
equation
  C_a*der(T) = Q - (T - T_w)/R_a;
  C_w*der(T_w) = (T - T_w)/R_a - T_w/0.012;
end Room;
"""


def room(name: str, seed: int) -> Recording:
    """Above the outside: air at 0, and a wall that is warmer by 2 K, on the other day by 1 K."""
    heat = np.repeat(np.random.default_rng(seed).uniform(0.0, 2000.0, 40), 10)

    def slope(x, q):
        through = (x[0] - x[1]) / 0.004
        return np.array([(q - through) / 1e6, (through - x[1] / 0.012) / 1e7])

    read = held(slope, np.array([0.0, 2.0 if name == "a" else 1.0]), heat, 120.0, 8)[:, 0]
    return Recording(name, 120.0 * np.arange(heat.size), {"Q": heat}, {"T": read + 0.02 * noise(seed, heat.size)})


OSCILLATOR = """model Oscillator
  parameter Real k(unit = "N/m", min = 0) = 30;
  parameter Real c(unit = "N.s/m", min = 0) = 1;
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = F - k * x - c * v;
end Oscillator;
"""


def oscillator(name: str, seed: int) -> Recording:
    """A spring with a cubic part, in 12,000 rows: searched on a beginning."""
    rng, time, waves = np.random.default_rng(seed), 0.02 * np.arange(12_000), 2 * np.pi * np.arange(0.2, 2.0, 0.1)
    force = 1.5 * np.cos(waves[:, None] * time + rng.uniform(0, 2 * np.pi, waves.size)[:, None]).sum(axis=0)
    motion = held(lambda y, f: np.array([y[1], f - 40 * y[0] - 300 * y[0] ** 3 - y[1]]), np.zeros(2), force, 0.02, 4)
    return Recording(name, time, {"F": force}, {"x": motion[:, 0] + 1e-4 * rng.normal(size=time.size)})


RIGS = {
    "geared": Rig(
        GEARED, geared, (1, 2), ("J", "d"),
        ("coulomb_friction", "load_friction", "viscous_friction", "quadratic_drag", "gain", "curve"),
        "load_friction@w", output="w", after=0.25, most=3,
    ),
    "meter": Rig(
        METER, meter, (67, 68), ("T", "K"),
        ("saturation", "saturation_by_side", "gain", "overflow", "square_loss", "dead_zone"), "saturation_by_side@y",
        ((lambda p: 1.0 / (p[0] * (1.0 + p[1])), 1.5, 0.015),), output="y", before=1.5 * 0.01, after=1.1 * 0.01,
    ),
    "motor": Rig(
        MOTOR, motor, (71, 72), ("T", "k"), ("unsigned", "gain", "offset", "dead_zone", "coulomb_friction"),
        "unsigned@output_w", ((first, 1.0, 0.01),), {"k": (1.4, 0.01), "T": (0.2, 0.02)}, "w", 1.0, 1.1 * 0.02,
    ),
    "body": Rig(
        BODY, body, (91, 92), ("d",), ("offset", "viscous_friction", "end_stop", "gain", "lag", "delay"), "offset@v",
        ((lambda p: abs(p[0]), 0.2943, 0.006),),
    ),
    "culture": Rig(
        CULTURE, culture, (41, 42), ("r", "y"), ("square_loss", "overflow", "saturation", "offset"), "square_loss@x",
        ((first, 1e-5, 3e-7),), {"r": (2e-4, 0.03)}, "x", 20.0 * 0.1, 1.3 * 0.1, 3, "estimated",
    ),
    "spring": Rig(
        SPRING, spring, (1, 2), ("m", "c", "k"), ("cubic_stiffness", "end_stop"), "cubic_stiffness@v", (),
        {"m": (2.0, 1e-2), "c": (10.0, 1e-2), "k": (5e4, 1e-2)}, "y", 100.0 * 1e-6, most=1, start="estimated",
    ),
    "cart": Rig(
        CART, cart, (7, 7), ("k", "d"), ("lag", "gain", "coulomb_friction"), "lag@x", ((first, 0.05, 5e-3),),
        output="v", after=2.0 * 1e-2, most=1,
    ),
    "tank": Rig(
        TANK, tank, (11, 12), ("A", "c"), ("offset", "gain"), "offset@output_h", ((first, 0.5, 0.01),),
        output="h", after=1.3 * 2e-3, most=1, start="estimated",
    ),
    "room": Rig(
        ROOM, room, (11, 12), ("C_a", "C_w", "R_a"), (), "start@T_w", ((first, 2.0, 0.05),), {"C_w": (1e7, 0.03)}, "T",
        after=1.2 * 0.02, effects=("start@T_w", "offset", "gain", "linear_loss"),
    ),
    "oscillator": Rig(
        OSCILLATOR, oscillator, (7, 8), ("k", "c"), ("cubic_stiffness", "linear_stiffness", "viscous_friction", "gain"),
        "cubic_stiffness@v", ((first, 300.0, 3.0),), most=1,
    ),
}  # fmt: skip
