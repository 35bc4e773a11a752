"""What no listed effect explains: a learned curve over a state, or a disturbance that belongs to a moment.

Both are held against the same evidence as the catalogue. A curve's values have a normal prior, as wide as a tenth of
what the model itself puts through that port and smooth over the knots, so that they pay for their freedom and stay
sensible where no data went; knots are added while that pays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.declared import Declaration
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import ClimbSettings, Optimum, SmoothPrior, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import Normal
from aero_bayes.physics.family import CURVE_PREFIX, KNOTS, ModelFamily
from aero_bayes.physics.locate import LinearResponse, Moment, PortSignal, find_moment, infer_signal, kernel
from aero_bayes.simulation.interface import InputSignal, InputTarget, ParameterTarget

FloatArray = NDArray[np.float64]
OpenObjective = Callable[[Calibration], Objective]

#: Spread of a curve's values against what the model puts through the port.
SHARE = 0.1
#: Distance over which a curve's values go together, as a share of its range.
SMOOTH = 0.3
#: Knots of an unknown signal over time, a recording.
SIGNAL_KNOTS = 100
#: Knots of a disturbance whose course is fitted, and how far it may reach beyond where it was found: as a share of its
#: length, and at least (s).
COURSE_KNOTS = 25
MARGIN, LEAST_MARGIN = 0.6, 0.8


@dataclass(frozen=True, eq=False)
class CurveFit:
    """A learned curve: where it acts, over what, on which range, its values and its evidence."""

    port: str
    over: str
    x_min: float
    x_max: float
    values: FloatArray
    refit: Optimum
    parameters: ParameterSet

    @property
    def columns(self) -> tuple[int, ...]:
        return tuple(self.parameters.index(f"{CURVE_PREFIX}_{k + 1}") for k in range(self.values.size))

    @property
    def smooth(self) -> SmoothPrior:
        """The prior of its values; a parameter's own is the same but for the coupling."""
        return smooth_prior([self.parameters.items[j] for j in self.columns])


def smooth_prior(curve: Sequence[Parameter]) -> SmoothPrior:
    """Prior of a curve's values at equally spaced knots: a Matern 3/2 process over the state."""
    places = np.linspace(0.0, 1.0, len(curve))
    sd = np.array([item.prior.sd for item in curve if isinstance(item.prior, Normal)])
    covariance = np.outer(sd, sd) * (kernel(places, SMOOTH) + 1e-8 * np.eye(places.size))
    return SmoothPrior(tuple(item.name for item in curve), covariance)


@dataclass(frozen=True)
class Visited:
    """Ranges of the states and sizes of the ports in a fit: what a curve covers and what its values are scaled by."""

    ranges: Mapping[str, tuple[float, float]]
    sizes: Mapping[str, float]
    declared: Declaration

    @classmethod
    def of(cls, study: Objective, fit: Optimum, declared: Declaration) -> Visited:
        """From a fit's predictions, for the declared states and ports."""
        calibration, ranges = study.calibration, {}
        for name, state in declared.states.items():
            parts = [
                np.gradient(predicted, series.sampling.time) if state.rate else predicted
                for series, predicted in zip(study.series, fit.evaluation.predicted, strict=True)
                if series.output == state.output and predicted.size > 2
            ]
            if parts:
                low, high = (float(v) for v in np.quantile(np.concatenate(parts), (0.001, 0.999)))
                high = max(abs(low), abs(high)) if state.even else high
                ranges[name] = (-high if state.even else low, high)
        known = {v.name: calibration.fixed.get(v.name, v.start or 0.0) for v in calibration.model.parameters}
        known |= dict(zip(study.parameters.names, study.parameters.from_search(fit.coordinates), strict=True))
        signals = [s for e in calibration.experiments for s in e.inputs]
        known |= {s.name: max(float(np.abs(o.values).max()) for o in signals if o.name == s.name) for s in signals}
        typical = {name: state.typical for name, state in declared.states.items()}
        known |= typical | {name: max(map(abs, ends)) for name, ends in ranges.items()}
        unknown = [(port, n) for port, it in declared.ports.items() for n in it.size if n not in known]
        if unknown:
            raise InputError(f"ports.{unknown[0][0]}.size: {unknown[0][1]} is no parameter, input or state")
        sizes = {port: math.prod(known[n] for n in it.size) for port, it in declared.ports.items() if it.size}
        return cls(ranges, {port: max(float(size), 1e-9) for port, size in sizes.items()}, declared)


@dataclass(frozen=True, eq=False)
class CurveSearch:
    """What a search of learned curves works with.

    ``shared`` are the base's own parameters, ``start`` their values where the base was fitted.
    """

    family: ModelFamily
    calibration: Calibration
    shared: Sequence[Parameter]
    start: Mapping[str, float]
    base: Optimum
    visited: Visited
    open_objective: OpenObjective
    settings: ClimbSettings

    def places(self, outputs: Sequence[str]) -> list[tuple[str, str]]:
        """Every port with every state that was seen to move."""
        ranges, declared = self.visited.ranges, self.family.declared
        shown = [(c.port, c.over) for c in declared.curves if declared.shown(c.port, outputs)]
        return [(p, o) for p, o in shown if o in ranges and ranges[o][1] > ranges[o][0]]

    def fit(self, port: str, over: str, knots: int, like: CurveFit | None = None) -> CurveFit | None:
        """Refit the base with one curve, from none or from a coarser one; None if it cannot be simulated."""
        model = self.family.curve(port, over, knots)
        declared, (low, high) = self.family.declared, self.visited.ranges[over]
        size = SHARE * (1.0 if declared.curve(port, over).share else self.visited.sizes[port])
        places = np.linspace(low, high, knots)
        curve = tuple(
            Parameter(
                f"{CURVE_PREFIX}_{k + 1}", declared.curve_unit(port, over), 0.0, -100.0 * size, 100.0 * size,
                Normal(0.0, size), "linear", f"Curve at {over} = {x:.4g}", ParameterTarget(f"{CURVE_PREFIX}_{k + 1}"),
            )
            for k, x in enumerate(places)
        )  # fmt: skip
        nuisances = [p for p in self.calibration.parameters if p.recording is not None]
        parameters = ParameterSet((*self.shared, *nuisances, *curve))
        start, noise = dict(self.start), self.base.noise
        if like is not None:
            noise = like.refit.noise
            start = dict(zip(like.parameters.names, like.parameters.from_search(like.refit.coordinates), strict=True))
            values = np.interp(places, np.linspace(low, high, like.values.size), like.values)
            start |= {f"{CURVE_PREFIX}_{k + 1}": float(v) for k, v in enumerate(values)}
        fixed = {
            variable.name: low if variable.name.endswith(".x_min") else high
            for variable in model.parameters
            if variable.name.endswith((".x_min", ".x_max"))
        }
        calibration = replace(
            self.calibration, model=model, parameters=parameters, fixed={**self.calibration.fixed, **fixed}
        )
        study = self.open_objective(calibration)
        try:
            at = parameters.to_search(np.array([start.get(name, 0.0) for name in parameters.names]))
            settings = replace(self.settings, smooth=smooth_prior(curve))
            found = climb(study, at, range(len(parameters)), noise=noise, settings=settings)
        except CannotFinishError:
            return None
        finally:
            study.simulator.close()
        return CurveFit(port, over, low, high, parameters.from_search(found.coordinates)[-knots:], found, parameters)


def fit_curves(search: CurveSearch, outputs: Sequence[str], refined: int = 2) -> tuple[CurveFit, ...]:
    """Refit the base with one curve at a time, at every port over every state that was seen, best first.

    The ``refined`` best ones get more knots for as long as that pays.
    """
    tried = [search.fit(port, over, KNOTS[0]) for port, over in search.places(outputs)]
    found = sorted((c for c in tried if c is not None), key=lambda curve: -curve.refit.log_evidence)
    for k, curve in enumerate(found[:refined]):
        for knots in KNOTS[1:]:
            finer = search.fit(curve.port, curve.over, knots, curve)
            if finer is None or finer.refit.log_evidence < curve.refit.log_evidence + 1.0:
                break
            curve = finer
        found[k] = curve
    return tuple(sorted(found, key=lambda curve: -curve.refit.log_evidence))


@dataclass(frozen=True, eq=False)
class Probing:
    """Unknown signals over time at every port: what they gain, and disturbances of a moment."""

    signals: Mapping[str, PortSignal]
    moments: tuple[Moment, ...]
    recording: int


def probe(
    calibration: Calibration, fit: Optimum, visited: Visited, open_objective: OpenObjective, recording: int
) -> Probing:
    """Infer the signal at each port that would explain what a fit leaves in one recording.

    The calibration's model carries probe inputs; its fitted columns may readjust along their own sensitivities.
    """
    parameters, model, outputs = calibration.parameters, calibration.model, calibration.outputs
    experiment = calibration.experiments[recording]
    knots = np.linspace(experiment.time[0], experiment.time[-1], SIGNAL_KNOTS)
    declared, driven = visited.declared, {signal.name for signal in model.inputs}
    ports = [port for port in declared.ports if declared.shown(port, outputs) and f"u_{port}" in driven]
    signals: dict[str, PortSignal] = {}
    moments = []
    for port in ports:
        unit, silent = declared.ports[port].unit, InputSignal(f"u_{port}", knots, np.zeros(knots.size), "linear")
        probed = replace(experiment, inputs=(*experiment.inputs, silent))
        one = replace(calibration, names=(calibration.names[recording],), experiments=(probed,), recordings=())
        chosen = [j for j in fit.free if parameters.items[j].recording in (None, recording)]
        fitted = [_for_one(parameters.items[j]) for j in range(len(parameters))]
        kept = [j for j in range(len(parameters)) if parameters.items[j].recording in (None, recording)]
        knot_columns = [
            Parameter(f"u[{k}]", unit, 0.0, -1.0, 1.0, Normal(0.0, 1.0), "linear", "", InputTarget(silent.name, k))
            for k in range(knots.size)
        ]
        everything = ParameterSet((*(fitted[j] for j in kept), *knot_columns))
        study = open_objective(replace(one, parameters=everything))
        try:
            at = np.concatenate((fit.coordinates[kept], np.zeros(knots.size)))
            first = [kept.index(j) for j in chosen]
            found = study.evaluate(at, [*first, *range(len(kept), len(everything))])
            if found is None or found.slopes is None:
                continue
            white = study.whiten(found.residual, found.slopes, fit.noise)
        finally:
            study.simulator.close()
        prior = np.sqrt(np.maximum(-parameters.prior_derivatives(fit.coordinates)[1][chosen], 1e-12))
        nuisance = white.slopes[: len(first)] / prior[:, np.newaxis]
        # Columns of the knots are per half of their width in the search coordinate, two units wide.
        responses = white.slopes[len(first) :] / 2.0
        linear = LinearResponse(white.residual, nuisance)
        span = float(knots[-1] - knots[0])
        lengths = tuple(length for length in (0.02 * span, 0.05 * span, 0.15 * span))
        signals[port] = infer_signal(port, knots, responses, linear, lengths)
        moment = find_moment(port, knots, responses, linear, prior_size=visited.sizes[port] * SHARE)
        if moment is not None:
            moments.append(moment)
    return Probing(signals, tuple(sorted(moments, key=lambda m: -m.gain)), recording)


def _for_one(item: Parameter) -> Parameter:
    return item if item.recording is None else replace(item, recording=0)


@dataclass(frozen=True, eq=False)
class MomentFit:
    """A disturbance of a moment, its course refitted beside all parameters, and the evidence, its place paid for.

    ``refit`` is over the parameters of ``calibration``, the model without the disturbance; ``signal`` is the
    disturbance as an input of recording ``recording``.
    """

    moment: Moment
    refit: Optimum
    log_evidence: float
    calibration: Calibration
    recording: int
    signal: InputSignal


def fit_moment(
    calibration: Calibration,
    base: Optimum,
    probing: Probing,
    visited: Visited,
    open_objective: OpenObjective,
    settings: ClimbSettings,
) -> MomentFit | None:
    """Refit the base with the most promising disturbance of a moment: constant, then of any course if that pays."""
    if not probing.moments:
        return None
    moment = probing.moments[0]
    size, unit = SHARE * visited.sizes[moment.port], visited.declared.ports[moment.port].unit
    ends = (moment.start, moment.stop)
    constant = InputSignal(f"u_{moment.port}", np.array([ends[0] - 1.0, *ends]), np.array([0.0, moment.size, 0.0]))
    push = _Push(calibration, base, probing, moment, (size, unit), open_objective, settings)
    best = push.fit(constant, (1,))
    margin = max(MARGIN * (ends[1] - ends[0]), LEAST_MARGIN)
    times = np.linspace(ends[0] - margin, ends[1] + margin, COURSE_KNOTS)
    inside = (times > ends[0]) & (times < ends[1])
    course = InputSignal(f"u_{moment.port}", times, np.where(inside, moment.size, 0.0), "linear")
    free = tuple(range(1, COURSE_KNOTS - 1))
    other = push.fit(course, free)
    if best is None or (other is not None and other.log_evidence > best.log_evidence):
        return other
    return best


@dataclass(frozen=True, eq=False)
class _Push:
    """A disturbance of one moment, of typical ``size`` in its unit, to be refitted with some course."""

    calibration: Calibration
    base: Optimum
    probing: Probing
    moment: Moment
    size: tuple[float, str]
    open_objective: OpenObjective
    settings: ClimbSettings

    def fit(self, signal: InputSignal, free: Sequence[int]) -> MomentFit | None:
        """Refit with the values ``free`` of a signal beside the parameters of the base."""
        recording, (size, unit), parameters = self.probing.recording, self.size, self.calibration.parameters
        experiments = list(self.calibration.experiments)
        silent = replace(signal, values=np.zeros(signal.values.size))
        experiments[recording] = replace(experiments[recording], inputs=(*experiments[recording].inputs, silent))
        pushes = tuple(
            Parameter(
                f"push_{k}", unit, 0.0, -100.0 * size, 100.0 * size, Normal(0.0, size), "linear",
                f"Disturbance at {signal.time[k]:.4g} s", InputTarget(signal.name, k), recording,
            )
            for k in free
        )  # fmt: skip
        everything = parameters.extended(pushes)
        columns = range(len(parameters), len(everything))
        start = np.clip(signal.values[list(free)], -100.0 * size, 100.0 * size)
        calibration = replace(self.calibration, experiments=tuple(experiments), parameters=everything)
        study = self.open_objective(calibration)
        try:
            at = everything.to_search(np.concatenate((parameters.from_search(self.base.coordinates), start)))
            found = climb(study, at, (*self.base.free, *columns), noise=self.base.noise, settings=self.settings)
        except CannotFinishError:
            return None
        finally:
            study.simulator.close()
        fitted = everything.from_search(found.coordinates)[len(parameters) :]
        values = np.zeros(signal.values.size)
        values[list(free)] = fitted
        evidence = found.log_evidence - float(np.log(SIGNAL_KNOTS * 8 * max(len(self.probing.signals), 1)))
        strongest = float(fitted[np.argmax(np.abs(fitted))])
        moment = replace(self.moment, size=strongest, gain=evidence - self.base.log_evidence)
        own = replace(found, coordinates=found.coordinates[: len(parameters)])
        return MomentFit(moment, own, evidence, self.calibration, recording, replace(signal, values=values))
