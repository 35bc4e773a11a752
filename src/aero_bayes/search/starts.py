"""Starting points for the fit of a larger structure: rules that give points with the gain they predict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.parameters import ParameterSet, prior_curvature
from aero_bayes.laws.model_family import CandidateTerm
from aero_bayes.search.models import FittedModel
from aero_bayes.search.refit import own_noise_fits
from aero_bayes.search.response import LinearResponse, ResponseLine, SimulatedPoint
from aero_bayes.search.structure import Structure

#: Magnitudes in a grid, and halvings of the grid about its best point.
GRID_POINTS, GRID_HALVINGS = 6, 3
#: Change of the outputs, as a share of the residual, up to which the response to a magnitude counts as linear.
LINEAR_RESPONSE_SHARE = 0.3
#: Gain in log-likelihood below which a line is not followed: half of the gain that a start must predict for a fit.
MIN_LINE_GAIN = 1.0
#: Nominal points of each origin from which local fits begin, and their first steps: three tell which lead anywhere.
FIRST_FITS, FIRST_STEPS = 2, 3
#: Share of the squared residual that a term must promise to take away beside other terms: beside the right ones
#: predictions hold, and a smaller share is not material.
MIN_SHARE_BESIDE_TERMS = 0.01
#: Fits that go on, and up to how many steps: about ten in all, since along a curved valley a prediction tells little.
BEST_FITS, NEXT_STEPS = 2, 7


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
    others follow by their predicted gain."""
    found = [start for rule in rules for start in rule.starts(fitted, structure)]
    found.sort(key=lambda s: -s.predicted_gain)
    confirmed = max(found, key=lambda s: s.simulated_gain, default=None)
    return sorted(found, key=lambda s: s is not confirmed)


def _single_new_term(fitted: FittedModel, structure: Structure) -> CandidateTerm | None:
    new = structure.new_terms(fitted.structure)
    return fitted.model.candidates[new[0]] if len(new) == 1 else None


@dataclass(frozen=True)
class NominalValues:
    """Local fits with a term at its nominal parameters: a few steps from the likeliest, and more from the best of them.

    They begin at the fit and, where no term is in it yet, at the declared values of the first model's parameters: a fit
    that lacks a term may have moved them to where the term has no effect."""

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        candidate = _single_new_term(fitted, structure)
        if candidate is None or not candidate.starts:
            return []
        declared = fitted.at_declared_values if not fitted.terms else None
        begun = _begin(fitted, candidate, 0.0)
        if declared is not None:
            behind = fitted.optimum.log_likelihood - declared.optimum.log_likelihood
            begun += _begin(declared, candidate, behind)
        if fitted.terms:
            begun = [start for start in begun if start.expected_gain >= least_gain_beside_terms(fitted)]
        ends = _local_fits(fitted, structure, begun, FIRST_STEPS)
        best = [s for s in ends if fitted.response.gain_under_white_noise(s.simulated_gain) >= MIN_LINE_GAIN]
        return [*_local_fits(fitted, structure, best[:BEST_FITS], NEXT_STEPS), *best[BEST_FITS:], *begun[:1]]


def least_gain_beside_terms(fitted: FittedModel) -> float:
    """Return the gain in log-likelihood that a term must promise beside those of a fit."""
    residual = fitted.optimum.whitened.residual
    return 0.5 * MIN_SHARE_BESIDE_TERMS * float(residual @ residual)


def _begin(origin: FittedModel, candidate: CandidateTerm, behind: float) -> list[Start]:
    """The likeliest nominal points about an origin, whose log-likelihood is ``behind`` that of the fit."""
    response = origin.response
    lines = nominal_lines(response, candidate)
    if response.gain_under_white_noise(_max_predicted_gain(lines)) < MIN_LINE_GAIN:
        lines += [response.line(*tried) for tried in _scaled_to_residual(response, candidate, lines)]
    acting = [line for line in lines if line.squared_length > 0.0]
    # Beyond a threshold the response is not proportional to the magnitude: what a line predicts is sure only where it
    # was simulated.
    nearest = max((a for a in acting if a.gain(1.0) > 0.0), key=lambda a: a.gain(1.0), default=None)
    likeliest = sorted(acting, key=lambda a: (a is not nearest, -a.gain(a.bounded_step)))
    found: list[Start] = []
    for line in likeliest:
        step = line.bounded_step
        point = response.point_on_line(candidate, line, step)
        found.append(Start(point, line.gain(step) - behind))
    if acting and found[0].expected_gain + behind <= 0.0:
        # A magnitude that is just visible: from there a local fit follows the gradient.
        line = max(acting, key=lambda a: a.best_gain)
        small = 1.0 / max(line.length_before, 1e-300)
        found.insert(0, Start(response.point_on_line(candidate, line, small, readjusted=False), -behind))
    return found[:FIRST_FITS]


def _local_fits(fitted: FittedModel, structure: Structure, starts: Sequence[Start], steps: int) -> list[Start]:
    """Where local fits of a structure are after some steps from each start, best first."""
    settings = LocalFitSettings().at_temperature(fitted.temperature)
    settings = replace(settings, local=replace(settings.local, iterations=steps))
    ends = own_noise_fits(fitted, structure, [start.point for start in starts], settings)
    gains = [end.log_likelihood - fitted.optimum.log_likelihood for end in ends]
    found = [Start(end.coordinates, gain, gain) for end, gain in zip(ends, gains, strict=True)]
    return sorted(found, key=lambda s: -s.simulated_gain)


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


def _simulate_nominal(response: LinearResponse, candidate: CandidateTerm) -> list[SimulatedPoint]:
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
) -> list[SimulatedPoint]:
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


@dataclass(frozen=True)
class Tangent:
    """One Newton step along all parameters of the new terms together, and half of it.

    For terms that are linear in their parameters, such as learned curves, and for pairs of terms that explain much
    together and little alone."""

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


def with_nominal_shapes(
    fitted: FittedModel, candidates: Sequence[CandidateTerm], shapes: Sequence[tuple[float, ...]] | None = None
) -> FloatArray:
    """Search coordinates of a fit with the shapes of some candidates at nominal values, magnitudes off."""
    parameters = fitted.model.objective.parameters
    values = parameters.from_search(fitted.optimum.coordinates)
    first = [c.starts[0][1:] if c.starts else () for c in candidates]
    for candidate, shape in zip(candidates, shapes or first, strict=True):
        if candidate.starts:
            values[list(candidate.columns[1:])] = shape
    return parameters.to_search(values)


@dataclass(frozen=True)
class KnownTerms:
    """The values that the new terms have in other fits."""

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def starts(self, fitted: FittedModel, structure: Structure) -> Iterable[Start]:
        new = structure.new_terms(fitted.structure)
        if not new or any(id_ not in self.values for id_ in new):
            return []
        known = {name: value for id_ in new for name, value in self.values[id_].items()}
        point = fitted.model.coordinates_of(fitted.values | known, structure.terms)
        gain = fitted.response.simulated_gains([point])[0]
        return [Start(point, gain, gain)] if math.isfinite(gain) else []


#: The start rules of a search, in the order in which they are asked.
START_RULES: tuple[StartRule, ...] = (NominalValues(), Tangent())
