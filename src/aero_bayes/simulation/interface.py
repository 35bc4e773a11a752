"""The contract between the simulators and everything that simulates; smoothed states from results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arguments import Positive
from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.model_description import ModelDescription

#: Standard deviations of a normal density on either side of its mean that hold 90 %.
NORMAL_HALF_WIDTH = 1.6448536269514722


Interpolation = Literal["hold", "linear"]


class Outcome(IntEnum):
    """How one simulation ended. Failures are counted, never raised."""

    OK = 0
    SOLVER_FAILED = 1
    NOT_FINITE = 2
    TIMED_OUT = 3
    CRASHED = 4
    MODEL_ERROR = 5
    STATES_SELECTED_ANEW = 6
    NOT_REPEATABLE = 7
    STATES_JUMP = 8
    TOO_SLOW = 9

    @property
    def key(self) -> str:
        """What result.json counts it under."""
        return "completed" if self is Outcome.OK else self.name.lower()

    @property
    def text(self) -> str:
        """What a person reads in a report."""
        return {
            Outcome.OK: "completed",
            Outcome.SOLVER_FAILED: "the solver could not reach the tolerance",
            Outcome.NOT_FINITE: "an output was not a finite number",
            Outcome.TIMED_OUT: "the time limit passed",
            Outcome.CRASHED: "the model's code crashed its worker",
            Outcome.MODEL_ERROR: "the model reported an error",
            Outcome.STATES_SELECTED_ANEW: "the model chose other states while it ran, which is not supported",
            Outcome.NOT_REPEATABLE: "equal runs of the model gave different results",
            Outcome.STATES_JUMP: "a state jumps at an event, over which process noise cannot be followed",
            Outcome.TOO_SLOW: "it needed more steps than it may",
        }[self]


@dataclass(frozen=True)
class InputSignal:
    """One input of the model over time, on a grid of its own."""

    name: str
    time: FloatArray
    values: FloatArray
    interpolation: Interpolation = "hold"


@dataclass(frozen=True)
class Experiment:
    """One run: when outputs are sampled, what drives the model, where it starts, and what was measured.

    ``known`` are parameters of the model that have this value in this run. ``most_steps`` ends a run that needs more
    steps of the solver; 0 for no limit of its own. ``windows`` has, by output that is read as a mean, where
    the interval of each reading begins and ends (n, 2), in s."""

    time: FloatArray
    outputs: tuple[str, ...]
    inputs: tuple[InputSignal, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    measured: FloatArray | None = None
    start_sd: Mapping[str, float] = field(default_factory=dict)
    spread: FloatArray | None = None
    most_steps: int = 0
    known: Mapping[str, float] = field(default_factory=dict)
    recorded_interval: float = 0.0
    windows: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def interval(self) -> float:
        """Median step in s between two samples, of all that were recorded."""
        return self.recorded_interval or (float(np.median(np.diff(self.time))) if self.time.size > 1 else 1.0)

    def at_samples(self, chosen: slice | NDArray[np.int_]) -> Experiment:
        """Return the experiment at some of its sample times, with what was measured there."""
        measured, spread = (None if a is None else a[chosen] for a in (self.measured, self.spread))
        time = np.ascontiguousarray(self.time[chosen])
        windows = {output: own[chosen] for output, own in self.windows.items()}
        return replace(
            self, time=time, measured=measured, spread=spread, recorded_interval=self.interval, windows=windows
        )


@dataclass(frozen=True)
class ParameterTarget:
    """A column that sets a parameter of the model."""

    name: str


@dataclass(frozen=True)
class StartTarget:
    """A column that sets the initial value of a state."""

    state: str


@dataclass(frozen=True)
class DelayTarget:
    """A column that delays an input, or every input, by so many seconds (>= 0): exactly, and by any time."""

    input: str | None = None


@dataclass(frozen=True)
class DiffusionTarget:
    """A column that sets the diffusion of a state, in the state's unit over the square root of a second."""

    state: str


@dataclass(frozen=True)
class ReadingNoiseTarget:
    """A column that sets the standard deviation of an output's white reading noise, where there is process noise."""

    output: str


ProblemTarget = ParameterTarget | StartTarget | DelayTarget | DiffusionTarget | ReadingNoiseTarget


@dataclass(frozen=True)
class ProcessNoise:
    """Process noise of the states, ``dx = f dt + diag(diffusion) dW``, beside the noise of the readings."""

    diffusion: Mapping[str, float] = field(default_factory=dict)
    reading_sd: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SolverSettings:
    """Tolerances and limits of one run.

    ``absolute_tolerance`` is relative to each state's nominal value. ``time_limit`` is in s of
    computing time a run."""

    relative_tolerance: Positive = 1e-6
    absolute_tolerance: Positive = 1e-6
    max_steps: int = 200_000
    time_limit: Positive = 10.0


@dataclass(frozen=True)
class Problem:
    """What a simulator is asked to run, over and over, with other numbers."""

    model: ModelDescription
    experiments: tuple[Experiment, ...]
    targets: tuple[tuple[ProblemTarget | None, ...], ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    settings: SolverSettings = SolverSettings()
    process: ProcessNoise | None = None


@dataclass(frozen=True)
class Trajectories:
    """Sampled outputs of a batch.

    ``outputs[e]`` has shape (n, n_time_e, m_e); ``sensitivities[e]`` (n, n_time_e, m_e, p) or is None;
    ``outcomes`` has shape (n, E) and holds :class:`Outcome` codes. Failed runs hold NaN.
    ``steps`` (n, E) are those that the solver took, where the engine counts them."""

    outputs: tuple[FloatArray, ...]
    sensitivities: tuple[FloatArray, ...] | None
    outcomes: NDArray[np.uint8]
    steps: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class Likelihoods:
    """Reduced result of a batch: shape (n, E) each.

    ``log_likelihood`` is minus infinity where the run failed."""

    log_likelihood: FloatArray
    outcomes: NDArray[np.uint8]


@dataclass(frozen=True)
class Filtered:
    """What a filter predicts of each reading from all before it, and how far it trusts that.

    ``predicted[e]`` and ``variance[e]`` have shape (n, n_time_e, m_e); their ``..._slopes[e]`` by the q active columns
    (n, n_time_e, m_e, q). Outputs that are read at the same time count as read one after the other."""

    predicted: tuple[FloatArray, ...]
    variance: tuple[FloatArray, ...]
    predicted_slopes: tuple[FloatArray, ...]
    variance_slopes: tuple[FloatArray, ...]
    outcomes: NDArray[np.uint8]


@dataclass(frozen=True)
class FilteredStates:
    """A filter's states before each sample of one recording is read: what a smoother needs."""

    mean: FloatArray
    covariance: FloatArray
    transition: FloatArray
    slopes: FloatArray
    predicted: FloatArray
    variance: FloatArray


class Simulator(Protocol):
    """Runs a :class:`Problem`.

    ``values`` always has shape (n, p), one parameter vector a row, in SI units."""

    problem: Problem

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories; with ``active`` also sensitivities to those columns."""
        ...

    def close(self) -> None:
        """Stop the workers and free the model."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...


@dataclass(frozen=True, eq=False)
class SmoothedStates:
    """Mean and standard deviation (n, s) of the s states at each sample, given all readings of the recording."""

    mean: FloatArray
    sd: FloatArray

    @property
    def band(self) -> tuple[FloatArray, FloatArray]:
        """Ends (n, s) of the central intervals of 90 %."""
        return self.mean - NORMAL_HALF_WIDTH * self.sd, self.mean + NORMAL_HALF_WIDTH * self.sd

    def at(self, time: FloatArray, samples: FloatArray) -> SmoothedStates:
        """Return the states at times (k,) in s, along straight lines between the ``samples`` (n,).

        NaN outside of them."""
        mean, sd = (
            np.column_stack([np.interp(time, samples, row, np.nan, np.nan) for row in rows.T])
            for rows in (self.mean, self.sd)
        )
        return SmoothedStates(mean, sd)


def smooth(filtered: FilteredStates, measured: FloatArray) -> SmoothedStates:
    """Return the states given all readings, from what a filter knew before each of them.

    The modified Bryson-Frazier form of the Rauch-Tung-Striebel smoother (Bierman, 1973, International Journal of
    Control 18, 65): no covariance is inverted, so that states without any uncertainty are no exception."""
    n, s = filtered.mean.shape
    mean, sd = np.empty((n, s)), np.empty((n, s))
    adjoint, information = np.zeros(s), np.zeros((s, s))
    for k in range(n - 1, -1, -1):
        covariance = filtered.covariance[k]
        for h, gain, away, variance in reversed(reading_updates(filtered, measured, k)):
            keep = np.eye(s) - np.outer(gain, h)
            adjoint = keep.T @ adjoint - h * (away / variance)
            information = keep.T @ information @ keep + np.outer(h, h) / variance
        mean[k] = filtered.mean[k] - covariance @ adjoint
        sd[k] = np.sqrt(np.maximum(np.diag(covariance - covariance @ information @ covariance), 0.0))
        step = filtered.transition[k]
        adjoint, information = step.T @ adjoint, step.T @ information @ step
    return SmoothedStates(mean, sd)


def reading_updates(
    filtered: FilteredStates, measured: FloatArray, k: int
) -> list[tuple[FloatArray, FloatArray, float, float]]:
    """Slope, gain, innovation and its variance of each reading of a sample, in the order in which they were taken."""
    covariance, found = filtered.covariance[k], []
    for o in np.flatnonzero(np.isfinite(measured[k])):
        h, variance = filtered.slopes[k, o], float(filtered.variance[k, o])
        gain = covariance @ h / variance
        covariance = covariance - np.outer(gain, gain) * variance
        found.append((h, gain, float(measured[k, o] - filtered.predicted[k, o]), variance))
    return found


class ClosedAtExit:
    """A context manager that closes itself."""

    def close(self) -> None:
        """Give back what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
