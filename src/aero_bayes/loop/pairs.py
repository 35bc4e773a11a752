"""Two candidates that are worth little alone and much together: what both foretell to first order, in closed form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from aero_bayes.loop.stand import Stand
from aero_bayes.loop.starting import Around
from aero_bayes.physics.kin import Candidate

FloatArray = NDArray[np.float64]

#: Share of what a pair promises that neither may foretell alone for it to be one.
BEYOND = 0.1
#: Shares of a pair's way at which a refit may start.
SHARES = (1.0, 0.7, 0.5, 0.25)
#: Angle between two directions (its sine squared) below which they are one.
APART = 1e-6


@dataclass(frozen=True, eq=False)
class Pair:
    """Two candidates with the SI values of their columns, and how the base's parameters readjust.

    ``readjusted`` is a step in search coordinates, ``promise`` the gain in log-likelihood that is foretold.
    """

    values: Mapping[str, FloatArray]
    readjusted: FloatArray
    promise: float

    @property
    def ids(self) -> tuple[str, ...]:
        """The two."""
        return tuple(self.values)

    def start(self, stand: Stand, around: Around) -> FloatArray:
        """Where a refit may start on a stand that has both: the likeliest of a few shares of the way, by simulation."""
        parameters, base = stand.study.parameters, around.base.coordinates
        values, (low, high) = parameters.from_search(base), parameters.box
        for id_, own in self.values.items():
            values[list(stand.candidates[id_].columns)] = own
        end = parameters.to_search(values)
        end[list(around.base.free)] += self.readjusted
        moving = [*around.base.free, *(stand.candidates[id_].columns[0] for id_ in self.ids)]
        points = np.repeat(end[np.newaxis], len(SHARES), axis=0)
        points[:, moving] = base[moving] + np.outer(SHARES, (end - base)[moving])
        points = np.clip(points, low, high)
        found = stand.study.residuals(points)
        likely = [
            -np.inf if residual is None else stand.study.whiten(residual, None, around.base.noise).log_likelihood
            for residual in found
        ]
        best: FloatArray = points[int(np.argmax(likely))]
        return best


@dataclass(frozen=True, eq=False)
class _Direction:
    """What a candidate changes to first order: in units of the noise, the base's parameters readjusted (``back``)."""

    around: Around
    candidate: Candidate
    point: FloatArray
    across: FloatArray
    back: FloatArray

    @property
    def slope(self) -> float:
        return float(self.across @ self.around.left)

    def room(self) -> tuple[float, float]:
        """How far it may go."""
        low, high = self.around.study.parameters.box
        size = self.candidate.columns[0]
        return float(low[size] - self.point[size]), float(high[size] - self.point[size])

    def values(self, reach: float) -> FloatArray:
        """SI values of its columns so far along."""
        point = self.point.copy()
        point[self.candidate.columns[0]] += reach
        found: FloatArray = self.around.study.parameters.from_search(point)[list(self.candidate.columns)]
        return found


def likely_pairs(beside: Sequence[tuple[Around, Sequence[Candidate]]], most: int) -> list[Pair]:
    """The pairs that promise most, and more than either alone; surroundings of one base on different stands."""
    found = [direction for around, candidates in beside for direction in _directions(around, candidates)]
    if len(found) < 2:
        return []
    rows = np.stack([d.across for d in found])
    gram, slope = rows @ rows.T, np.array([d.slope for d in found])
    room = np.array([d.room() for d in found])
    alone = np.array([_gain(gram[k : k + 1, k : k + 1], slope[k : k + 1], room[k : k + 1]) for k in range(len(found))])
    pairs = []
    for i, j in combinations(range(len(found)), 2):
        both = [i, j]
        inner = gram[np.ix_(both, both)]
        if np.linalg.det(inner) <= APART * inner[0, 0] * inner[1, 1]:
            continue
        promise = _gain(inner, slope[both], room[both])
        if promise <= 0.0 or promise - alone[both].max() < BEYOND * promise:
            continue
        reach = np.linalg.solve(inner, slope[both])
        values = {found[k].candidate.id: found[k].values(x) for k, x in zip(both, reach.tolist(), strict=True)}
        back = reach[0] * found[i].back + reach[1] * found[j].back
        pairs.append(Pair(values, found[i].around.own - back, promise))
    return sorted(pairs, key=lambda pair: -pair.promise)[:most]


def _gain(inner: FloatArray, slope: FloatArray, room: FloatArray) -> float:
    """What the best step gains; nothing where it leaves the room that there is."""
    reach = np.linalg.solve(inner, slope)
    if np.any(reach < room[:, 0]) or np.any(reach > room[:, 1]):
        return 0.0
    return 0.5 * float(slope @ reach)


def _directions(around: Around, candidates: Sequence[Candidate]) -> list[_Direction]:
    """Of each candidate that acts from its magnitude zero on, its shape as at its first start."""
    parameters = around.study.parameters
    shaped = [c for c in candidates if c.starts]
    values = parameters.from_search(around.base.coordinates)
    for candidate in shaped:
        values[list(candidate.columns[1:])] = candidate.starts[0][1:]
    point = parameters.to_search(values)
    sizes = [c.columns[0] for c in shaped]
    slopes = around.across(point, sizes) if sizes else None
    if slopes is None:
        return []
    return [
        _Direction(around, candidate, point, across, back)
        for candidate, across, back in zip(shaped, *slopes, strict=True)
        if float(across @ across) > 0.0
    ]
