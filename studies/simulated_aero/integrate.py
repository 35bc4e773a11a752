"""Integration of a rig: exponential Runge-Kutta steps between exactly located stick and slip events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulated_aero.equations import RigEquations, StateFunction
from simulated_aero.exponential import Block, Matrix, block, phi

FloatArray = NDArray[np.float64]
State = tuple[float, ...]
#: Sign of the brush current, of the rotor's and of the body's motion where friction asks for it; 0 sticks.
Mode = tuple[int, int, int]
#: Halvings of a step until an event counts as located.
MAX_HALVINGS = 24
#: Steps in which the exact part follows a current-dependent voltage, as a share of the winding's resistance.
SLOPE_STEP = 1e-3
#: Jumps of the voltage in V after which steps start small.
MIN_JUMP = 1.0
#: How far current (A), speed (rad/s) and pitch rate (rad/s) may stand on the wrong side of zero before it is an event:
#: rounding at a release is no reversal.
EVENT_TOLERANCE = (1e-10, 1e-8, 1e-11)
#: How long after a jump, in s, steps stay short where the circuit is not linear.
SETTLING_TIME = 0.15
_FROZEN: Matrix = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Coefficients:
    """Exponential Runge-Kutta coefficients of one step length and one set of modes."""

    motor: Block
    body: Block
    extra: tuple[tuple[float, float, float, float, float, float], ...]


class AeroIntegrator:
    """Integrator of one rig under held voltages."""

    def __init__(self, equations: RigEquations) -> None:
        self._equations = equations
        self._cache: dict[tuple[float, Mode, float], _Coefficients] = {}
        self._slope = 0.0
        self._forces = _forces(equations)
        self._levels = tuple(
            _total(laws) for laws in (equations.brush, equations.rotor_friction, equations.pivot_friction)
        )
        p = equations.truth.parameters
        self._inertia = (p.L_a, p.J_r + p.J_s, p.J_p)

    def start(self, theta: float) -> State:
        """Return the state at rest at a pitch angle in rad."""
        return (0.0, 0.0, theta, 0.0, *(extra.start for extra in self._equations.extra))

    def rest_angle(self) -> float:
        """Find the pitch angle in rad at which the undriven body is in balance."""
        theta = 0.0
        stiffness = self._equations.truth.parameters.K_sp
        for _ in range(60):
            state = self.start(theta)
            torque = sum(law(0.0, 0.0, 0.0, theta, 0.0, state[4:]) for law in self._equations.body) - stiffness * theta
            theta += torque / stiffness
        return theta

    def run(self, times: FloatArray, volts: FloatArray, state: State) -> FloatArray:
        """Integrate to ``times`` (increasing, s), shape (n, states); ``volts[k]`` is applied from ``times[k]`` on."""
        out = np.empty((len(times), len(state)))
        out[0] = state
        mode: Mode = (_sign(state[0]), _sign(state[1]), _sign(state[3]))
        t = float(times[0])
        previous, since = 0.0, -np.inf
        for k, applied in enumerate(volts[:-1].tolist()):
            end = float(times[k + 1])
            mode = self._settle(t, state, mode, applied)
            jump = abs(applied - previous) > MIN_JUMP
            since = t if jump else since
            pieces = self._pieces(end - t, jump, t - since < SETTLING_TIME)
            for h in pieces:
                state, mode = self._advance(t, state, mode, applied, h, 0)
                t += h
            previous, t = applied, end
            out[k + 1] = state
        return out

    def _pieces(self, length: float, jump: bool, settling: bool) -> list[float]:
        """Step lengths that fill an interval; graded where a jump excites the armature's fast mode."""
        longest = self._equations.max_step / (8.0 if settling and self._equations.slopes else 1.0)
        count = max(1, int(np.ceil(length / longest - 1e-9)))
        h = round(length / count, 15)
        if not jump:
            return [h] * count
        graded = [h / 128.0] * 2 + [h / 2.0**k for k in range(6, 0, -1)]
        return graded + [h] * (count - 1)

    def _advance(self, t: float, state: State, mode: Mode, v: float, h: float, depth: int) -> tuple[State, Mode]:
        """Take one step, halved until every change of mode is at the end of a piece."""
        new = self._step(t, state, mode, v, h)
        if not self._violates(t + h, new, mode, v):
            return new, mode
        if depth >= MAX_HALVINGS:
            return self._switch(t + h, new, mode, v)
        half = 0.5 * h
        middle, mode = self._advance(t, state, mode, v, half, depth + 1)
        return self._advance(t + half, middle, mode, v, half, depth + 1)

    def _drive(self, which: int, t: float, state: State, v: float) -> float:
        """Return what pushes a variable that is zero: volts, rotor torque, body torque."""
        p = self._equations.truth.parameters
        i, w, th, q = state[:4]
        n_i, n_w, n_q, _ = self._forces(t, i, w, th, q, state[4:], v)
        if which == 0:
            return n_i - p.c_m * w
        if which == 1:
            return n_w + p.c_m * i
        return n_q - p.K_sp * th

    def _level(self, which: int, t: float, state: State) -> float:
        level = self._levels[which]
        return 0.0 if level is None else level(t, state[0], state[1], state[2], state[3], state[4:])

    def _violates(self, t: float, state: State, mode: Mode, v: float) -> bool:
        for which, level in enumerate(self._levels):
            if level is None:
                continue
            if mode[which]:
                if state[(0, 1, 3)[which]] * mode[which] < -EVENT_TOLERANCE[which]:
                    return True
            elif abs(self._drive(which, t, state, v)) > self._level(which, t, state):
                return True
        return False

    def _switch(self, t: float, state: State, mode: Mode, v: float) -> tuple[State, Mode]:
        """Put variables that crossed zero on zero and find out whether they stick."""
        values, modes = list(state), list(mode)
        for which, level in enumerate(self._levels):
            index = (0, 1, 3)[which]
            if level is not None and mode[which] and values[index] * mode[which] < 0.0:
                values[index], modes[which] = 0.0, 0
        state = tuple(values)
        return state, self._settle(t, state, (modes[0], modes[1], modes[2]), v)

    def _settle(self, t: float, state: State, mode: Mode, v: float) -> Mode:
        """Release what sticks and is pushed harder than its friction holds."""
        modes = list(mode)
        for which, level in enumerate(self._levels):
            if level is not None and modes[which] == 0:
                drive = self._drive(which, t, state, v)
                if abs(drive) > self._level(which, t, state):
                    modes[which] = 1 if drive > 0.0 else -1
        return modes[0], modes[1], modes[2]

    def _coefficients(self, mode: Mode, h: float) -> _Coefficients:
        key = (h, mode, self._slope)
        found = self._cache.get(key)
        if found is None:
            if len(self._cache) > 20_000:
                self._cache.clear()
            found = self._cache[key] = self._build(mode, h)
        return found

    def _build(self, mode: Mode, h: float) -> _Coefficients:
        equations, p = self._equations, self._equations.truth.parameters
        inductance, rotor, body = self._inertia
        frozen = [level is not None and mode[which] == 0 for which, level in enumerate(self._levels)]
        motor: Matrix = (
            0.0 if frozen[0] else -(equations.resistance + self._slope) / inductance,
            0.0 if frozen[0] else -p.c_m / inductance,
            0.0 if frozen[1] else p.c_m / rotor,
            0.0 if frozen[1] else -equations.viscous / rotor,
        )
        pitch: Matrix = _FROZEN if frozen[2] else (0.0, 1.0, -p.K_sp / body, -equations.damping / body)
        return _Coefficients(
            block(motor, h), block(pitch, h), tuple(_scalar(extra.rate, h) for extra in equations.extra)
        )

    def _rates(
        self, t: float, i: float, w: float, th: float, q: float, z: tuple[float, ...], v: float, mode: Mode
    ) -> tuple[float, float, float, list[float]]:
        """Return what the exact part leaves: accelerations and the extra states' sources."""
        n_i, n_w, n_q, sources = self._forces(t, i, w, th, q, z, v)
        inductance, rotor, body = self._inertia
        brush, friction, pivot = self._levels
        if brush is not None:
            n_i = n_i - mode[0] * brush(t, i, w, th, q, z) if mode[0] else 0.0
        if friction is not None:
            n_w = n_w - mode[1] * friction(t, i, w, th, q, z) if mode[1] else 0.0
        if pivot is not None:
            n_q = n_q - mode[2] * pivot(t, i, w, th, q, z) if mode[2] else 0.0
        if self._slope and (brush is None or mode[0]):
            n_i += self._slope * i
        return n_i / inductance, n_w / rotor, n_q / body, sources

    def _step(self, t: float, state: State, mode: Mode, v: float, h: float) -> State:
        equations = self._equations
        if equations.slopes:
            grid = SLOPE_STEP * equations.resistance
            self._slope = grid * round(sum(slope(state[0], state[4:]) for slope in equations.slopes) / grid)
        c = self._coefficients(mode, h)
        i, w, th, q = state[:4]
        z = state[4:]
        m, b, extra = c.motor, c.body, c.extra
        middle = t + 0.5 * h

        ni0, nw0, nq0, s0 = self._rates(t, i, w, th, q, z, v, mode)
        hm, sm, hb, sb = m.half, m.stage, b.half, b.stage
        fi, fw = hm[0] * i + hm[1] * w, hm[2] * i + hm[3] * w
        ft, fq = hb[0] * th + hb[1] * q, hb[2] * th + hb[3] * q
        i1, w1 = fi + sm[0] * ni0 + sm[1] * nw0, fw + sm[2] * ni0 + sm[3] * nw0
        t1, q1 = ft + sb[1] * nq0, fq + sb[3] * nq0
        z1 = tuple(e[1] * x + e[2] * s for e, x, s in zip(extra, z, s0, strict=True))

        ni1, nw1, nq1, s1 = self._rates(middle, i1, w1, t1, q1, z1, v, mode)
        i2, w2 = fi + sm[0] * ni1 + sm[1] * nw1, fw + sm[2] * ni1 + sm[3] * nw1
        t2, q2 = ft + sb[1] * nq1, fq + sb[3] * nq1
        z2 = tuple(e[1] * x + e[2] * s for e, x, s in zip(extra, z, s1, strict=True))

        ni2, nw2, nq2, s2 = self._rates(middle, i2, w2, t2, q2, z2, v, mode)
        gi, gw, gq = 2.0 * ni2 - ni0, 2.0 * nw2 - nw0, 2.0 * nq2 - nq0
        i3 = hm[0] * i1 + hm[1] * w1 + sm[0] * gi + sm[1] * gw
        w3 = hm[2] * i1 + hm[3] * w1 + sm[2] * gi + sm[3] * gw
        t3, q3 = hb[0] * t1 + hb[1] * q1 + sb[1] * gq, hb[2] * t1 + hb[3] * q1 + sb[3] * gq
        z3 = tuple(e[1] * x + e[2] * (2.0 * s - r) for e, x, s, r in zip(extra, z1, s2, s0, strict=True))

        ni3, nw3, nq3, s3 = self._rates(t + h, i3, w3, t3, q3, z3, v, mode)
        nim, nwm, nqm = ni1 + ni2, nw1 + nw2, nq1 + nq2
        w0, f1, f2, f3 = m.whole, m.first, m.middle, m.last
        b0, g1, g2, g3 = b.whole, b.first, b.middle, b.last
        z_new = tuple(
            e[0] * x + e[3] * a + e[4] * (p + r) + e[5] * d
            for e, x, a, p, r, d in zip(extra, z, s0, s1, s2, s3, strict=True)
        )
        return (
            w0[0] * i + w0[1] * w + f1[0] * ni0 + f1[1] * nw0 + f2[0] * nim + f2[1] * nwm + f3[0] * ni3 + f3[1] * nw3,
            w0[2] * i + w0[3] * w + f1[2] * ni0 + f1[3] * nw0 + f2[2] * nim + f2[3] * nwm + f3[2] * ni3 + f3[3] * nw3,
            b0[0] * th + b0[1] * q + g1[1] * nq0 + g2[1] * nqm + g3[1] * nq3,
            b0[2] * th + b0[3] * q + g1[3] * nq0 + g2[3] * nqm + g3[3] * nq3,
            *z_new,
        )


def _forces(
    equations: RigEquations,
) -> Callable[[float, float, float, float, float, tuple[float, ...], float], tuple[float, float, float, list[float]]]:
    """Return (volts, rotor torque, body torque, sources) beyond the linear part and the sign laws."""
    p = equations.truth.parameters
    supply, volts, rotor, thrust, body = (
        equations.supply,
        equations.volts,
        equations.rotor,
        equations.thrust,
        equations.body,
    )
    sources = [extra.source for extra in equations.extra]
    k_t, k_d, arm, lag = p.k_t, p.k_d, equations.motors * p.D_t, equations.lag

    def forces(
        t: float, i: float, w: float, th: float, q: float, z: tuple[float, ...], v: float
    ) -> tuple[float, float, float, list[float]]:
        square = w * abs(w)
        torque = -k_d * square
        force = k_t * square
        for factor in supply:
            v *= factor(t)
        for law in volts:
            v += law(t, i, w, th, q, z)
        for law in rotor:
            torque += law(t, i, w, th, q, z)
        for bend in thrust:
            force = bend(force, t, i, w, th, q, z)
        rates = [source(force, t, i, w, th, q, z) for source in sources]
        pitch = arm * (force if lag is None else z[lag])
        for law in body:
            pitch += law(t, i, w, th, q, z)
        return v, torque, pitch, rates

    return forces


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


def _total(laws: list[StateFunction]) -> StateFunction | None:
    if not laws:
        return None
    if len(laws) == 1:
        return laws[0]
    return lambda t, i, w, th, q, z: sum(law(t, i, w, th, q, z) for law in laws)


def _scalar(rate: float, h: float) -> tuple[float, float, float, float, float, float]:
    """Compute propagators and weights of a single state with its own rate."""
    p0, p1, p2, p3 = (value.real for value in phi(complex(rate * h)))
    q0, q1, _, _ = (value.real for value in phi(complex(0.5 * rate * h)))
    return p0, q0, 0.5 * h * q1, h * (p1 - 3.0 * p2 + 4.0 * p3), h * (2.0 * p2 - 4.0 * p3), h * (4.0 * p3 - p2)
