"""How well the first model of a rig can fit at best: least squares that share no code with the library.

The equations of each first model are written here again, by hand (:data:`RIGS`). Linear ones are stepped exactly from
sample to sample, with the input held or a straight line between its samples, whichever fits better; the others by
:mod:`rig_motions`. Parameters are positive and searched by their logarithms from several starts, together with the
initial states of each recording. A start that is free may imitate what the model lacks; so the same is done with the
states that an output shows starting at its first reading.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rig_motions import (
    aero,
    both_tanks,
    cart_and_pendulum,
    coasting_car,
    falling_ball,
    growing_culture,
    hot_end,
    linear,
    tanks,
    two_dof,
    viscous_damper,
)

FloatArray = NDArray[np.float64]
#: Parameters by name, initial state (states,), time (n,), inputs (n, inputs), whether these are straight between
#: samples -> outputs (n, outputs).
Motion = Callable[[dict[str, float], FloatArray, FloatArray, FloatArray, bool], FloatArray]
#: Share of a recording that is fitted where there is no other to judge on.
FITTED = 0.7
#: Standard deviation of the logarithm of a start over its nominal value, and how far the search may go from that.
SPREAD, SEARCH_RANGE = 0.7, 5.0
#: A residual that no model should leave, in standard deviations of the readings: what cannot be simulated gets it.
LARGEST_RESIDUAL = 1e3
#: Differences by which slopes are taken: of logarithms of parameters, and of initial states over their steps.
STEP = 1e-4
#: Of how many readings one is kept for the starts, how many of these go on with all, and how often weights are renewed.
THINNING, KEPT_STARTS, MAX_REWEIGHTINGS = 20, 2, 8
#: Readings of a recording that stay at least, where it has as many.
MIN_READINGS = 50


@dataclass(frozen=True)
class FirstModel:
    """A first model, written by hand, and how it is fitted.

    Parameters
    ----------
    motion : callable
    inputs, outputs : tuple of str
        Columns of the recordings.
    start : mapping of str to float
        Nominal values of the parameters that are fitted.
    steps : tuple of float
        Steps of the search for the initial states; a state of step 0 stays where it begins.
    begin : callable
        First readings (outputs,) -> initial state.
    shown : tuple of int
        States that outputs show.
    delayed : bool
        Whether the inputs may act late, by up to 0.02 s.
    held : bool
        Whether the inputs are known to hold between samples.
    starts : int
    limits : mapping of str to (float, float)
        Bounds of parameters that are known closer than by a factor.
    """

    motion: Motion
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    start: dict[str, float]
    steps: tuple[float, ...]
    begin: Callable[[FloatArray], Sequence[float]]
    shown: tuple[int, ...] = (0,)
    delayed: bool = False
    held: bool = False
    starts: int = 6
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Readings:
    """One recording: time (n,), inputs (n, inputs), outputs (n, outputs)."""

    time: FloatArray
    inputs: FloatArray
    outputs: FloatArray


@dataclass(frozen=True, eq=False)
class _LocalFit:
    """Where a search ended: mean logarithm of the RMS by output, point, RMS by output."""

    loss: float
    point: FloatArray
    left: FloatArray


def read(path: Path, rig: FirstModel, whole: bool) -> Readings:
    """Read a recording, or its fitted part."""
    with path.open(encoding="utf-8", newline="") as lines:
        rows = csv.reader(lines)
        columns = [name.strip() for name in next(rows)]
        table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    moment = table[:, columns.index("time")]
    keep = moment <= (np.inf if whole else moment[0] + FITTED * (moment[-1] - moment[0]))
    inputs, outputs = (
        table[np.ix_(keep, [columns.index(name) for name in names])] for names in (rig.inputs, rig.outputs)
    )
    return Readings(moment[keep], inputs, outputs)


def residuals_of(name: str, paths: Sequence[Path], whole: bool) -> dict[str, Any]:
    """Fit a first model, with the start ``free`` and ``as_read``.

    Each has ``rms`` by output over all recordings, parameters, and whether inputs go straight between samples.

    Parameters
    ----------
    name : str
        One of :data:`RIGS`.
    paths : sequence of Path
        Recordings that are fitted.
    whole : bool
        Whether all of each is fitted, or its first 70 %.
    """
    rig = RIGS[name]
    began = time.perf_counter()
    recordings = [read(path, rig, whole) for path in paths]
    as_read = replace(rig, steps=tuple(0.0 if k in rig.shown else step for k, step in enumerate(rig.steps)))
    found = {
        name: min(
            (_fit(one, recordings, straight) for straight in ((False,) if rig.held else (False, True))),
            key=lambda fit: fit["loss"],
        )
        for name, one in {"as_read": as_read, "free": rig}.items()
        if name == "as_read" or as_read != rig
    }
    found.setdefault("free", found["as_read"])
    return {**found, "seconds": round(time.perf_counter() - began, 1)}


def _fit(rig: FirstModel, recordings: Sequence[Readings], straight: bool) -> dict[str, Any]:
    """Return the best of several starts; outputs weigh by the inverse of what is left of each (most likely noise).

    The first fits use fewer readings where the inputs rarely change; the best go on with all of them.
    """
    rng = np.random.default_rng(36)
    scale = np.nanstd(np.concatenate([r.outputs for r in recordings]), axis=0)
    few = [_thinned(recording) for recording in recordings]
    points = [_start(rig, recordings, rng, number) for number in range(rig.starts)]
    fits = [_local_fit(rig, few, straight, point, scale, scale, MAX_REWEIGHTINGS // 2) for point in points]
    fits = sorted(fits, key=lambda one: one.loss)[:KEPT_STARTS]
    fits = [_local_fit(rig, recordings, straight, one.point, one.left, scale, MAX_REWEIGHTINGS) for one in fits]
    best = min(fits, key=lambda one: one.loss)
    return {
        "rms": dict(zip(rig.outputs, best.left.tolist(), strict=True)),
        "parameters": dict(zip(rig.start, np.exp(best.point[: len(rig.start)]).tolist(), strict=True)),
        "straight": straight,
        "loss": best.loss,
    }


def _thinned(recording: Readings) -> Readings:
    """Return every so many readings, and those about each change of an input."""
    changes = np.any(np.diff(recording.inputs, axis=0) != 0.0, axis=1)
    every = int(np.clip(recording.time.size // MIN_READINGS, 1, THINNING))
    keep = np.arange(recording.time.size) % every == 0
    keep[:-1] |= changes
    keep[1:] |= changes
    return Readings(recording.time[keep], recording.inputs[keep], recording.outputs[keep])


def _start(rig: FirstModel, recordings: Sequence[Readings], rng: np.random.Generator, number: int) -> FloatArray:
    """Return the nominal point, then points about it.

    Logarithms of parameters, delay, initial states over their steps.
    """
    spread = SPREAD * rng.standard_normal(len(rig.start)) * (number > 0)
    delays = np.full(int(rig.delayed), 0.006)
    states = np.zeros(len(recordings) * np.count_nonzero(rig.steps))
    return np.concatenate([np.log(list(rig.start.values())) + spread, delays, states])


def _local_fit(
    rig: FirstModel,
    recordings: Sequence[Readings],
    straight: bool,
    point: FloatArray,
    left: FloatArray,
    scale: FloatArray,
    rounds: int,
) -> _LocalFit:
    """Least squares from a start, with weights that are renewed; ``left`` is the RMS by output to begin with."""
    count = len(rig.start)
    low, high = (np.full(point.size, sign * np.inf) for sign in (-1, 1))
    nominal = np.log(list(rig.start.values()))
    low[:count], high[:count] = nominal - SEARCH_RANGE, nominal + SEARCH_RANGE
    for k, name in enumerate(rig.start):
        if name in rig.limits:
            low[k], high[k] = np.log(rig.limits[name])
    spans = np.ones(point.size)
    if rig.delayed:
        low[count], high[count], spans[count] = 0.0, 0.02, 0.01
    loss = np.inf
    seen = sum(np.isfinite(recording.outputs).sum(axis=0) for recording in recordings)
    for _ in range(rounds if len(rig.outputs) > 1 else 1):
        weights = np.maximum(left, 1e-6 * scale)
        misfit = lambda x, weights=weights: _misfit(rig, recordings, straight, x, weights)  # noqa: E731
        slopes = lambda x, misfit=misfit: _slopes(misfit, x, STEP * spans)  # noqa: E731
        point = np.clip(point, low, high)
        point = least_squares(misfit, point, slopes, (low, high), x_scale=spans, ftol=1e-7, max_nfev=60).x
        squares = np.sum(misfit(point).reshape(-1, len(rig.outputs)) ** 2, axis=0)
        left = np.sqrt(squares / seen) * weights
        before, loss = loss, float(np.mean(np.log(left)))
        if before - loss < 1e-4:
            break
    return _LocalFit(loss, point, left)


def _slopes(misfit: Callable[[FloatArray], FloatArray], point: FloatArray, steps: FloatArray) -> FloatArray:
    """Slopes of the residuals by differences wide enough for what a solver's tolerance leaves undetermined."""
    here = misfit(point)
    return np.column_stack(
        [(misfit(point + step * axis) - here) / step for step, axis in zip(steps, np.eye(point.size), strict=True)]
    )


def _misfit(
    rig: FirstModel, recordings: Sequence[Readings], straight: bool, point: FloatArray, weights: FloatArray
) -> FloatArray:
    """Residuals over weights, (rows * outputs,), reading by reading; 0 in gaps."""
    count = len(rig.start)
    parameters = dict(zip(rig.start, np.exp(point[:count]), strict=True))
    if rig.delayed:
        parameters["delay"] = float(point[count])
        count += 1
    steps = np.array(rig.steps)
    changes = point[count:].reshape(len(recordings), -1)
    found = []
    for recording, change in zip(recordings, changes, strict=True):
        state = np.array(rig.begin(recording.outputs[0]), dtype=np.float64)
        state[steps > 0.0] += steps[steps > 0.0] * change
        with np.errstate(all="ignore"):
            outputs = rig.motion(parameters, state, recording.time, recording.inputs, straight)
        found.append(
            np.nan_to_num(
                (outputs - recording.outputs) / weights, nan=0.0, posinf=LARGEST_RESIDUAL, neginf=-LARGEST_RESIDUAL
            )
        )
        if not np.isfinite(outputs).all():
            found[-1][~np.isfinite(outputs)] = LARGEST_RESIDUAL
    return np.clip(np.concatenate(found), -LARGEST_RESIDUAL, LARGEST_RESIDUAL).ravel()


def _emps(p: dict[str, float]) -> tuple[Any, ...]:
    return [[0, 1], [0, -p["F_v"] / p["M"]]], [[0], [1 / p["M"]]], [[1, 0]], [[0]], [0]


def _oscillator(p: dict[str, float]) -> tuple[Any, ...]:
    return [[0, 1], [-p["a"] / p["m"], -p["d"] / p["m"]]], [[0], [1 / p["m"]]], [[1, 0]], [[0]], [0]


def _coil(p: dict[str, float]) -> tuple[Any, ...]:
    return [[-p["R"] / p["L"]]], [[1 / p["L"]]], [[1]], [[0]], [0]


def _servo(p: dict[str, float]) -> tuple[Any, ...]:
    return [[-1 / p["T"]]], [[1 / p["T"]]], [[1]], [[0]], [0]


def _cell(p: dict[str, float]) -> tuple[Any, ...]:
    return [[0]], [[1]], [[-p["k"]]], [[-p["R"]]], [p["E_0"]]


def _drive(p: dict[str, float]) -> tuple[Any, ...]:
    inertia = 0.05
    return [[0, 1], [-p["c"] / inertia, -p["D"] / inertia]], [[0], [p["k_m"] / inertia]], [[1, 0]], [[0]], [0]


def _servo_motors(p: dict[str, float]) -> tuple[Any, ...]:
    return [[-p["B"] / p["J"]]], [[1 / p["J"]]], [[1]], [[0]], [0]


def _heaters(p: dict[str, float]) -> tuple[Any, ...]:
    capacity = 5.0
    cooling, first, second = (p[name] / capacity for name in ("U", "a1", "a2"))
    return (
        [[-cooling, 0], [0, -cooling]],
        [[first, 0, cooling], [0, second, cooling]],
        [[1, 0], [0, 1]],
        [[0, 0, 0], [0, 0, 0]],
        [0, 0],
    )


def _coupled_drives(p: dict[str, float]) -> tuple[Any, ...]:
    square = p["w0"] ** 2
    motion = [[-1 / p["T"], 0, 0], [0, 0, 1], [square, -square, -2 * p["zeta"] * p["w0"]]]
    return motion, [[p["K"] / p["T"]], [0], [0]], [[0, 1, 0]], [[0]], [0]


_MOTOR = {"R_a": 8.4, "c_m": 0.042, "J_r": 1.1e-5, "k_d": 1e-7, "k_t": 1.2e-6, "D_p": 0.0071, "K_sp": 0.0375}
_FREE = {
    "c_m": 0.042, "J_r": 1e-5, "k_d": 1e-7, "k_dt": 1e-7, "k_t": 1.2e-6, "k_tt": 1.2e-6, "D_p": 0.0071,
    "K_sp": 0.0375, "J_y": 0.022, "D_y": 0.01,
}  # fmt: skip
#: First models by the name of their folder.
RIGS = {
    "emps": FirstModel(linear(_emps), ("u",), ("q",), {"M": 100.0, "F_v": 150.0}, (1e-2, 1e-2), lambda y: (y[0], 0.0)),
    "silverbox": FirstModel(
        linear(_oscillator), ("u",), ("y",), {"m": 6e-6, "d": 3e-4, "a": 1.0}, (0.1, 10.0), lambda y: (y[0], 0.0)
    ),
    "coil": FirstModel(linear(_coil), ("u",), ("i",), {"L": 0.2, "R": 10.0}, (0.1,), lambda y: (y[0],), held=True),
    "servo": FirstModel(linear(_servo), ("command",), ("angle",), {"T": 0.1}, (0.1,), lambda y: (y[0],), held=True),
    "battery": FirstModel(
        linear(_cell), ("i",), ("v",), {"E_0": 3.3, "k": 1e-5, "R": 0.01}, (0.0,), lambda y: (0.0,)
    ),
    "play": FirstModel(
        linear(_drive), ("u",), ("angle",), {"k_m": 1.0, "D": 0.2, "c": 20.0}, (0.01, 0.1), lambda y: (y[0], 0.0),
        held=True,
    ),
    "tanks": FirstModel(
        tanks, ("u",), ("y",), {"k1": 0.05, "k2": 0.05, "k3": 0.05, "k4": 0.05}, (1.0, 1.0), lambda y: (y[0], y[0]),
        shown=(1,),
    ),
    "cartpendulum": FirstModel(
        cart_and_pendulum, ("v",), ("z", "phi"), {"b": 5.0, "a": 10.0, "l": 4.0, "w2": 40.0, "c": 0.05},
        (0.01, 0.1, 0.1, 0.5), lambda y: (y[0], 0.0, y[1], 0.0), shown=(0, 2),
    ),
    "motor": FirstModel(
        linear(_servo_motors), ("tau",), ("w",), {"J": 3e-4, "B": 1e-4}, (10.0,), lambda y: (y[0],), held=True
    ),
    "tclab": FirstModel(
        linear(_heaters), ("Q1", "Q2", "T_a"), ("T1", "T2"), {"a1": 0.01, "a2": 0.005, "U": 0.04}, (1.0, 1.0),
        lambda y: (y[0], y[1]), shown=(0, 1), held=True,
    ),
    "tank2006": FirstModel(
        both_tanks, ("u",), ("y1", "y2"), {"k1": 0.05, "k2": 0.05, "k3": 0.1, "k4": 0.05}, (1.0, 1.0),
        lambda y: (y[0], y[1]), shown=(0, 1), held=True,
    ),
    "drives": FirstModel(
        linear(_coupled_drives), ("u",), ("y",), {"T": 0.2, "K": 2.0, "w0": 15.0, "zeta": 0.3}, (1.0, 1.0, 10.0),
        lambda y: (0.0, y[0], 0.0), shown=(1,), held=True,
    ),
    "whiffle": FirstModel(
        falling_ball, (), ("height",), {"g": 9.81}, (1.0, 1.0), lambda y: (y[0], 0.0), limits={"g": (9.79, 9.82)}
    ),
    "paramecium": FirstModel(growing_culture, (), ("count",), {"r": 1e-5}, (1.0,), lambda y: (y[0],)),
    "damper": FirstModel(
        viscous_damper, ("x", "v"), ("F",), {"c": 200.0, "k": 200.0, "F_0": 50.0}, (), lambda _: (), shown=()
    ),
    "hotend": FirstModel(
        hot_end, ("u",), ("T",), {"C": 10.0, "G": 0.1, "T_a": 25.0}, (1.0,), lambda y: (y[0],), held=True,
        limits={"T_a": (15.0, 40.0)},
    ),
    "coastdown": FirstModel(coasting_car, (), ("speed",), {"C_A": 1.0}, (1.0,), lambda y: (y[0],)),
    "aero_step": FirstModel(
        aero(2), ("V_m",), ("i_m", "omega_m", "theta"), _MOTOR, (0.0,) * 4, lambda y: (0.0, 0.0, y[2], 0.0),
        delayed=True, held=True, starts=12,
    ),
    "aero_pulse": FirstModel(
        aero(1), ("V_m",), ("theta",), _MOTOR, (0.0,) * 4, lambda y: (0.0, 0.0, y[0], 0.0),
        delayed=True, held=True, starts=12,
    ),
    "aero_2dof": FirstModel(
        two_dof, ("V_m", "V_t"), ("omega_m", "omega_t", "theta", "psi"), _FREE, (0, 0, 0, 0, 0.01, 0.1, 0.1, 0.1),
        lambda y: (0.0, y[0], 0.0, y[1], y[2], 0.0, y[3], 0.0), shown=(1, 3, 4, 6), delayed=True, held=True, starts=2,
    ),
}  # fmt: skip
