"""Where the fit of a larger structure may start: rules that each give points with the gain they promise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import pack_all, unpack_all
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
    """A point (p,) in search coordinates where a fit may start, and the gain in log-likelihood that it promises.

    ``simulated`` is the gain that a simulation at the point found; minus infinity where there was none.
    """

    point: FloatArray
    expected_gain: float
    simulated: float = -math.inf

    @property
    def promise(self) -> float:
        return max(self.expected_gain, self.simulated)


class StartRule(Protocol):
    """Gives starting points for a structure that has terms which a fitted model lacks."""

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        """Points on ``fitted.model``, which has the structure's terms at hand."""
        ...


def starting_points(rules: Sequence[StartRule], fitted: FittedModel, structure: Structure) -> list[Start]:
    """All starts of all rules, looked for once, also in a search that was resumed.

    The start with the best simulated gain comes first: a line may promise what a simulation at its end refutes. The
    others follow by their promise.
    """

    def look() -> dict[str, NDArray[np.generic]]:
        found = [start for rule in rules for start in rule.starts(fitted, structure)]
        found.sort(key=lambda s: -s.promise)
        confirmed = max(found, key=lambda s: s.simulated, default=None)
        return pack_all(sorted(found, key=lambda s: s is not confirmed))

    candidates = [fitted.model.candidates[t] for t in structure.new_terms(fitted.structure)]
    base = fitted.optimum
    asked = base.coordinates, base.free, base.noise, candidates, structure, list(rules)
    return unpack_all(Start, fitted.model.objective.cached("starts", asked, look))


def _one_new(fitted: FittedModel, structure: Structure) -> CandidateTerm | None:
    new = structure.new_terms(fitted.structure)
    return fitted.model.candidates[new[0]] if len(new) == 1 else None


@dataclass(frozen=True)
class NominalSizes:
    """Simulate a term at its nominal parameters; follow the lines through these points, by Gauss-Newton.

    A law with a threshold is no line: a grid of magnitudes is halved about its best, and both ends of the likeliest
    lines are simulated. Where every nominal magnitude changes more than there is to explain, 30 % of the residual is
    tried. Where no simulation confirms the promise, the other parameters are refitted with the term held.
    """

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        candidate = _one_new(fitted, structure)
        if candidate is None or not candidate.starts:
            return []
        response = fitted.response
        lines = nominal_lines(response, candidate)
        if response.possible(_foretold(lines)) < MIN_LINE_GAIN:
            lines += [response.line(*tried) for tried in _smaller(response, candidate, lines)]
        starts = _ends(response, candidate, lines)
        promise = max((s.promise for s in starts), default=0.0)
        much = 0.5 * float(response.left @ response.left) * MIN_REFIT_SHARE
        worth = promise > min(MIN_REFIT_GAIN * fitted.temperature, much)
        if worth and max((s.simulated for s in starts), default=0.0) < MIN_CONFIRMED_SHARE * promise:
            starts += _with_term_held(response, lines)
        return starts


def nominal_lines(response: LinearResponse, candidate: CandidateTerm) -> list[ResponseLine]:
    """Lines through a candidate's nominal parameters."""
    columns, lines = candidate.columns, [response.line(*tried) for tried in _first_look(response, candidate)]
    if len(columns) == 1 and len(candidate.starts) >= GRID_POINTS:
        for _ in range(GRID_HALVINGS):
            between = _between(response.objective.parameters, candidate, lines)
            if not between:
                break
            lines += [response.line(*tried) for tried in response.simulate(columns, between)]
    return lines


def _first_look(response: LinearResponse, candidate: CandidateTerm) -> list[Tried]:
    """A candidate at its nominal parameters; of a grid only every second one if all of these go the wrong way."""
    columns, starts = candidate.columns, candidate.starts
    if len(columns) > 1 or len(starts) < GRID_POINTS:
        return response.simulate(columns, starts)
    ordered = sorted(starts)
    tried = response.simulate(columns, ordered[::2])
    lines = [response.line(*one) for one in tried]
    if lines and all(line.power > 0.0 and line.along <= 0.0 for line in lines):
        return tried
    return tried + response.simulate(columns, ordered[1::2])


def _foretold(lines: Sequence[ResponseLine]) -> float:
    """The most that a line foretells, at its best step or where it was tried."""
    return max((max(line.best_gain, line.gain(1.0)) for line in lines), default=0.0)


def _between(
    parameters: ParameterSet, candidate: CandidateTerm, lines: Sequence[ResponseLine]
) -> list[tuple[float, ...]]:
    """Magnitudes half way between the best and its neighbours; none if the least is too much."""
    (column,) = candidate.columns
    gains = {float(parameters.from_search(line.row)[column]): line.gain(1.0) for line in lines}
    sizes = sorted(gains)
    # Of those that do not act at all, the last before the threshold.
    best = max(range(len(sizes)), key=lambda k: (gains[sizes[k]], sizes[k]), default=0)
    if best == 0 and sizes and gains[sizes[0]] < 0.0:
        return []
    return [(math.sqrt(one * other),) for one, other in pairwise(sizes[max(best - 1, 0) : best + 2]) if one > 0.0]


def _smaller(response: LinearResponse, candidate: CandidateTerm, lines: Sequence[ResponseLine]) -> list[Tried]:
    """Each shape of a candidate at a magnitude that changes :data:`LINEAR_RESPONSE_SHARE` of the residual."""
    columns = list(candidate.columns)
    least: dict[tuple[float, ...], ResponseLine] = {}
    for line in lines:
        shape = tuple(line.row[columns[1:]])
        if shape not in least or line.alone < least[shape].alone:
            least[shape] = line
    aim = LINEAR_RESPONSE_SHARE * math.sqrt(float(response.left @ response.left))
    values: list[tuple[float, ...]] = []
    for line in least.values():
        if line.alone > aim:
            magnitude, *rest = response.objective.parameters.from_search(line.row)[columns]
            values.append((magnitude * aim / line.alone, *rest))
    return response.simulate(columns, values)


def _ends(response: LinearResponse, candidate: CandidateTerm, lines: Sequence[ResponseLine]) -> list[Start]:
    """Both ends of the likeliest lines: where each was tried, and where it is best; simulated if worth it."""
    acting = [line for line in lines if line.power > 0.0]
    ends: list[tuple[ResponseLine, float]] = []
    for steps in ([1.0] * len(acting), [line.within for line in acting]):
        ends += sorted(zip(acting, steps, strict=True), key=lambda end: -end[0].gain(end[1]))[:MAX_LINES]
    starts = [(line.best_gain, response.point(candidate, line, step)) for line, step in ends]
    if response.possible(_foretold(lines)) < MIN_LINE_GAIN:
        return [Start(point, promise) for promise, point in starts]
    gains = response.gains([point for _, point in starts])
    found = [Start(point, promise, gain) for (promise, point), gain in zip(starts, gains, strict=True)]
    if ends and all(s.simulated < 0.0 for s in found):
        # So little of the term as is just seen: from there a local fit follows the slope.
        line, _ = ends[0]
        point = response.point(candidate, line, 1.0 / max(line.alone, 1e-300), readjusted=False)
        found.append(Start(point, line.best_gain, response.gains([point])[0]))
    return [s for s in found if math.isfinite(s.simulated)]


def _with_term_held(response: LinearResponse, lines: Sequence[ResponseLine]) -> list[Start]:
    """The likeliest nominal parameters that act, all else refitted in a few steps."""
    settings = LocalFitSettings(hold_noise=True).with_limits(6, 0.5)
    acting = sorted((line for line in lines if line.alone > 1.0), key=lambda line: -line.gain(1.0))
    present, found = response.base.whitened.log_likelihood, []
    for line in acting[:MAX_LINES]:
        with suppress(CannotFinishError):
            end = local_fit(
                response.objective, line.row, response.base.free, noise=response.base.noise, settings=settings
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
        slopes = response.across(origin, columns)
        if slopes is None:
            return []
        across, _, back = slopes
        first, second = parameters.prior_derivatives(origin)
        curvature = across @ across.T + prior_curvature(second[columns])
        slope = across @ response.left + first[columns]
        step = np.linalg.solve(curvature, slope)
        low, high = parameters.box
        points = []
        for share in (1.0, 0.5):
            point = origin.copy()
            point[columns] = np.clip(point[columns] + share * step, low[columns], high[columns])
            point[free] = np.clip(base.coordinates[free] + response.own - share * (step @ back), low[free], high[free])
            points.append(point)
        gains = response.gains(points)
        promise = 0.5 * float(slope @ step)
        return [Start(p, promise, gain) for p, gain in zip(points, gains, strict=True) if math.isfinite(gain)]


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

    A fit that lacks a term may have led them to where the term shows nothing.
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
        return [Start(s.point, s.expected_gain - behind, s.simulated - behind) for s in found]


@dataclass(frozen=True)
class KnownTerms:
    """The new terms as they were in other fits.

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
        gain = fitted.response.gains([point])[0]
        return [Start(point, gain, gain)] if math.isfinite(gain) else []


#: The start rules of a search, in the order in which they are asked.
START_RULES: tuple[StartRule, ...] = (NominalSizes(), OffBounds(), Tangent())
