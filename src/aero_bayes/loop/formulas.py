"""Formulas for what no listed law explains: proposed from one pass of a filter, then tried as terms like any other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import LogUniform
from aero_bayes.laws.formula import Formula, Signal, formulas, parameter_formulas
from aero_bayes.laws.formula_places import FormulaPlace
from aero_bayes.laws.formula_terms import ProposedFormula
from aero_bayes.laws.model_family import ModelFamily
from aero_bayes.loop.base_fit import BaseFit
from aero_bayes.loop.context import LoopContext
from aero_bayes.search.explored import SearchResult
from aero_bayes.search.formula_gains import SampledTerms, coefficient_gains, whitened_slopes
from aero_bayes.simulation.input_signals import signal_values
from aero_bayes.simulation.interface import DiffusionTarget, Experiment, Filter, FilteredStates, ReadingNoiseTarget
from aero_bayes.simulation.smoothing import updated_means

#: Values (n,) of each signal at the samples, one mapping a recording.
SignalValues = Sequence[Mapping[str, SampledTerms]]

#: Samples of a recording that are filtered, and how many it has at least: a term is taken along straight lines between.
MAX_SAMPLES, MIN_SAMPLES = 600, 400
#: Steps of the filter's fit: a proposal need not be exact.
FILTER_STEPS = 12
#: Process noise of a state, over what moves it by its size in a recording: the least, a middle and the largest one;
#: and from where the filter's fit begins, over the middle one.
DIFFUSIONS, START_DIFFUSIONS = (1e-3, 0.3, 100.0), (0.1, 1.0, 10.0)
#: Largest noise of an output over its floor, which is estimated from the readings alone.
MAX_NOISE_RATIO = 5.0
#: Signals at one place beside its own states, and terms that are tried by fits.
MAX_OTHER_SIGNALS, MAX_PROPOSALS = 4, 10
#: Of the terms that are tried, those at one place: which place it is, only fits tell.
MAX_AT_PLACE = 8
#: Share of the largest gain from which on the simplest terms are tried first, and how many: gains are of first order.
SIMPLE_SHARE, MAX_SIMPLE = 0.5, 4
#: Largest change of a parameter that is a function, over its value, and largest exponent: gains are of first order.
MAX_PARAMETER_CHANGE, MAX_EXPONENT = 3.0, 4.0
#: Functions of parameters that are tried where the best of them does about as well as what is added: most of them are a
#: term of a balance as well, and the gains are of first order.
MAX_FUNCTIONS, MIN_SHARE_OF_ADDED = 3, 0.5
#: Cosine between the responses to two terms from which on they are alike, and how many that are alike are tried.
ALIKE, MAX_ALIKE = 0.999, 3
#: Cosine from which on terms at two places are one and the same written in two ways.
SAME = 0.9999
#: Gain in log-likelihood that each part of a formula has to earn: of two that do as well the simpler one comes first.
COMPLEXITY_COST = 4.0
#: Least gain for which a term is proposed.
MIN_GAIN = 3.0
#: A signal counts as never negative where it is so by less than this share of its largest value: states have errors.
NEARLY_ZERO = 0.02
#: Process noise with which terms are compared, over the fitted one.
LESS_DIFFUSION = (1.0, 0.3, 0.1, 0.03)


@dataclass(frozen=True, eq=False)
class _Scored:
    """A formula at a place, its gain less what its parts cost, its direction (N,), and its order among equal ones."""

    proposal: ProposedFormula
    score: float
    direction: FloatArray
    order: tuple[int, int]


def wants_formulas(explored: SearchResult) -> bool:
    """Return whether no single listed law explains what the first model leaves."""
    best = explored.best
    return len(best.terms) > 1 or not explored.noise.adequate or bool(set(best.terms) & set(explored.curves))


def propose_formulas(
    context: LoopContext, plain: Calibration, base: BaseFit, values: Mapping[str, float]
) -> tuple[ProposedFormula, ...]:
    """Propose formulas at balances, inputs, outputs and parameters, by their gain beside the first fit; best first."""
    free = {plain.parameters.names[j] for j in base.fit.free}
    places, sizes = context.family.formulas.places(free), context.family.formulas.state_sizes()
    if not places or not sizes:
        return ()
    declared = {p.name: p.start for p in plain.parameters}
    noise: dict[str, float] = {}
    for (_, output), floor in base.floors.items():
        noise[output] = max(floor, noise.get(output, 0.0))
    found: list[_Scored] = []
    with suppress(CannotFinishError, InputError):
        disturbed = context.family.with_unknown_signals(plain, places)
        sizes = {disturbed.states[state]: size for state, size in sizes.items()}
        calibration = _with_process_noise(disturbed.calibration, tuple(sizes))
        calibration = replace(calibration, parameters=ParameterSet(_bounded(calibration, sizes, noise)))
        with context.open(calibration.problem()) as simulator:
            objective = context.objective(calibration, simulator)
            fit = _filter_fit(objective, (values, declared), free)
            tried = list(_with_less_diffusion(objective, fit))
            seen = _signals(calibration, tried[0].filtered, context.family, disturbed.states)
            for place in places:
                state = calibration.model.state_index(disturbed.signals[place.port])
                found += _at(objective, tried, place, state, seen)
            context.statistics.add_simulations(objective)
    return _best(found)


def _with_process_noise(plain: Calibration, states: Sequence[str]) -> Calibration:
    """Return the first model on few samples, but not too few, with process noise of some states."""
    few = plain.data.thinned(MAX_SAMPLES)
    finer = few.with_experiments(map(_with_samples_between, few.experiments))
    return replace(plain, data=finer).with_process_noise(plain.noise.with_process(states))


def _with_samples_between(e: Experiment) -> Experiment:
    """Return the experiment with further samples, without readings, where it has few."""
    parts = -(-MIN_SAMPLES // max(e.time.size, 1))
    if parts < 2 or e.measured is None:
        return e
    steps = np.arange(parts) / parts
    time = np.append((e.time[:-1, np.newaxis] + np.diff(e.time)[:, np.newaxis] * steps).ravel(), e.time[-1])
    measured = np.full((time.size, e.measured.shape[1]), np.nan)
    measured[::parts] = e.measured
    spread = e.spread
    if spread is not None:
        spread = np.repeat(spread, parts, axis=0)[: time.size]
    return replace(e, time=time, measured=measured, spread=spread)


def _bounded(calibration: Calibration, sizes: Mapping[str, float], noise: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Parameters of the filter: diffusions by the sizes of the states, and the noise of readings near its floor."""
    duration = max(float(e.time[-1] - e.time[0]) for e in calibration.data.experiments)
    found = []
    for p in calibration.parameters:
        if isinstance(p.target, DiffusionTarget):
            least, start, most = (share * sizes[p.target.state] / math.sqrt(duration) for share in DIFFUSIONS)
            p = replace(p, start=start, lower=least, upper=most, prior=LogUniform(least, most))
        elif isinstance(p.target, ReadingNoiseTarget) and noise.get(p.target.output, 0.0) > 0.0:
            least = noise[p.target.output]
            most = MAX_NOISE_RATIO * least
            p = replace(p, start=math.sqrt(least * most), lower=least, upper=most, prior=LogUniform(least, most))
        found.append(p)
    return tuple(found)


def _filter_fit(objective: Objective, starts: Sequence[Mapping[str, float]], free: set[str]) -> Optimum:
    """Return the filter's optimum over noise and the first model's parameters, from the best of some starts.

    Each start is tried with little and with much process noise: what the first model lacks may be as large as the rest
    of a balance, and its fit may have ended anywhere."""
    parameters = objective.parameters
    diffusions = [j for j, p in enumerate(parameters) if isinstance(p.target, DiffusionTarget)]
    points = []
    for values in starts:
        for share in START_DIFFUSIONS:
            si = np.array([values.get(p.name, p.start) for p in parameters])
            si[diffusions] *= share
            points.append(parameters.to_search(si))
    tried = objective.residuals(np.array(points))
    gains = {k: objective.whiten(e, {}).log_likelihood for k, e in enumerate(tried) if e is not None}
    if not gains:
        raise CannotFinishError("the first model cannot be filtered")
    noise = (DiffusionTarget, ReadingNoiseTarget)
    columns = [j for j, p in enumerate(parameters) if p.name in free or isinstance(p.target, noise)]
    settings = LocalFitSettings(hold_noise=True).with_limits(FILTER_STEPS, 0.5)
    return local_fit(objective, points[max(gains, key=lambda k: gains[k])], columns, settings=settings)


def _signals(
    calibration: Calibration, filtered: Sequence[FilteredStates], family: ModelFamily, there: Mapping[str, str]
) -> tuple[Mapping[str, Signal], SignalValues]:
    """Signals by name with their ranges, and their values along the filter's states in each recording.

    ``there`` are the names of states of the first model."""
    known = family.formulas.signals.variables()
    states = {known[base][0]: calibration.model.state_index(own) for base, own in there.items() if base in known}
    series = []
    for f, e, measured in zip(filtered, calibration.data.experiments, calibration.data.measured, strict=True):
        outputs = {known[name][0]: y for name, y in zip(e.outputs, f.predicted.T, strict=True) if name in known}
        values = {name: SampledTerms(y, y, y) for name, y in outputs.items()}
        updated = updated_means(f, measured)
        values |= {name: SampledTerms(f.mean[:, k], f.mean[:, k], updated[:, k]) for name, k in states.items()}
        for i in e.inputs:
            if i.name in known:
                at, before = signal_values(i, e.time), signal_values(i, np.nextafter(e.time, -np.inf))
                values[known[i.name][0]] = SampledTerms(before, at, at)
        series.append(values)
    units = dict(known.values())
    found = {}
    for name in series[0]:
        whole = np.concatenate([one[name].after for one in series])
        low, high = float(whole.min()), float(whole.max())
        found[name] = Signal(name, units[name], 0.0 if -NEARLY_ZERO * high < low < 0.0 else low, high)
    return found, series


@dataclass(frozen=True, eq=False)
class _Filtered:
    """A fit of the filter, perhaps with less process noise, and its states."""

    fit: Optimum
    filtered: Sequence[FilteredStates]


def _at(
    objective: Objective,
    tried: Sequence[_Filtered],
    place: FormulaPlace,
    state: int,
    seen: tuple[Mapping[str, Signal], SignalValues],
) -> list[_Scored]:
    """Return all formulas at one place, with their gains: the largest with as much process noise as fitted, or less.

    With the right term less process noise is left, and the less there is the more a wrong term loses."""
    signals, series = seen
    near = [s for n in place.signals if (s := signals.get(n)) is not None and s.high > s.low]
    every = parameter_formulas if place.parameter else formulas
    offered, terms = _terms(every(near[: 1 + MAX_OTHER_SIGNALS]), series)
    if not offered:
        return []
    largest = np.max([np.abs(own.at).max(axis=0) for own in terms], axis=0)
    best: list[tuple[float, FloatArray, float, FloatArray] | None] = [None] * len(offered)
    for one in tried:
        size = largest / _value(objective, one.fit, place.parameter)
        slopes = whitened_slopes(objective, one.fit, one.filtered, state, [own / size for own in terms])
        own_gains = coefficient_gains(objective, one.fit, slopes)
        gains = own_gains.gain + one.fit.log_likelihood - tried[0].fit.log_likelihood
        for k, gain in enumerate(gains.tolist()):
            known = best[k]
            if gain > (MIN_GAIN if known is None else known[0]):
                best[k] = gain, own_gains.direction[k], float(own_gains.value[k]), own_gains.readjusted[k]
    found: dict[tuple[tuple[str, str], ...], _Scored] = {}
    names = objective.parameters.names
    for formula, most, known in zip(offered, largest.tolist(), best, strict=True):
        if known is None:
            continue
        gain, direction, value, readjusted = known
        if abs(value) > {"share": MAX_PARAMETER_CHANGE, "power": MAX_EXPONENT * most}.get(formula.way, math.inf):
            continue
        score = gain - COMPLEXITY_COST * formula.complexity
        if formula.form not in found or score > found[formula.form].score:
            values = dict(zip(names, readjusted.tolist(), strict=True))
            far = sum(s.name != place.own for s in formula.signals)
            found[formula.form] = _Scored(
                ProposedFormula(place.port, formula, most, value / most, values), score, direction, (place.order, far)
            )
    return [*found.values()]


def _value(objective: Objective, fit: Optimum, parameter: str) -> float:
    """Return the fitted value of a parameter, by whose share a formula changes it; one where there is none."""
    if not parameter:
        return 1.0
    return float(objective.parameters.from_search(fit.coordinates)[objective.parameters.index(parameter)]) or 1.0


def _terms(every: Iterable[Formula], series: SignalValues) -> tuple[list[Formula], list[SampledTerms]]:
    """Formulas, and their values in each recording; those without values are left out."""
    offered: list[Formula] = []
    terms: list[list[FloatArray]] = [[] for _ in series]
    with np.errstate(all="ignore"):
        for formula in every:
            values = [np.array([_values(formula, one, when) for when in ("before", "at", "after")]) for one in series]
            if all(np.all(np.isfinite(v)) for v in values) and max(float(np.ptp(v)) for v in values) > 0.0:
                offered.append(formula)
                for own, v in zip(terms, values, strict=True):
                    own.append(v)
    if not offered:
        return [], []
    return offered, [SampledTerms(*np.moveaxis(np.array(own), (1, 0), (0, 2))) for own in terms]


def _values(formula: Formula, series: Mapping[str, SampledTerms], when: str) -> FloatArray:
    """Return a formula (n,) along a recording, its signals within their ranges, before, at or after each reading."""
    return formula.values({s.name: np.clip(getattr(series[s.name], when), s.low, s.high) for s in formula.signals})


def _with_less_diffusion(objective: Objective, fit: Optimum) -> Iterator[_Filtered]:
    """Yield the filter as fitted, then with less process noise, all else the same, where that can be filtered."""
    diffusions = [j for j, p in enumerate(objective.parameters) if isinstance(p.target, DiffusionTarget)]
    least = np.array([objective.parameters.items[j].lower for j in diffusions])
    for share in LESS_DIFFUSION:
        values = objective.parameters.from_search(fit.coordinates)
        values[diffusions] = np.maximum(share * values[diffusions], least)
        at = objective.parameters.to_search(values)
        found = objective.evaluate(at, fit.free)
        if found is None:
            continue
        whitened = objective.whiten(found, {})
        there = replace(
            fit, coordinates=at, evaluation=found, whitened=whitened, log_likelihood=whitened.log_likelihood
        )
        yield _Filtered(there, cast(Filter, objective.simulator).filtered_states(values))


def _best(found: Sequence[_Scored]) -> tuple[ProposedFormula, ...]:
    """The best proposals, some of the simplest among them; of many that are alike only a few.

    Of those that are the same at several places one is taken."""
    added = [one for one in found if one.proposal.formula.way == "added"]
    least = MIN_SHARE_OF_ADDED * max((one.score for one in added), default=0.0)
    functions = [one for one in found if one.proposal.formula.way != "added" and one.score > least]
    chosen = list[_Scored]()
    for kept, most in ((added, MAX_PROPOSALS - min(len(functions), MAX_FUNCTIONS)), (functions, MAX_PROPOSALS)):
        by_score = sorted(kept, key=lambda f: (-round(f.score, 1), f.order))
        good = [f for f in by_score if f.score > SIMPLE_SHARE * by_score[0].score]
        simple = sorted(good, key=lambda f: f.proposal.formula.complexity)
        first = min(MAX_SIMPLE, (most - len(chosen) + 1) // 2)
        chosen = _different(by_score, _different(simple, chosen, len(chosen) + first), most)
    return tuple(one.proposal for one in chosen)


def _different(offered: Sequence[_Scored], chosen: Sequence[_Scored], most: int) -> list[_Scored]:
    """Return the first of some proposals, beside chosen ones, that are not too much alike."""
    found = [*chosen]
    for one in offered:
        if len(found) == most:
            break
        near = [(abs(float(one.direction @ other.direction)), other) for other in found]
        elsewhere = any(near_by > SAME and other.proposal.port != one.proposal.port for near_by, other in near)
        alike = sum(near_by > ALIKE and other.proposal.port == one.proposal.port for near_by, other in near)
        there = sum(other.proposal.port == one.proposal.port for other in found)
        if one not in found and not elsewhere and alike < MAX_ALIKE and there < MAX_AT_PLACE:
            found.append(one)
    return found
