"""The contract between a simulator and everything that uses one.

A :class:`Problem` says what to simulate (a model, the experiments, what each column of a parameter matrix means);
a :class:`Simulator` answers with trajectories, sensitivities or reduced likelihoods, and with one typed
:class:`Outcome` for every run. Nothing above this module knows which engine does the work.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from types import TracebackType
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.model_description import ModelDescription

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
    steps of the solver; 0 for no limit of its own."""

    time: FloatArray
    outputs: tuple[str, ...]
    inputs: tuple[InputSignal, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    measured: FloatArray | None = None
    start_sd: Mapping[str, float] = field(default_factory=dict)
    spread: FloatArray | None = None
    most_steps: int = 0
    known: Mapping[str, float] = field(default_factory=dict)

    def at_samples(self, chosen: slice | NDArray[np.int_]) -> Experiment:
        """Return the experiment at some of its sample times, with what was measured there."""
        measured, spread = (None if a is None else a[chosen] for a in (self.measured, self.spread))
        return replace(self, time=np.ascontiguousarray(self.time[chosen]), measured=measured, spread=spread)


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
class InputTarget:
    """A column that is added to one value of an input signal (the ``index``-th of its grid)."""

    input: str
    index: int


@dataclass(frozen=True)
class DiffusionTarget:
    """A column that sets the diffusion of a state, in the state's unit over the square root of a second."""

    state: str


@dataclass(frozen=True)
class ReadingNoiseTarget:
    """A column that sets the standard deviation of an output's white reading noise, where there is process noise."""

    output: str


ProblemTarget = ParameterTarget | StartTarget | DelayTarget | InputTarget | DiffusionTarget | ReadingNoiseTarget


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

    relative_tolerance: float = 1e-6
    absolute_tolerance: float = 1e-6
    max_steps: int = 200_000
    time_limit: float = 10.0


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
class GaussNewton:
    """Whitened least-squares products of a batch, summed over the experiments.

    With r the whitened residual and S its sensitivities: ``cost`` = r'r / 2, shape (n,); ``gradient`` = S'r, shape
    (n, q); ``hessian`` = S'S, shape (n, q, q); ``log_likelihood`` shape (n,) with the noise's log-determinant."""

    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
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

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> Likelihoods:
        """Gaussian log-likelihood of the measurements, reduced inside the engine.

        With process noise it is the filter's; the reading noise is then the problem's own, and ``noise`` counts not."""
        ...

    def gauss_newton(self, values: FloatArray, noise: FloatArray, *, active: Sequence[int]) -> GaussNewton:
        """Least-squares products with respect to the ``active`` columns."""
        ...

    def close(self) -> None:
        """Stop the workers and free the model."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Filter(Simulator, Protocol):
    """A simulator of problems with process noise, whose likelihood is that of an extended Kalman filter."""

    def filter(self, values: FloatArray, *, active: Sequence[int] = ()) -> Filtered:
        """Predictions of the readings, with their slopes by the ``active`` columns."""
        ...

    def filtered_states(self, values: FloatArray) -> tuple[FilteredStates, ...]:
        """Return the states in each recording at one parameter vector (p,); CannotFinishError where a run fails."""
        ...
