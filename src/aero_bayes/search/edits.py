"""Edits: rules that give the neighbours of a structure in the search."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Protocol

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.laws.model_family import CandidateTerm
from aero_bayes.search.models import FittedModel
from aero_bayes.search.starts import least_gain_beside_terms, with_nominal_shapes
from aero_bayes.search.structure import Structure

#: Share of a term's squared sensitivity outside the span of the free parameters' sensitivities, below which they are
#: said to imitate the term.
MAX_UNIQUE_SHARE = 1e-7
#: Largest share of a pair's gain that either term may have alone, and the largest number of pairs.
MAX_SINGLE_GAIN_SHARE, MAX_PAIRS = 0.1, 5
#: Squared sine of the angle between two directions below which they count as one.
MIN_SQUARED_SINE = 1e-6


@dataclass(frozen=True, eq=False)
class EditContext:
    """What an edit knows of a fitted structure.

    Parameters
    ----------
    fitted : FittedModel
    adequate : bool
        Whether it leaves only noise.
    offered : tuple of str
        Terms of the library.
    refines : mapping of str to str
        For each offered term that refines another, that one.
    curves : tuple of str
        Offered terms that learn a curve.
    rivals : tuple of str
        Terms of the best structures so far.
    free_later : tuple of str
        Parameters that may be freed.
    directions : tuple of Direction
        What the magnitude of each offered term changes to first order.
    interpolation_is_free : bool
        Whether the inputs may be read the other way.
    best : bool
        Whether it is the best structure so far.
    near : tuple of Structure
        The best structures of the size of the best one.
    """

    fitted: FittedModel
    adequate: bool
    offered: tuple[str, ...]
    refines: Mapping[str, str]
    curves: tuple[str, ...]
    rivals: tuple[str, ...]
    free_later: tuple[str, ...]
    directions: tuple[Direction, ...]
    interpolation_is_free: bool
    best: bool
    near: tuple[Structure, ...] = ()

    @property
    def structure(self) -> Structure:
        return self.fitted.structure


class Edit(Protocol):
    """Gives the neighbours of a structure."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        """Structures that are worth a fit, given the fit of one."""
        ...


class AddTerm:
    """Each law of the library at each port that it fits.

    Refinements are offered only where structure is left. A term whose slope the free parameters imitate is not
    offered; nor is one that promises hardly anything beside other terms."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        needless = {d.id for d in context.directions if d.confounded}
        if context.structure.terms:
            least = least_gain_beside_terms(context.fitted)
            finer = {f for f, coarse in context.refines.items() if coarse in context.structure.terms}
            needless |= {d.id for d in context.directions if d.gain < least and d.id not in finer}
        for id_ in context.offered:
            fine = id_ in context.refines and context.adequate
            if id_ in context.structure.terms or id_ in needless or id_ in context.curves or fine:
                continue
            yield with_term(context, context.structure, id_)


class AddCurve:
    """A learned curve at each port beside the laws: it bounds what any law at its port can explain."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if context.adequate or not (context.best or not context.structure.terms):
            return
        taken = {port_of(t) for t in context.structure.terms}
        for id_ in context.curves:
            if port_of(id_) not in taken:
                yield context.structure.plus(id_)


class AddPair:
    """Two terms that explain much together and little alone, predicted by the linearised response."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if context.adequate or not context.best:
            return
        special = {*context.curves, *context.refines}
        for one, other in likely_pairs([d for d in context.directions if d.id not in special]):
            yield context.structure.plus(one, other)


class RefineTerm:
    """Each term replaced by its finer laws."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if not context.best:
            return
        for finer, coarse in context.refines.items():
            if coarse in context.structure.terms and finer in context.offered:
                yield with_term(context, context.structure, finer)


class DropTerm:
    """The structure without each of its terms."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if context.best:
            for id_ in context.structure.terms:
                yield context.structure.minus(id_)


class ReplaceTerm:
    """Each term replaced by a term of the best structures so far."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if not context.best or len(context.structure) < 2:
            return
        for id_ in context.structure.terms:
            for other in context.rivals:
                if other not in context.structure.terms:
                    yield with_term(context, context.structure.minus(id_), other)


class FreeParameter:
    """Each parameter that the configuration frees later."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if not context.best:
            return
        for name in context.free_later:
            if name not in context.structure.freed:
                yield replace(context.structure, freed=(*context.structure.freed, name))


class InputInterpolation:
    """The inputs read the other way between their samples: held, or along straight lines.

    The best structures of the same size are tried so, too: else the best one is compared with others that read the
    inputs wrongly."""

    def neighbours(self, context: EditContext) -> Iterable[Structure]:
        if context.best and context.interpolation_is_free:
            # The wrong interpolation shifts an input by half a sample, which a lag or a delay imitates.
            smaller = [context.structure.minus(id_) for id_ in context.structure.terms]
            for structure in dict.fromkeys((context.structure, *context.near, *smaller)):
                yield replace(structure, other_interpolation=not structure.other_interpolation)


#: The edits of a search, in the order in which they are asked.
EDITS: tuple[Edit, ...] = (
    DropTerm(), InputInterpolation(), FreeParameter(), AddTerm(), AddCurve(), AddPair(), RefineTerm(), ReplaceTerm(),
)  # fmt: skip


def port_of(id_: str) -> str:
    """Return the port of a term ``law@port``."""
    return id_.rpartition("@")[2]


def with_term(context: EditContext, structure: Structure, id_: str) -> Structure:
    """Return a structure with a further term, which takes the place of what it refines."""
    coarse = context.refines.get(id_)
    return structure.minus(coarse).plus(id_) if coarse is not None else structure.plus(id_)


@dataclass(frozen=True, eq=False)
class Direction:
    """What the magnitude of a term changes to first order, once the free parameters have readjusted."""

    id: str
    readjusted_sensitivity: FloatArray
    slope: float
    step_bounds: tuple[float, float]
    confounded: bool
    gain: float = math.inf


def term_directions(fitted: FittedModel) -> list[Direction]:
    """Directions of the terms at hand that a fit does not have, their shapes at their first nominal values.

    Beside other terms the other nominal shapes are tried too, where the first promises hardly anything: simulations
    with a magnitude of zero are the quickest."""
    candidates = [c for id_, c in fitted.model.candidates.items() if id_ not in fitted.terms and c.starts]
    found = {d.id: d for d in _directions(fitted, candidates, 0)}
    most = max((len(_shapes(c)) for c in candidates), default=0) if fitted.terms else 0
    least = least_gain_beside_terms(fitted)
    for k in range(1, most):
        unsure = [c for c in candidates if c.id in found and found[c.id].gain < least and k < len(_shapes(c))]
        for other in _directions(fitted, unsure, k):
            known = found[other.id]
            # A shape that nothing shows to first order promises nothing, where another one is seen.
            if math.isfinite(other.gain):
                found[other.id] = replace(known, gain=max(known.gain, other.gain))
    return list(found.values())


def _shapes(candidate: CandidateTerm) -> list[tuple[float, ...]]:
    """Return its distinct nominal shapes."""
    return list(dict.fromkeys(start[1:] for start in candidate.starts))


def _directions(fitted: FittedModel, candidates: Sequence[CandidateTerm], shape: int) -> list[Direction]:
    """Directions of some terms at hand, each at one of its nominal shapes."""
    model, response = fitted.model, fitted.response
    origin = with_nominal_shapes(fitted, candidates, [_shapes(c)[shape] for c in candidates])
    sizes = [c.columns[0] for c in candidates]
    slopes = response.readjusted_slopes(origin, sizes) if sizes else None
    if slopes is None:
        return []
    left = float(response.remaining @ response.remaining)
    low, high = model.objective.parameters.box
    beyond = slopes[1] - _projected(slopes[1], response.base.whitened.slopes)
    found = []
    for k, (candidate, across, alone) in enumerate(zip(candidates, slopes[0], slopes[1], strict=True)):
        size, whole = candidate.columns[0], float(alone @ alone)
        if whole > 0.0:
            room = float(low[size] - origin[size]), float(high[size] - origin[size])
            # A term whose whole range changes less than the noise is invisible to first order, so nothing imitates it.
            seen = math.sqrt(whole) * max(-room[0], room[1]) > 1.0
            confounded = seen and float(beyond[k] @ beyond[k]) < MAX_UNIQUE_SHARE * whole
            slope = float(across @ response.remaining)
            # What changes less than is left to explain, over its whole range, acts elsewhere than to first order.
            told = math.sqrt(whole) * max(-room[0], room[1]) > math.sqrt(left)
            gain = _gain_within(float(across @ across), slope, room) if told else math.inf
            found.append(Direction(candidate.id, across, slope, room, confounded, gain))
    return found


def _gain_within(curvature: float, slope: float, room: tuple[float, float]) -> float:
    """Predicted gain of the best step within bounds."""
    step = min(max(slope / max(curvature, 1e-300), room[0]), room[1])
    return slope * step - 0.5 * curvature * step**2


def _projected(rows: FloatArray, slopes: FloatArray) -> FloatArray:
    """Projection of rows (q, N) onto the span of some slopes (f, N)."""
    unit = np.linalg.norm(slopes, axis=1)
    basis = slopes[unit > 0.0] / unit[unit > 0.0, np.newaxis]
    return np.asarray((rows @ basis.T) @ np.linalg.pinv(basis @ basis.T, 1e-12, hermitian=True) @ basis)


def likely_pairs(directions: list[Direction]) -> list[tuple[str, str]]:
    """Pairs with the largest predicted gain, if it is larger than that of either term alone."""
    acting = [d for d in directions if not d.confounded]
    if len(acting) < 2:
        return []
    rows = np.stack([d.readjusted_sensitivity for d in acting])
    gram, slope, room = rows @ rows.T, np.array([d.slope for d in acting]), np.array([d.step_bounds for d in acting])
    alone = [_gain(gram[k : k + 1, k : k + 1], slope[k : k + 1], room[k : k + 1]) for k in range(len(acting))]
    pairs: list[tuple[float, str, str]] = []
    for i, j in combinations(range(len(acting)), 2):
        both = [i, j]
        inner = gram[np.ix_(both, both)]
        if np.linalg.det(inner) <= MIN_SQUARED_SINE * inner[0, 0] * inner[1, 1]:
            continue
        promise = _gain(inner, slope[both], room[both])
        if promise > 0.0 and promise - max(alone[i], alone[j]) >= MAX_SINGLE_GAIN_SHARE * promise:
            pairs.append((promise, acting[i].id, acting[j].id))
    return [(one, other) for _, one, other in sorted(pairs, key=lambda pair: -pair[0])[:MAX_PAIRS]]


def _gain(inner: FloatArray, slope: FloatArray, room: FloatArray) -> float:
    """Predicted gain of the Newton step; zero if it leaves the bounds."""
    step = np.linalg.solve(inner, slope)
    if np.any(step < room[:, 0]) or np.any(step > room[:, 1]):
        return 0.0
    return 0.5 * float(slope @ step)
