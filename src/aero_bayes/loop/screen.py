"""What a term promises beside a fit, without a fit: one gradient at each nominal shape, and simulations where it fails.

The Newton step of a law whose slope at size zero is seen says how much it explains. Where that tells too little (a
law with a threshold, or a fit that ended in a local optimum without it), it is simulated at its nominal sizes, too. The
free parameters of the fit readjust to first order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.other_reading import after_step
from aero_bayes.estimate.parameters import prior_curvature
from aero_bayes.loop.folds import Folds
from aero_bayes.loop.models import CandidateModel, FittedModel
from aero_bayes.loop.table import MATERIAL

#: Share of a prediction that a simulation has to confirm, and share that counts where it does not: in a bent valley a
#: fit may yet get there.
CONFIRMED, UNCONFIRMED = 0.5, 0.3
#: Fall of the logarithm of the error below which a term is not fitted beside others: 3 % is not material.
LEAST_FALL = 0.03
#: Smallest and largest step along a line, as multiples of the step that was simulated.
MIN_STEP, MAX_STEP = 0.05, 3.0
#: Points that are kept for a term: two sources, each with two signs or shapes.
MOST_POINTS = 4


#: Responses (see :class:`Screened`) from which a term counts as barely visible, and as visible.
MIN_BARELY_VISIBLE, MIN_VISIBLE = 3.0, 30.0
#: Share of a term's change of the outputs up to which parameters do the same.
MOST_LEFT = 0.1


#: What tells points of a term apart: what was at hand, the sign of the size, and the shape.
Kind = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Promise:
    """Search coordinates ``point`` (p,) where a fit with the term may begin, and the fall of the score to expect."""

    gain: float
    point: FloatArray
    kind: Kind


@dataclass(frozen=True)
class Screened:
    """Promises of a term, best first, and the smallest size that would have been seen.

    With that size, in the unit of ``parameter`` (name, unit), taking it away would be material. ``response`` is what
    its nominal size moves the outputs by, in deviations of the sensors' noise; where parameters do the same, these are
    ``imitators``. It took ``seconds``."""

    promises: tuple[Promise, ...] = ()
    smallest: float = math.inf
    response: float = 0.0
    imitators: tuple[str, ...] = ()
    port: str = ""
    parameter: tuple[str, str] = ("", "")
    seconds: float = field(default=0.0, compare=False)

    @property
    def gain(self) -> float:
        """Fall of the score to expect."""
        return self.promises[0].gain if self.promises else -math.inf


@dataclass(eq=False)
class Screen:
    """Screens one term beside a fit; ``model`` has the terms of the fit and that one.

    ``sensors`` are deviations of the outputs' noise (m,) by the readings alone, infinite where these do not tell."""

    fitted: FittedModel
    model: CandidateModel
    term: str
    folds: Folds
    sensors: FloatArray
    found: list[Promise] = field(default_factory=list)
    smallest: float = math.inf
    seen: float = 0.0
    imitators: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        parameters, optimum = self.model.objective.parameters, self.fitted.optimum
        names = self.fitted.model.objective.parameters.names
        self.candidate = self.model.candidates[self.term]
        self.columns = list(self.candidate.columns)
        self.origin = self.model.coordinates_of(self.fitted.values, self.fitted.terms)
        self.free = [parameters.index(names[j]) for j in optimum.free]
        self.response, self.noise = self.fitted.response, self.fitted.noise
        self.left = self.folds.sums(self.response.remaining)
        self.here = self.folds.on_fitted(self.fitted.optimum)

    def run(self, known: Sequence[tuple[float, ...]] = ()) -> Screened:
        """Screen the term; ``known`` are values (SI) that it has in other fits.

        Beside the first model a slope tells only what is material, beside others what a simulation confirms."""
        starts = self.candidate.starts
        for shape in dict.fromkeys(start[1:] for start in starts) if starts else [()]:
            self._by_slope(shape)
        predicted = max((p.gain for p in self.found), default=math.inf)
        self._verify()
        needed = min(CONFIRMED * predicted, LEAST_FALL) if self.fitted.terms else -math.log(MATERIAL)
        gained = self.found[0].gain if self.found else -math.inf
        tell = not starts or gained >= needed or predicted < (LEAST_FALL if self.fitted.terms else 0.0)
        if not tell or known:
            self._by_simulation([*([] if tell else starts), *known])
            self._verify()
        size = self.model.objective.parameters.items[self.columns[0]]
        return Screened(
            tuple(self.found), self.smallest, self.seen, self.imitators, self.candidate.port, (size.name, size.unit)
        )

    def _by_slope(self, shape: tuple[float, ...]) -> None:
        """The Newton step in the size at one shape, or in all heights of a curve."""
        objective = self.model.objective
        parameters = objective.parameters
        values = parameters.from_search(self.origin)
        values[self.columns[1 : 1 + len(shape)]] = shape
        origin = parameters.to_search(values)
        columns = self.columns[:1] if self.candidate.starts else self.columns
        evaluation = objective.evaluate(origin, columns)
        if evaluation is None:
            return
        changes = objective.whiten(evaluation, self.fitted.optimum.noise).slopes
        across, back = self.response.readjusted(changes)
        if not np.any(across):
            return
        first, second = (d[columns] for d in parameters.prior_derivatives(origin))
        curvature = across @ across.T + prior_curvature(second)
        step = np.linalg.lstsq(curvature, across @ self.response.remaining + first, rcond=1e-12)[0]
        low, high = (bound[columns] for bound in parameters.box)
        step = np.clip(origin[columns] + step, low, high) - origin[columns]
        point = origin.copy()
        point[columns] += step
        sign = math.copysign(1.0, step[0]) if self.candidate.starts else 0.0
        self._add(point, step @ across, step @ back, (1.0,), (0.0, sign, *shape))
        if self.candidate.starts:
            unit = float(parameters.jacobian(values)[columns[0]])
            self._note_size(across[0], unit, float(high[0] - low[0]))
            off = parameters.items[columns[0]].start
            self._note_response(changes[0], across[0], abs(self.candidate.starts[0][0] - off) / unit)

    def _by_simulation(self, tried: Sequence[tuple[float, ...]]) -> None:
        """The best step towards each of some values of the term's parameters."""
        objective = self.model.objective
        parameters = objective.parameters
        si = np.repeat(parameters.from_search(self.origin)[np.newaxis], len(tried), axis=0)
        for row, values in zip(si, tried, strict=True):
            row[self.columns[: len(values)]] = values
        rows, off = parameters.to_search(si), parameters.items[self.columns[0]].start
        for start, point, there in zip(tried, rows, objective.residuals(rows), strict=True):
            if there is None:
                continue
            change = self.fitted.optimum.whitened.residual
            change = change - objective.whiten(there, self.fitted.optimum.noise).residual
            across, back = self.response.readjusted(change[np.newaxis])
            size = abs(start[0] - off)
            self._add(point, across[0], back[0], (), (1.0, math.copysign(1.0, start[0] - off), *start[1:]))
            if np.any(self.folds.sums(across[0]) >= SEEN * self.left):
                self.smallest = min(self.smallest, size)

    def _note_size(self, across: FloatArray, unit: float, room: float) -> None:
        """Note the size (a coordinate of ``unit`` SI units) whose signature would be seen in what is left."""
        signature = self.folds.sums(across)
        acting = signature > 0.0
        if np.any(acting):
            size = float(np.sqrt(np.min(SEEN * self.left[acting] / signature[acting])))
            if size <= room:
                self.smallest = min(self.smallest, size * unit)

    def _note_response(self, change: FloatArray, across: FloatArray, nominal: float) -> None:
        """Note what the nominal size, as a coordinate, moves, and where that is little the parameters that do the same.

        A fit that lacks an effect is no measure of noise: then the sensors' own is."""
        weights = (self.noise / np.minimum(self.sensors, self.noise)) ** 2
        whole, left = (nominal * math.sqrt(float(self.folds.sums(row) @ weights)) for row in (change, across))
        self.seen = max(self.seen, left)
        if whole < MIN_VISIBLE or left >= MIN_BARELY_VISIBLE:
            return
        slopes, names = self.response.slopes, self.fitted.model.objective.parameters.names
        sizes, chosen, rest = np.maximum(np.linalg.norm(slopes, axis=1), 1e-300), list[int](), change
        while np.linalg.norm(rest) > MOST_LEFT * np.linalg.norm(change) and len(chosen) < len(slopes):
            chosen.append(int(np.argmax(np.abs(slopes @ rest) / sizes)))
            rest = after_step(slopes[chosen], change)
        self.imitators = tuple(names[self.fitted.optimum.free[k]] for k in chosen)

    def _add(
        self, point: FloatArray, direction: FloatArray, back: FloatArray, steps: Sequence[float], kind: Kind
    ) -> None:
        """Add the best of some steps along a line; by default of the one that was simulated and the best one."""
        power = float(direction @ direction)
        if not 0.0 < power < math.inf:
            return
        remaining = self.response.remaining
        weights = remaining * direction
        along = np.bincount(self.folds.owner, weights=weights, minlength=len(self.left))
        across = self.folds.sums(direction)
        best, score = 1.0, math.inf
        for step in steps or (1.0, float(np.clip(along.sum() / power, MIN_STEP, MAX_STEP))):
            left = np.maximum(self.left - 2.0 * step * along + step * step * across, 1e-12 * self.left)
            one = float(np.sum(0.5 * np.log(np.maximum(left * self.noise**2, np.maximum(self.folds.least, 1e-300)))))
            best, score = (step, one) if one < score else (best, score)
        point, size, parameters = point.copy(), self.columns[0], self.model.objective.parameters
        if best != 1.0:
            off = self.origin[size]
            point[size] = off + best * (point[size] - off)
        moved = self.response.free_step - best * back
        point[self.free] = self.origin[self.free] + moved
        self.found.append(Promise(self.here - score, np.clip(point, *parameters.box), kind))

    def _verify(self) -> None:
        """Simulate the best promises of different kinds, and sort them by what to expect of each."""
        self.found.sort(key=lambda p: p.gain)
        kept = sorted({p.kind: p for p in self.found}.values(), key=lambda p: -p.gain)[:MOST_POINTS]
        self.found.clear()
        objective, noise = self.model.objective, self.fitted.optimum.noise
        for p, there in zip(kept, objective.residuals(np.array([p.point for p in kept])) if kept else [], strict=True):
            if there is not None:
                gain = self.here - self.folds.score(objective.whiten(there, noise).residual, self.noise)
                if math.isfinite(gain):
                    self.found.append(Promise(max(gain, UNCONFIRMED * p.gain), p.point, p.kind))
        self.found.sort(key=lambda p: -p.gain)


#: Square of a signature, over the squared error that a fit leaves, from which a term would be material.
SEEN = 1.0 / MATERIAL**2 - 1.0
