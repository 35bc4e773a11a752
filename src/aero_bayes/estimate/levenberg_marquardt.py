"""Bounded Levenberg-Marquardt search, the stages of a fit, and its settings.

A delay that moves a jump of the input across a sample changes that reading at once, so that the likelihood has a kink
there. A gradient taken on one side of a kink says nothing about the other side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Generic, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arguments import Count, Positive
from aero_bayes.arrays import FloatArray
from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.calibrated_model import ListedValue
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.interface import DelayTarget


class Stop(Enum):
    """Why a local search ended; the value is the text that a person reads."""

    CONVERGED = "converged: no step inside the bounds would lower the cost noticeably"
    SMALL_STEP = "converged: the steps became smaller than the tolerance"
    KNOWN_OPTIMUM = "given up: it was converging to an optimum that is already known"
    NO_PROGRESS = "no step lowered the cost although the model of it promised one"
    ITERATION_LIMIT = "the iteration limit was reached"
    INTERRUPTED = "interrupted: the best values so far, which have not converged"
    FAILED_START = "the simulation failed at the starting point"

    @property
    def converged(self) -> bool:
        return self in (Stop.CONVERGED, Stop.SMALL_STEP)


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """Second-order model of a cost about one point: its value, gradient (p,) and Hessian (p, p)."""

    cost: float
    gradient: FloatArray
    hessian: FloatArray

    @property
    def unit(self) -> float:
        """The unit in which decreases of the cost are compared with tolerances."""
        return 1.0

    def predicted_decrease(self, step: FloatArray) -> float:
        """Compute the decrease of the cost that the model predicts for a step (p,)."""
        return -float(self.gradient @ step + 0.5 * step @ self.hessian @ step)


Quadratic = TypeVar("Quadratic", bound=QuadraticModel)


class CostFunction(Protocol[Quadratic]):
    """The cost that a search minimises; a user's own objective has these two methods."""

    def evaluate(self, point: FloatArray) -> Quadratic | None:
        """Return the quadratic model of the cost at a point (p,); None where the cost cannot be evaluated."""
        ...

    def update_noise(self, here: Quadratic) -> Quadratic:
        """Return the model at the same point with new noise, at no higher cost; ``here`` itself if nothing changes."""
        ...


@dataclass(frozen=True)
class FixedCost:
    """A cost function without noise to estimate, given by a function of the point."""

    function: Callable[[FloatArray], QuadraticModel | None]

    def evaluate(self, point: FloatArray) -> QuadraticModel | None:
        return self.function(point)

    def update_noise(self, here: QuadraticModel) -> QuadraticModel:
        return here


@dataclass(frozen=True)
class LocalSettings:
    """When a local search stops."""

    iterations: Count = 60
    tolerance: Positive = 1e-7
    relative_tolerance: float = 1e-13
    step_tolerance: float = 1e-11
    damping: float = 1e-3
    min_noise_gain: float = 0.02
    max_rejections: int = 60
    min_decrease: float = 0.0


@dataclass(frozen=True, eq=False)
class LocalResult(Generic[Quadratic]):
    """Where a search ended: the point (p,) and the quadratic model there (None if the start could not be evaluated)."""

    point: FloatArray
    quadratic: Quadratic | None
    iterations: int
    reason: Stop
    evaluations: int

    @property
    def cost(self) -> float:
        return self.quadratic.cost if self.quadratic is not None else float("inf")


def bounded_step(hessian: FloatArray, gradient: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Minimise ``g'd + d'Hd/2`` over ``low <= d <= high``.

    By a primal active-set method (Nocedal and Wright, 2006, Numerical Optimization, section 16.5): a Newton step over
    the free coordinates ends at the first bound that it meets, which becomes active."""
    p = gradient.size
    step = np.zeros(p)
    pinned = low == high
    step[pinned] = low[pinned]
    fixed = pinned | ((low >= 0.0) & (gradient > 0.0)) | ((high <= 0.0) & (gradient < 0.0))
    if not fixed.any():
        inside = -np.linalg.solve(hessian, gradient)
        if np.all((low <= inside) & (inside <= high)):  # most steps: nothing to search for
            return np.asarray(inside)
    for _ in range(4 * p + 4):
        free = ~fixed
        if free.any():
            right = gradient[free] + hessian[np.ix_(free, fixed)] @ step[fixed]
            target = -np.linalg.solve(hessian[np.ix_(free, free)], right)
            move = target - step[free]
            room = np.where(move > 0.0, high[free] - step[free], low[free] - step[free])
            ratio = np.where(np.abs(move) > np.abs(room), room / np.where(move == 0.0, 1.0, move), 1.0)
            share = float(ratio.min())
            step[free] += share * move
            if share < 1.0:
                tightest = int(np.argmin(ratio))
                column = int(np.flatnonzero(free)[tightest])
                step[column] = high[column] if move[tightest] > 0.0 else low[column]
                fixed[column] = True
                continue
        slope = gradient + hessian @ step
        leaving = fixed & ~pinned & (((step <= low) & (slope < -1e-14)) | ((step >= high) & (slope > 1e-14)))
        if not leaving.any():
            break
        fixed[int(np.argmax(np.where(leaving, np.abs(slope), 0.0)))] = False
    return np.clip(step, low, high)


#: Distance from a kink, as a share of the smooth region, up to which a coordinate counts as at the kink.
KINK_TOLERANCE = 1e-3
#: Length of a Newton step in a logarithm above which steps linear in the logarithm and in the value differ noticeably.
MIN_LOG_STEP = 0.3
#: Ratio of actual to predicted decrease below which the next step is made in the other parametrisation.
MIN_GAIN_RATIO = 0.75

#: Bounds (p,) of the region about a point (p,) in which the cost is smooth.
SmoothRegion = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class CostShape:
    """What is known of a cost beforehand."""

    smooth_region: SmoothRegion | None = None
    logarithmic: NDArray[np.bool_] | None = None


class StepRule:
    """Make steps inside the box, on one side of a kink, linear in the coordinates or in their values."""

    def __init__(self, low: FloatArray, high: FloatArray, shape: CostShape) -> None:
        self.low, self.high, self.shape = low, high, shape
        self._logarithmic = shape.logarithmic if shape.logarithmic is not None else np.zeros(low.size, dtype=bool)
        self._confined = self._linear_in_values = self._switched = False

    def _region(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.shape.smooth_region(point) if self.shape.smooth_region is not None else (self.low, self.high)

    @property
    def _relative(self) -> NDArray[np.bool_]:
        """Coordinates whose steps are relative changes of their values."""
        return self._logarithmic & self._linear_in_values

    def bounds(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (p,) of a step from a point."""
        low, high = self.low - point, self.high - point
        if self._confined:
            region = self._region(point)
            low, high = np.maximum(low, region[0] - point), np.minimum(high, region[1] - point)
        relative = self._relative
        low[relative], high[relative] = np.expm1(low[relative]), np.expm1(high[relative])
        return low, high

    def apply(self, point: FloatArray, step: FloatArray) -> FloatArray:
        """Return the point (p,) after a step."""
        relative, moved = self._relative, point + step
        moved[relative] = point[relative] + np.log1p(step[relative])
        return np.clip(moved, self.low, self.high)

    def change_after_rejection(self, point: FloatArray, rejected: FloatArray, newton: FloatArray) -> bool:
        """Change the rule after a step to ``rejected`` failed; False if there is nothing left to change."""
        low, high = self._region(point)
        if not self._confined and np.any((rejected < low) | (rejected > high)):
            self._confined = True
            return True
        if self._switched or not self._is_long(newton):
            return False
        self._linear_in_values, self._switched = not self._linear_in_values, True
        return True

    def change_after_step(self, point: FloatArray, new: FloatArray, newton: FloatArray, gain_ratio: float) -> None:
        """Adapt the rule to a step to ``new`` that was taken; ``gain_ratio`` is its actual over predicted decrease."""
        self._switched = False
        self._confined = self._confined and self._stays_at_kink(point, new)
        if gain_ratio < MIN_GAIN_RATIO and self._is_long(newton):
            self._linear_in_values = not self._linear_in_values

    def _is_long(self, newton: FloatArray) -> bool:
        """Return whether the Newton step is so long that the two parametrisations differ."""
        return bool(np.any(np.abs(newton[self._logarithmic]) > MIN_LOG_STEP))

    def _stays_at_kink(self, point: FloatArray, new: FloatArray) -> bool:
        """Return whether a step moved along a kink."""
        low, high = self._region(point)
        kinked = np.isfinite(low)
        x, low, high = new[kinked], low[kinked], high[kinked]
        tolerance = KINK_TOLERANCE * (high - low)
        at_kink = (x <= low + tolerance) | (x >= high - tolerance)
        return bool(np.any(at_kink & (np.abs(x - point[kinked]) <= tolerance)))


#: Margin at both ends of a sample interval, as a share of it: at the kink itself a derivative may be of either side.
KINK_MARGIN = 1e-6


def cost_shape(parameters: ParameterSet, free: Sequence[int], intervals: Sequence[float]) -> CostShape:
    """Tell which of the free coordinates are logarithms, and where a delay among them has kinks.

    ``intervals`` are the sample intervals of the recordings in s."""
    own = type(parameters)(tuple(parameters.items[j] for j in free))
    steps = {
        k: intervals[item.recording] if item.recording is not None else min(intervals)
        for k, item in enumerate(own.items)
        if isinstance(item.target, DelayTarget)
    }

    def smooth_region(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = own.from_search(point)
        low, high = np.full(point.size, -np.inf), np.full(point.size, np.inf)
        for k, step in steps.items():
            first = np.floor(values[k] / step + KINK_MARGIN)
            for bound, at in ((low, first + KINK_MARGIN), (high, first + 1.0 - KINK_MARGIN)):
                values[k] = at * step
                bound[k] = own.to_search(values)[k]
        return low, high

    return CostShape(smooth_region if steps else None, own.logarithmic)


def levenberg_marquardt(
    cost_function: CostFunction[Quadratic],
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    settings: LocalSettings | None = None,
    on_iteration: Callable[[int, float], object] | None = None,
    shape: CostShape | None = None,
    leads_to_known: Callable[[Quadratic, FloatArray], bool] | None = None,
) -> LocalResult[Quadratic]:
    """Minimise a cost from a start, inside bounds."""
    settings = settings or LocalSettings()
    point = np.clip(np.asarray(start, dtype=np.float64), low, high)
    here = cost_function.evaluate(point)
    if here is None:
        return LocalResult(point, None, 0, Stop.FAILED_START, 1)
    rule = StepRule(low, high, shape or CostShape())
    return _iterate(cost_function, (point, here), rule, settings, on_iteration, leads_to_known)


def _iterate(
    cost_function: CostFunction[Quadratic],
    start: tuple[FloatArray, Quadratic],
    rule: StepRule,
    settings: LocalSettings,
    on_iteration: Callable[[int, float], object] | None,
    leads_to_known: Callable[[Quadratic, FloatArray], bool] | None,
) -> LocalResult[Quadratic]:
    """Step from a point (p,) with its quadratic model until a reason to stop applies."""
    point, here = start
    damping, growth, evaluations = settings.damping, 2.0, 1
    largest_curvature, rejected, idle = np.zeros(point.size), 0, 0
    for iteration in range(1, settings.iterations + 1):
        if on_iteration is not None and on_iteration(iteration, here.cost) is True:
            return LocalResult(point, here, iteration - 1, Stop.INTERRUPTED, evaluations)
        np.maximum(largest_curvature, np.diag(here.hessian), out=largest_curvature)
        scale = np.where(largest_curvature > 0.0, largest_curvature, 1.0)
        bounds = rule.bounds(point)
        newton = bounded_step(here.hessian + np.diag(1e-10 * scale), here.gradient, *bounds)
        newton_decrease = here.predicted_decrease(newton)
        if leads_to_known is not None and leads_to_known(here, newton):
            return LocalResult(point, here, iteration, Stop.KNOWN_OPTIMUM, evaluations)
        converged = _converged(here, newton_decrease, newton, point, settings)
        before = here.cost
        if converged is None:
            step = bounded_step(here.hessian + np.diag((1e-14 + damping) * scale), here.gradient, *bounds)
            predicted = max(here.predicted_decrease(step), 1e-300)
            trial = rule.apply(point, step)
            there = cost_function.evaluate(trial)
            evaluations += 1
            if there is None or not there.cost < before:
                if rule.change_after_rejection(point, trial, newton):
                    continue
                damping, growth, rejected = damping * growth, 2.0 * growth, rejected + 1
                if damping > 1e15 or rejected >= settings.max_rejections:
                    return LocalResult(point, here, iteration, Stop.NO_PROGRESS, evaluations)
                continue
            gain_ratio = min((before - there.cost) / predicted, 1e6)  # the cube of more overflows
            damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain_ratio - 1.0) ** 3), 1e-12)
            rule.change_after_step(point, trial, newton, gain_ratio)
            growth, point, here, rejected = 2.0, trial, there, 0
        updated = cost_function.update_noise(here)
        noise_gain, here = here.cost - updated.cost, updated
        idle = idle + 1 if before - here.cost < settings.min_decrease * here.unit else 0
        if converged is None and idle >= 2:
            return LocalResult(point, here, iteration, Stop.NO_PROGRESS, evaluations)
        if converged is not None and noise_gain < settings.min_noise_gain:
            return LocalResult(point, here, iteration, converged, evaluations)
    return LocalResult(point, here, settings.iterations, Stop.ITERATION_LIMIT, evaluations)


def _converged(
    here: QuadraticModel, newton_decrease: float, newton: FloatArray, point: FloatArray, settings: LocalSettings
) -> Stop | None:
    """Say why the search has converged (the Newton step lowers the cost too little, or is too small), or None."""
    # A decrease below the rounding error of the cost can be predicted but not observed.
    relative = max(settings.relative_tolerance, float(np.finfo(np.float64).eps))
    if newton_decrease <= max(settings.tolerance * here.unit, relative * abs(here.cost)):
        return Stop.CONVERGED
    if np.all(np.abs(newton) <= settings.step_tolerance * (np.abs(point) + settings.step_tolerance)):
        return Stop.SMALL_STEP
    return None


@dataclass(frozen=True)
class Stage:
    """One stage: the parameters that are fitted, and the outputs that they are fitted to."""

    parameters: tuple[str, ...]
    outputs: tuple[str, ...]


def stages_by_effect(objective: Objective, point: FloatArray, free: Sequence[int]) -> tuple[Stage, ...]:
    """Order stages of the free columns by their effects at a point (p,) in search coordinates.

    None where one would do."""
    data, outputs = objective.calibration.data, objective.calibration.data.outputs
    found = objective.evaluate(point, free)
    if found is None or found.slopes is None or len(outputs) == 1:
        return ()
    effect = np.zeros((len(free), len(outputs)))
    for k, series in enumerate(objective.series):
        size = np.max(np.abs(found.slopes[k]), axis=1) / data.scale[series.column]
        effect[:, series.column] = np.maximum(effect[:, series.column], size)
    moved = [frozenset(np.flatnonzero(column > 1e-6).tolist()) for column in effect.T]
    stages: list[Stage] = []
    settled: set[int] = set()
    for members in sorted(set(moved), key=lambda s: (len(s), sorted(s))):
        if new := sorted(members - settled):
            settled |= set(new)
            group = tuple(output for output, own in zip(outputs, moved, strict=True) if own == members)
            stages.append(Stage(tuple(objective.parameters.names[free[j]] for j in new), group))
    return tuple(stages) if len(stages) > 1 else ()


CostKind = Literal["posterior", "weighted", "eq6"]

#: When a local search of a whole model stops unless the caller says otherwise: its intervals need no more digits, and
#: along a kink or at the solver's noise further steps gain nothing.
WHOLE_MODEL_LOCAL = LocalSettings(tolerance=1e-4, max_rejections=15, min_decrease=0.005)


@dataclass(frozen=True, repr=False)
class FitSettings(SettingsDisplay):
    """How a fit is done.

    Parameters
    ----------
    method : {"pso+local", "pso", "local"}
        ``pso+local``: the swarm, then the local search from its best particles.
    cost : {"posterior", "weighted", "eq6"}
        What is minimised: the negative log-posterior, with correlated noise where the data show it; squared errors
        weighted by each output's white noise; or the paper's Eq. 6, squared errors as they are. The last two leave
        the priors out.
    staged : bool
        Let the local search fit in the direction of causality before it fits all together.
    stages : tuple of Stage, optional
        Stages in place of those that the model's own structure gives.
    pso : SwarmSettings, optional
        Of the particle swarm; None for none.
    local : LocalSettings
        Of each local search of the whole model, as given.
    swarm_samples : int
        Samples a recording that the swarm sees.
    starts : int
        Particles that the local search starts from, besides the starting values.
    calibration : CalibrationSettings
    noise : NoiseModel
    fixed : mapping of str to float
        Model parameters held at other values than the model's own.
    values : mapping of str to sequence
        Values of parameters that are each fitted, and compared: numbers, True and False, enumeration literals.

    Examples
    --------
    >>> aero_bayes.FitSettings(method="local").swarm is None  # no particle swarm first
    True
    >>> aero_bayes.FitSettings(method="pso").last_search.iterations
    0
    """

    method: Literal["pso+local", "pso", "local"] = "pso+local"
    cost: CostKind = "posterior"
    staged: bool = True
    stages: tuple[Stage, ...] | None = None
    pso: SwarmSettings | None = field(default_factory=SwarmSettings)
    local: LocalSettings = field(default_factory=lambda: WHOLE_MODEL_LOCAL)
    swarm_samples: int = 600
    starts: Count = 3
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    noise: NoiseModel = field(default_factory=NoiseModel)
    fixed: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, Sequence[ListedValue]] = field(default_factory=dict)

    @property
    def swarm(self) -> SwarmSettings | None:
        """Settings of the swarm; None where there is none."""
        return self.pso if self.method != "local" else None

    @property
    def last_search(self) -> LocalSettings:
        """Settings of the local search from the swarm's best particles."""
        return self.local if self.method != "pso" else replace(self.local, iterations=0)
