"""A simulator of formulas, written for these tests alone: complex-step derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.random import Generator

from aero_bayes.data import Recording
from aero_bayes.estimate import NoiseModel
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import Prior
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Experiment, ParameterTarget, Problem, Trajectories
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable

Formula = Callable[[np.ndarray, np.ndarray], np.ndarray]
State = TypeVar("State", float, np.ndarray)


def model(outputs: Sequence[str], parameters: Sequence[str]) -> Model:
    """A model that exists only on paper."""

    def variables(names: Sequence[str]) -> tuple[Variable, ...]:
        return tuple(Variable(n, "1", n, 1.0, None, None, None, k) for k, n in enumerate(names))

    return Model(
        Path("none.fmu"), "0", "paper", "0", "paper", variables(parameters), (), variables(outputs), (), 0, True, False
    )


def calibration(
    experiments: Sequence[tuple[np.ndarray, np.ndarray]],
    outputs: Sequence[str],
    parameters: Sequence[Parameter],
    noise: NoiseModel | None = None,
) -> Calibration:
    runs = tuple(Experiment(t, tuple(outputs), measured=y) for t, y in experiments)
    data = MeasuredData(runs, tuple(f"run {k}" for k in range(len(runs))))
    found = ParameterSet(tuple(parameters))
    return Calibration(data, model(outputs, found.names), found, noise or NoiseModel("white"))


def fitted(formula: Formula, given: Calibration, settings: FitSettings | None = None, seed: int = 1) -> Fit:
    """A formula fitted to a calibration, by a local search unless the settings say otherwise."""
    chosen, rng = settings or FitSettings(method="local"), np.random.default_rng(seed)
    return fit_calibration(given, lambda problem: FormulaSimulator(problem, formula), chosen, rng)


def runge_kutta(
    slope: Callable[[State, float], State], x: State, inputs: tuple[float, float, float], h: float
) -> State:
    """A state after one classical step of fourth order; ``inputs`` at its beginning, its middle and its end."""
    begin, middle, end = inputs
    a = slope(x, begin)
    b = slope(x + h / 2.0 * a, middle)
    c = slope(x + h / 2.0 * b, middle)
    return x + h / 6.0 * (a + 2.0 * b + 2.0 * c + slope(x + h * c, end))


def held(slope: Callable[[State, float], State], start: object, u: State, interval: float, steps: int) -> State:
    """States at the samples, each input held until the next, by so many Runge-Kutta steps in between."""
    x = np.array(start, dtype=float)
    states = [x]
    for level in u[:-1]:
        for _ in range(steps):
            x = runge_kutta(slope, x, (level, level, level), interval / steps)
        states.append(x)
    return np.array(states)


def square_wave_lag(rng: Generator, gain: float = 1.0, start: float = 0.0, name: str = "run") -> Recording:
    """A recording of the answer of a lag of 4 s to a square wave between plus and minus one, with noise of 0.01."""
    time = np.arange(0.0, 40.0, 0.2)
    u = np.where(np.floor(time / 10.0) % 2 == 0, 1.0, -1.0)
    y = np.full(time.size, start)
    for k in range(1, time.size):
        y[k] = gain * u[k - 1] + (y[k - 1] - gain * u[k - 1]) * np.exp(-0.2 / 4.0)
    return Recording(name, time, {"u": u}, {"y": y + 0.01 * rng.standard_normal(time.size)}, {})


def damped_stops(e: float, v: float, k_s: float, x_s: float, t_s: float) -> float:
    """The force of stops at either end of a range: a spring and a damper beside each other that never pull."""
    above, below = max(e - x_s, 0.0), max(-e - x_s, 0.0)
    return k_s * (max(above + t_s * v * (above > 0), 0.0) - max(below - t_s * v * (below > 0), 0.0))


def parameter(
    name: str, start: float, lower: float, upper: float, prior: Prior, scale: str = "linear", **more: object
) -> Parameter:
    return Parameter(name, "1", start, lower, upper, prior, scale, name, ParameterTarget(name), **more)


class FormulaSimulator:
    """``formula(time, values)`` gives outputs (n, m) and must accept complex values."""

    def __init__(self, problem: Problem, formula: Formula) -> None:
        self.problem, self.formula = problem, formula

    def __enter__(self) -> FormulaSimulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        pass

    def _outputs(self, values: np.ndarray, e: int) -> np.ndarray:
        return np.asarray(self.formula(self.problem.experiments[e].time, values))

    def _slopes(self, values: np.ndarray, e: int, active: Sequence[int]) -> np.ndarray:
        columns = []
        for j in active:
            shifted = values.astype(complex)
            shifted[j] += 1e-30j
            columns.append(self._outputs(shifted, e).imag / 1e-30)
        return np.stack(columns, axis=-1)

    def simulate(self, values: np.ndarray, *, active: Sequence[int] | None = None) -> Trajectories:
        count = range(len(self.problem.experiments))
        outputs = tuple(np.stack([self._outputs(v, e) for v in values]) for e in count)
        slopes = None
        if active is not None:
            slopes = tuple(np.stack([self._slopes(v, e, active) for v in values]) for e in count)
        finite = np.stack([np.isfinite(y).all(axis=(1, 2)) for y in outputs], axis=1)
        return Trajectories(outputs, slopes, np.where(finite, 0, 2).astype(np.uint8))
