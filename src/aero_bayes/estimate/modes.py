"""Other optima that fit as well as the one reported: told, since a posterior of one of them is half of the answer.

They are looked for where symmetries of a model put them (a sign that is squared, two parameters that may swap) and
where particles of the swarm ended, and refined by local fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.local_fit import Optimum, local_fit, unlimited_sd
from aero_bayes.estimate.noise import residual_correlation_time
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.swarm import SwarmResult
from aero_bayes.plain import Number

#: Least probability, beside the reported optimum, of another one that is told.
MIN_MODE_SHARE = 0.02
#: Distance from the reported optimum, in its standard deviations along some parameter, from which one is another; and
#: the least drop of the log-posterior between the two, in nats: along a ridge there is none.
MIN_DISTANCE, MIN_BARRIER = 6.0, 3.0
#: Points of symmetry and particles that are refined.
MAX_REFINED, MAX_PARTICLES = 4, 3
#: Images that are simulated: one run each, without slopes.
MAX_IMAGES = 60
#: Distance of a particle from the optimum, as a share of the box, from which it may have found another one.
MIN_PARTICLE_DISTANCE = 0.1
#: Shares of the way between two optima at which the log-posterior is looked at.
ON_THE_WAY = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Mode:
    """Another optimum: SI values of the free parameters by name, and how likely it is (share of all modes)."""

    values: dict[str, Number]
    share: Number

    def text(self, names: Sequence[str]) -> str:
        """Return values of some parameters, and the share."""
        return f"{', '.join(f'{n} = {self.values[n]:.4g}' for n in names)} ({100.0 * self.share:.0f} % likely)"


def modes_sentence(modes: Sequence[Mode], names: Sequence[str]) -> str:
    """Return what a reader should know of other optima, by the values of some parameters; empty where there is none."""
    if not modes:
        return ""
    others = "; ".join(mode.text(names) for mode in modes)
    return f"{len(modes) + 1} answers fit the recordings about as well. One of them is reported; also: {others}."


def find_modes(search: GlobalSearch, here: Optimum, swarm: SwarmResult | None) -> tuple[Mode, ...]:
    """Find other optima within reach of the reported one, likeliest first."""
    objective, parameters = search.objective, search.objective.parameters
    found: list[Optimum] = []
    for point in (*_images(objective, here), *_particles(here, parameters.box, swarm)):
        with suppress(CannotFinishError):
            settings = replace(search.local_settings, hold_noise=True)
            end = local_fit(objective, point, here.free, noise=here.noise, settings=settings, known=[here, *found])
            if end.reason is not Stop.KNOWN_OPTIMUM and is_another(objective, [here, *found], end):
                found.append(end)
    temperature = likelihood_temperature(here)
    level = [o.laplace(parameters, temperature)[1] for o in (here, *found)]
    weights = np.exp(np.array(level) - max(level))
    shares = weights / weights.sum()
    modes = [
        Mode({parameters.names[j]: float(parameters.from_search(o.coordinates)[j]) for j in here.free}, float(share))
        for o, share in zip(found, shares[1:], strict=True)
        if share >= MIN_MODE_SHARE
    ]
    return tuple(sorted(modes, key=lambda mode: -mode.share))


def likelihood_temperature(here: Optimum) -> float:
    """Return what likelihood ratios are divided by where a residual is no noise: readings that then count as one."""
    if not any(n.model_error for n in here.noise.values()):
        return 1.0
    return max(1.0, residual_correlation_time([here.whitened.residual]))


def _images(objective: Objective, here: Optimum) -> list[FloatArray]:
    """Return the best points (search coordinates) that a symmetry of the model may make as good as the optimum."""
    parameters = objective.parameters
    values = parameters.from_search(here.coordinates)
    shared = [j for j in here.free if parameters.items[j].recording is None]
    low, high = (np.array([getattr(p, side) for p in parameters]) for side in ("lower", "upper"))
    flips = [j for j in shared if low[j] <= -values[j] <= high[j] and values[j] != 0.0]
    swaps = [
        (i, j)
        for i, j in combinations(shared, 2)
        if _may_swap(parameters.items[i], parameters.items[j], values[[i, j]])
    ]
    found: list[FloatArray] = []
    for group in (*((j,) for j in flips), *combinations(flips, 2)):
        image = values.copy()
        image[list(group)] *= -1.0
        found.append(image)
    doubles = [(a, b) for a, b in combinations(swaps, 2) if not set(a) & set(b)]
    for pairs in (*((s,) for s in swaps), *doubles):
        image = values.copy()
        for i, j in pairs:
            image[[i, j]] = values[[j, i]]
        found.append(image)
    if not found:
        return []
    points = parameters.to_search(np.array(found[:MAX_IMAGES]))
    level = objective.levels(points, here.noise)
    order = np.argsort(level)[::-1][:MAX_REFINED]
    return [points[k] for k in order if math.isfinite(level[k])]


def _may_swap(a: Parameter, b: Parameter, values: FloatArray) -> bool:
    """Return whether two parameters are of one kind, and may have each other's values."""
    inside = a.lower <= values[1] <= a.upper and b.lower <= values[0] <= b.upper
    return a.unit == b.unit and inside and not math.isclose(values[0], values[1], rel_tol=1e-3)


def _particles(here: Optimum, box: tuple[FloatArray, FloatArray], swarm: SwarmResult | None) -> list[FloatArray]:
    """Return where particles ended that are far from the optimum, and from each other."""
    if swarm is None or swarm.candidates.shape[1] != len(here.free):
        return []
    columns = list(here.free)
    width = (box[1] - box[0])[columns]
    taken = [here.coordinates[columns]]
    found: list[FloatArray] = []
    for x, cost in zip(swarm.candidates, swarm.costs, strict=True):
        far = min(float(np.max(np.abs(x - t) / width)) for t in taken)
        if math.isfinite(cost) and far > MIN_PARTICLE_DISTANCE and len(found) < MAX_PARTICLES:
            taken.append(x)
            point = here.coordinates.copy()
            point[columns] = x
            found.append(point)
    return found


def is_another(objective: Objective, known: Sequence[Optimum], end: Optimum) -> bool:
    """Tell whether an optimum is apart from all known ones, within their reach and behind a barrier."""
    columns = list(end.free)
    for other in known:
        # Along a ridge it is huge, which the covariance, within the width of the priors, is not.
        sd = unlimited_sd(other.whitened.information)
        if np.max(np.abs(end.coordinates - other.coordinates)[columns] / sd) < MIN_DISTANCE:
            return False
        way = np.array([other.coordinates + t * (end.coordinates - other.coordinates) for t in ON_THE_WAY])
        between = objective.levels(way, other.noise)
        if min(between) > min(other.log_likelihood, end.log_likelihood) - MIN_BARRIER * likelihood_temperature(other):
            return False
    return bool(end.reason.converged or end.reason is Stop.NO_PROGRESS)
