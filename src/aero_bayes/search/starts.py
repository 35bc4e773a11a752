"""Starting points for the fit of a larger structure: rules that give points with the gain they predict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.parameters import ParameterSet, prior_curvature
from aero_bayes.laws.model_family import CandidateTerm
from aero_bayes.search.models import FittedModel
from aero_bayes.search.response import LinearResponse, ResponseLine, Tried
from aero_bayes.search.structure import Structure

FloatArray = NDArray[np.float64]

#: Magnitudes in a grid, halvings of the grid about its best point, and lines of which both ends are simulated.
GRID_POINTS, GRID_HALVINGS, MAX_LINES = 6, 3, 3
#: Change of the outputs, as a share of the residual, up to which the response to a magnitude counts as linear.
LINEAR_RESPONSE_SHARE = 0.3
#: Gain in log-likelihood below which a line is not followed: half of the gain that a start must predict for a fit.
MIN_LINE_GAIN = 1.0
#: Share of a predicted gain that a simulation must confirm. Else the other parameters are refitted, if the predicted
#: gain is this large in tempered log-likelihood, or this share of the whole residual.
MIN_CONFIRMED_SHARE, MIN_REFIT_GAIN, MIN_REFIT_SHARE = 0.3, 6.0, 0.1


@dataclass(frozen=True, eq=False)
class Start:
    """A point (p,) in search coordinates where a fit may start, and the gain in log-likelihood that it predicts.

    ``simulated_gain`` is the gain of a simulation at the point; minus infinity without a simulation.
    """

    point: FloatArray
    expected_gain: float
    simulated_gain: float = -math.inf

    @property
    def predicted_gain(self) -> float:
        return max(self.expected_gain, self.simulated_gain)


class StartRule(Protocol):
    """Gives starting points for a structure that has terms which a fitted model lacks."""

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        """Points on ``fitted.model``, which has the structure's terms at hand."""
        ...


def starting_points(rules: Sequence[StartRule], fitted: FittedModel, structure: Structure) -> list[Start]:
    """Collect the starts of all rules.

    The start with the best simulated gain comes first, because a simulation may refute a linear prediction. The
    others follow by their predicted gain.
    """
    found = [start for rule in rules for start in rule.starts(fitted, structure)]
    found.sort(key=lambda s: -s.predicted_gain)
    confirmed = max(found, key=lambda s: s.simulated_gain, default=None)
    return sorted(found, key=lambda s: s is not confirmed)


def _single_new_term(fitted: FittedModel, structure: Structure) -> CandidateTerm | None:
    new = structure.new_terms(fitted.structure)
    return fitted.model.candidates[new[0]] if len(new) == 1 else None


@dataclass(frozen=True)
class NominalSizes:
    """Simulate a term at its nominal parameters, and take Gauss-Newton steps along the lines through these points.

    The response to a law with a threshold is not linear: a grid of magnitudes is refined by bisection about its best
    point, and both ends of the likeliest lines are simulated. If every trial magnitude overshoots the residual, retry
    at 30 % of it. Where no simulation confirms the prediction, the other parameters are refitted with the term fixed.
    """

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        candidate = _single_new_term(fitted, structure)
        if candidate is None or not candidate.starts:
            return []
        response = fitted.response
        lines = nominal_lines(response, candidate)
        if response.gain_under_white_noise(_max_predicted_gain(lines)) < MIN_LINE_GAIN:
            lines += [response.line(*tried) for tried in _scaled_to_residual(response, candidate, lines)]
        starts = _line_starts(response, candidate, lines)
        predicted = max((s.predicted_gain for s in starts), default=0.0)
        much = 0.5 * float(response.remaining @ response.remaining) * MIN_REFIT_SHARE
        worth = predicted > min(MIN_REFIT_GAIN * fitted.temperature, much)
        if worth and max((s.simulated_gain for s in starts), default=0.0) < MIN_CONFIRMED_SHARE * predicted:
            starts += _refit_with_term_fixed(response, lines)
        return starts


def nominal_lines(response: LinearResponse, candidate: CandidateTerm) -> list[ResponseLine]:
    """Lines through a candidate's nominal parameters."""
    columns, lines = candidate.columns, [response.line(*tried) for tried in _simulate_nominal(response, candidate)]
    if len(columns) == 1 and len(candidate.starts) >= GRID_POINTS:
        for _ in range(GRID_HALVINGS):
            between = _midpoints(response.objective.parameters, candidate, lines)
            if not between:
                break
            lines += [response.line(*tried) for tried in response.simulate(columns, between)]
    return lines


def _simulate_nominal(response: LinearResponse, candidate: CandidateTerm) -> list[Tried]:
    """A candidate at its nominal parameters; of a grid only every second one if all of these lower the likelihood."""
    columns, starts = candidate.columns, candidate.starts
    if len(columns) > 1 or len(starts) < GRID_POINTS:
        return response.simulate(columns, starts)
    ordered = sorted(starts)
    tried = response.simulate(columns, ordered[::2])
    lines = [response.line(*one) for one in tried]
    if lines and all(line.squared_length > 0.0 and line.best_step <= 0.0 for line in lines):
        return tried
    return tried + response.simulate(columns, ordered[1::2])


def _max_predicted_gain(lines: Sequence[ResponseLine]) -> float:
    """Largest gain that a line predicts, at its best step or where it was simulated."""
    return max((max(line.best_gain, line.gain(1.0)) for line in lines), default=0.0)


def _midpoints(
    parameters: ParameterSet, candidate: CandidateTerm, lines: Sequence[ResponseLine]
) -> list[tuple[float, ...]]:
    """Geometric means of the best magnitude and its neighbours; none if the smallest one overshoots."""
    (column,) = candidate.columns
    gains = {float(parameters.from_search(line.point)[column]): line.gain(1.0) for line in lines}
    sizes = sorted(gains)
    # Of those that do not act at all, the last before the threshold.
    best = max(range(len(sizes)), key=lambda k: (gains[sizes[k]], sizes[k]), default=0)
    if best == 0 and sizes and gains[sizes[0]] < 0.0:
        return []
    return [(math.sqrt(one * other),) for one, other in pairwise(sizes[max(best - 1, 0) : best + 2]) if one > 0.0]


def _scaled_to_residual(
    response: LinearResponse, candidate: CandidateTerm, lines: Sequence[ResponseLine]
) -> list[Tried]:
    """Each shape of a candidate at a magnitude that changes :data:`LINEAR_RESPONSE_SHARE` of the residual."""
    columns = list(candidate.columns)
    least: dict[tuple[float, ...], ResponseLine] = {}
    for line in lines:
        shape = tuple(line.point[columns[1:]])
        if shape not in least or line.length_before < least[shape].length_before:
            least[shape] = line
    aim = LINEAR_RESPONSE_SHARE * math.sqrt(float(response.remaining @ response.remaining))
    values: list[tuple[float, ...]] = []
    for line in least.values():
        if line.length_before > aim:
            magnitude, *rest = response.objective.parameters.from_search(line.point)[columns]
            values.append((magnitude * aim / line.length_before, *rest))
    return response.simulate(columns, values)


def _line_starts(response: LinearResponse, candidate: CandidateTerm, lines: Sequence[ResponseLine]) -> list[Start]:
    """Starts at both ends of the likeliest lines: the simulated point and the best step."""
    acting = [line for line in lines if line.squared_length > 0.0]
    ends: list[tuple[ResponseLine, float]] = []
    for steps in ([1.0] * len(acting), [line.bounded_step for line in acting]):
        ends += sorted(zip(acting, steps, strict=True), key=lambda end: -end[0].gain(end[1]))[:MAX_LINES]
    starts = [(line.best_gain, response.point_on_line(candidate, line, step)) for line, step in ends]
    if response.gain_under_white_noise(_max_predicted_gain(lines)) < MIN_LINE_GAIN:
        return [Start(point, predicted) for predicted, point in starts]
    gains = response.simulated_gains([point for _, point in starts])
    found = [Start(point, predicted, gain) for (predicted, point), gain in zip(starts, gains, strict=True)]
    if ends and all(s.simulated_gain < 0.0 for s in found):
        # A magnitude that is just visible: from there a local fit follows the gradient.
        line, _ = ends[0]
        point = response.point_on_line(candidate, line, 1.0 / max(line.length_before, 1e-300), readjusted=False)
        found.append(Start(point, line.best_gain, response.simulated_gains([point])[0]))
    return [s for s in found if math.isfinite(s.simulated_gain)]


def _refit_with_term_fixed(response: LinearResponse, lines: Sequence[ResponseLine]) -> list[Start]:
    """Starts at the likeliest nominal parameters, the other parameters refitted in a few steps."""
    settings = LocalFitSettings(hold_noise=True).with_limits(6, 0.5)
    acting = sorted((line for line in lines if line.length_before > 1.0), key=lambda line: -line.gain(1.0))
    present, found = response.base.whitened.log_likelihood, []
    for line in acting[:MAX_LINES]:
        with suppress(CannotFinishError):
            end = local_fit(
                response.objective, line.point, response.base.free, noise=response.base.noise, settings=settings
            )
            found.append(Start(end.coordinates, line.best_gain, end.log_likelihood - present))
    return found


@dataclass(frozen=True)
class Tangent:
    """One Newton step along all parameters of the new terms together, and half of it.

    For terms that are linear in their parameters, such as learned curves, and for pairs of terms that explain much
    together and little alone.
    """

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        new = [fitted.model.candidates[t] for t in structure.new_terms(fitted.structure)]
        if not new or (len(new) == 1 and new[0].starts):
            return []
        response, parameters = fitted.response, fitted.model.objective.parameters
        base, free = response.base, list(response.base.free)
        columns = [j for c in new for j in (c.columns if not c.starts else c.columns[:1])]
        origin = with_nominal_shapes(fitted, new)
        slopes = response.readjusted_slopes(origin, columns)
        if slopes is None:
            return []
        across, _, back = slopes
        first, second = parameters.prior_derivatives(origin)
        curvature = across @ across.T + prior_curvature(second[columns])
        slope = across @ response.remaining + first[columns]
        step = np.linalg.solve(curvature, slope)
        low, high = parameters.box
        points = []
        for share in (1.0, 0.5):
            point = origin.copy()
            point[columns] = np.clip(point[columns] + share * step, low[columns], high[columns])
            point[free] = np.clip(
                base.coordinates[free] + response.free_step - share * (step @ back), low[free], high[free]
            )
            points.append(point)
        gains = response.simulated_gains(points)
        predicted = 0.5 * float(slope @ step)
        return [Start(p, predicted, gain) for p, gain in zip(points, gains, strict=True) if math.isfinite(gain)]


def with_nominal_shapes(fitted: FittedModel, candidates: Sequence[CandidateTerm]) -> FloatArray:
    """Search coordinates of a fit with the shapes of some candidates at their first nominal values, magnitudes off."""
    parameters = fitted.model.objective.parameters
    values = parameters.from_search(fitted.optimum.coordinates)
    for candidate in candidates:
        if candidate.starts:
            values[list(candidate.columns[1:])] = candidate.starts[0][1:]
    return parameters.to_search(values)


@dataclass(frozen=True)
class OffBounds:
    """As :class:`NominalSizes`, parameters of the first model that ended on a bound put back to their starting values.

    A fit that lacks a term may have moved them to where the term has no effect.
    """

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        model, base = fitted.model, fitted.optimum
        if not fitted.parameters_on_bound:
            return []
        at = model.objective.parameters.revived(base.coordinates, model.own)
        evaluation = model.objective.evaluate(at, base.free)
        if evaluation is None:
            return []
        white = model.objective.whiten(evaluation, base.noise)
        there = replace(
            base, coordinates=at, evaluation=evaluation, whitened=white, log_likelihood=white.log_likelihood
        )
        behind = base.whitened.log_likelihood - white.log_likelihood
        found = NominalSizes().starts(replace(fitted, optimum=there), structure)
        return [Start(s.point, s.expected_gain - behind, s.simulated_gain - behind) for s in found]


@dataclass(frozen=True)
class KnownTerms:
    """The values that the new terms have in other fits.

    Parameters
    ----------
    values : mapping of str to mapping of str to float
        SI values of a term's parameters by name, by the term's id.
    """

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        new = structure.new_terms(fitted.structure)
        if not new or any(id_ not in self.values for id_ in new):
            return []
        known = {name: value for id_ in new for name, value in self.values[id_].items()}
        point = fitted.model.at(fitted.values | known, structure.terms)
        gain = fitted.response.simulated_gains([point])[0]
        return [Start(point, gain, gain)] if math.isfinite(gain) else []


#: The start rules of a search, in the order in which they are asked.
START_RULES: tuple[StartRule, ...] = (NominalSizes(), OffBounds(), Tangent())
