"""How the first models of the rigs move, written by hand for :mod:`rig_references`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]
Parameters = dict[str, float]
#: Relative spread of the intervals below which they count as equal: times are rounded where they are written.
EVEN = 1e-3
#: What stays of the AERO's parameters: inductance, inertia of stator and body, arm.
INDUCTANCE, STATOR, BODY, ARM = 1.16e-3, 4e-6, 0.0219, 0.158
#: Held constants of the car that rolls out: mass in kg, density of the air in kg/m3.
CAR, AIR = 150.0, 1.2


def linear(matrices: Callable[[Parameters], tuple[Any, ...]]) -> Callable[..., FloatArray]:
    """Make the motion of x' = A x + B u, y = C x + D u + e, stepped exactly; ``matrices`` gives A, B, C, D, e."""

    def motion(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
        a, b, c, d, e = (np.array(m, dtype=np.float64) for m in matrices(p))
        intervals = np.diff(time)
        if np.ptp(intervals) < EVEN * intervals.mean():
            states = _even(*_step(a, b, float(intervals.mean()), straight), state, inputs)
        else:
            states = _uneven(a, b, intervals, state, inputs, straight)
        return np.asarray(states @ c.T + inputs @ d.T + e)

    return motion


def _step(a: FloatArray, b: FloatArray, h: float, straight: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute matrices F, G, H of x(t + h) = F x + G u(t) + H (u(t + h) - u(t)); H is 0 where the input holds."""
    n, m = b.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m], block[n : n + m, n + m :] = a, b, np.eye(m) / h
    whole = expm(block * h)
    return whole[:n, :n], whole[:n, n : n + m], whole[:n, n + m :] * straight


def _even(f: FloatArray, g: FloatArray, h: FloatArray, state: FloatArray, inputs: FloatArray) -> FloatArray:
    """Compute states (n, states) at even samples: each mode is a filter of first order."""
    roots, modes = np.linalg.eig(f)
    driven = np.vstack([state, inputs[:-1] @ g.T + np.diff(inputs, axis=0) @ h.T])
    driven = np.linalg.solve(modes, driven.T.astype(np.complex128))
    moved = np.array([lfilter([1.0], [1.0, -root], one) for root, one in zip(roots, driven, strict=True)])
    return np.asarray((modes @ moved).real.T)


def _uneven(
    a: FloatArray, b: FloatArray, intervals: FloatArray, state: FloatArray, inputs: FloatArray, straight: bool
) -> FloatArray:
    kinds, which = np.unique(intervals.round(9), return_inverse=True)
    steps = [_step(a, b, float(h), straight) for h in kinds]
    states = np.empty((inputs.shape[0], state.size))
    states[0] = state
    for k, kind in enumerate(which):
        f, g, h = steps[kind]
        states[k + 1] = f @ states[k] + g @ inputs[k] + h @ (inputs[k + 1] - inputs[k])
    return states


def _runge_kutta(
    slope: Callable[[list[float], float], list[float]],
    state: FloatArray,
    time: FloatArray,
    inputs: FloatArray,
    straight: bool,
    parts: int,
) -> FloatArray:
    """Compute states (n, states) by the classical method of fourth order, ``parts`` steps an interval, of one input."""
    x = [float(value) for value in state]
    u = inputs[:, 0].tolist()
    states = np.empty((time.size, len(x)))
    states[0] = x
    for k, interval in enumerate(np.diff(time).tolist()):
        h = interval / parts
        rise = (u[k + 1] - u[k]) / parts if straight else 0.0
        for part in range(parts):
            u_0 = u[k] + part * rise
            s_1 = slope(x, u_0)
            s_2 = slope([v + 0.5 * h * s for v, s in zip(x, s_1, strict=True)], u_0 + 0.5 * rise)
            s_3 = slope([v + 0.5 * h * s for v, s in zip(x, s_2, strict=True)], u_0 + 0.5 * rise)
            s_4 = slope([v + h * s for v, s in zip(x, s_3, strict=True)], u_0 + rise)
            x = [v + h / 6 * (a + 2 * b + 2 * c + d) for v, a, b, c, d in zip(x, s_1, s_2, s_3, s_4, strict=True)]
        if not all(abs(value) < 1e12 for value in x):
            states[k + 1 :] = np.nan
            break
        states[k + 1] = x
    return states


def tanks(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
    """Simulate two tanks, one above the other: level of the lower one."""
    return both_tanks(p, state, time, inputs, straight)[:, 1:]


def both_tanks(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
    """Simulate two tanks, one above the other: level of either."""
    k1, k2, k3, k4 = (p[name] for name in ("k1", "k2", "k3", "k4"))

    def slope(x: list[float], u: float) -> list[float]:
        upper, lower = (max(level, 0.0) ** 0.5 for level in x)
        return [k3 * u - k1 * upper, k2 * upper - k4 * lower]

    return _runge_kutta(slope, state, time, inputs, straight, 1)


def falling_ball(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
    """Return the height of a ball that falls freely."""
    since = time - time[0]
    return (state[0] + state[1] * since - 0.5 * p["g"] * since**2)[:, np.newaxis]


def growing_culture(
    p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool
) -> FloatArray:
    """Return the individuals of a culture that grows in proportion to them."""
    return np.asarray(state[0] * np.exp(p["r"] * (time - time[0])))[:, np.newaxis]


def coasting_car(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
    """Return the speed of a car that only the air slows down."""
    drag = 0.5 * AIR * p["C_A"] / CAR
    return np.asarray(state[0] / (1.0 + state[0] * drag * (time - time[0])))[:, np.newaxis]


def viscous_damper(
    p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool
) -> FloatArray:
    """Return the force of a damper with stiffness, from displacement and velocity."""
    return np.asarray(p["c"] * inputs[:, 1:] + p["k"] * inputs[:, :1] + p["F_0"])


def hot_end(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
    """Simulate a heated body that gives heat to air of constant temperature."""
    air = np.full((time.size, 1), p["T_a"])
    return linear(_heated_body)(p, state, time, np.hstack([inputs, air]), straight)


def _heated_body(p: Parameters) -> tuple[Any, ...]:
    return [[-p["G"] / p["C"]]], [[1 / p["C"], p["G"] / p["C"]]], [[1]], [[0, 0]], [0]


def cart_and_pendulum(
    p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool
) -> FloatArray:
    """Simulate a cart with a hanging pendulum: position and angle."""
    b, a, l_, w2, c = (p[name] for name in ("b", "a", "l", "w2", "c"))

    def slope(x: list[float], v: float) -> list[float]:
        _, s, q, w = x
        pushed = b * v - a * s
        return [s, pushed, w, l_ * np.cos(q) * pushed - w2 * np.sin(q) - c * w]

    return _runge_kutta(slope, state, time, inputs, straight, 1)[:, [0, 2]]


def _pieces(
    slope: Callable[[FloatArray, FloatArray], list[float]],
    state: FloatArray,
    time: FloatArray,
    inputs: FloatArray,
    delay: float,
) -> FloatArray:
    """Compute states (n, states) of a stiff system, from each change of the held inputs (n, inputs) to the next.

    The inputs act late by ``delay``; until then nothing is driven.
    """
    changes = np.flatnonzero(np.any(np.diff(inputs, axis=0) != 0.0, axis=1)) + 1
    begins = [time[0], *(time[[0, *changes]] + delay), time[-1] + delay + 1e-9]
    levels = [np.zeros(inputs.shape[1]), *inputs[[0, *changes]]]
    states = np.full((time.size, state.size), np.nan)
    for level, begin, end in zip(levels, begins, begins[1:], strict=False):
        inside = (time >= begin) & (time < end)
        if end <= begin:
            continue
        if not np.isfinite(state).all():
            break
        run = solve_ivp(
            lambda _, x, level=level: slope(x, level), (begin, end), state, "LSODA", np.append(time[inside], end),
            rtol=1e-8, atol=1e-10,
        )  # fmt: skip
        if not run.success or run.y.shape[1] <= np.count_nonzero(inside):
            break
        states[inside] = run.y.T[:-1]
        state = run.y[:, -1]
    return states


def aero(thrusters: int) -> Callable[..., FloatArray]:
    """Make the motion of the AERO free in pitch, one motor driven or both: current, speed and pitch, or pitch alone."""

    def motion(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
        inertia, lift = p["J_r"] + STATOR, thrusters * ARM * p["k_t"]

        def slope(x: FloatArray, u: FloatArray) -> list[float]:
            i, w, theta, omega = x.tolist()
            square = w * abs(w)
            return [
                (u[0] - p["R_a"] * i - p["c_m"] * w) / INDUCTANCE,
                (p["c_m"] * i - p["k_d"] * square) / inertia,
                omega,
                (lift * square - p["D_p"] * omega - p["K_sp"] * theta) / BODY,
            ]

        states = _pieces(slope, state, time, inputs, p["delay"])
        return states[:, :3] if thrusters == 2 else states[:, 2:3]

    return motion


def two_dof(p: Parameters, state: FloatArray, time: FloatArray, inputs: FloatArray, straight: bool) -> FloatArray:
    """Simulate the AERO free in pitch and yaw: speeds of main and tail motor, pitch, yaw."""
    resistance, c, inertia = 8.4, p["c_m"], p["J_r"] + STATOR

    def slope(x: FloatArray, u: FloatArray) -> list[float]:
        i_m, w_m, i_t, w_t, theta, omega, _, rate = x.tolist()
        sine, cosine = np.sin(theta), np.cos(theta)
        momentum = inertia * w_m * sine
        pitch = ARM * p["k_t"] * w_m * abs(w_m) + c * i_t - momentum * rate
        yaw = cosine * (ARM * p["k_tt"] * w_t * abs(w_t) - c * i_m) + momentum * omega
        turned = pitch - p["D_p"] * omega - p["K_sp"] * sine - BODY * rate**2 * sine * cosine
        swung = yaw - p["D_y"] * rate + 2.0 * BODY * omega * rate * sine * cosine
        return [
            (u[0] - resistance * i_m - c * w_m) / INDUCTANCE,
            (c * i_m - p["k_d"] * w_m * abs(w_m)) / inertia,
            (u[1] - resistance * i_t - c * w_t) / INDUCTANCE,
            (c * i_t - p["k_dt"] * w_t * abs(w_t)) / inertia,
            omega,
            turned / BODY,
            rate,
            swung / (p["J_y"] - BODY * sine**2),
        ]

    return _pieces(slope, state, time, inputs, p["delay"])[:, [1, 3, 4, 6]]
