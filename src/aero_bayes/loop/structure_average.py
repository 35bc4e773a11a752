"""Intervals of parameters averaged over the structures that the data do not tell apart.

The distribution of a parameter is the mixture of its distributions under each structure (Hoeting, Madigan, Raftery and
Volinsky, 1999, Statistical Science 14, 382), weighted by how often each predicts left-out readings best.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.judge.choice import Choice
from aero_bayes.loop.found_effect import NewParameter
from aero_bayes.search.models import FittedModel

#: Points of equal probability that stand for a normal distribution.
NORMAL_POINTS = ndtri((np.arange(2000) + 0.5) / 2000)
_LEVELS = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Spread:
    """Standard deviation and 5, 50 and 95 % quantiles of a parameter, in its SI unit."""

    sd: float
    q05: float
    q50: float
    q95: float

    def to_dict(self) -> dict[str, object]:
        return {"sd": self.sd, "q05": self.q05, "q50": self.q50, "q95": self.q95}


@dataclass(frozen=True, eq=False)
class StructureAverage:
    """Parameters of the first model under several structures, with how often each predicts best."""

    structures: tuple[tuple[str, ...], ...]
    wins: tuple[float, ...]
    parameters: ParameterSet
    draws: Mapping[str, FloatArray]
    mean: Mapping[str, float]
    shift: Mapping[str, FloatArray]
    scale: Mapping[str, FloatArray]

    def with_draws(self, values: Mapping[str, FloatArray]) -> StructureAverage:
        """Return the same with draws (n,) of a sampler, in SI units by name, for the chosen structure."""
        known = [j for j, p in enumerate(self.parameters) if p.name in values]
        part = ParameterSet(tuple(self.parameters.items[j] for j in known))
        points = part.to_search(np.column_stack([values[name] for name in part.names]))
        draws = dict(zip(part.names, points.T, strict=True))
        return replace(self, parameters=part, draws=draws, mean={n: float(np.mean(d)) for n, d in draws.items()})

    def chosen(self, name: str) -> Spread:
        """Return a parameter under the chosen structure alone."""
        return self._spread(name, self.draws[name][np.newaxis], np.ones(1))

    def mixture(self, name: str) -> Spread:
        """Return a parameter under all structures."""
        mean = self.mean[name]
        centred = self.scale[name][:, np.newaxis] * (self.draws[name] - mean)
        return self._spread(name, mean + self.shift[name][:, np.newaxis] + centred, np.array(self.wins))

    def _spread(self, name: str, coordinates: FloatArray, shares: FloatArray) -> Spread:
        part = ParameterSet((self.parameters[name],))
        low, high = (float(bound[0]) for bound in part.box)
        x = part.from_search(np.clip(coordinates, low, high).reshape(-1, 1))[:, 0]
        weights = np.repeat(shares / coordinates.shape[1], coordinates.shape[1])
        order = np.argsort(x, kind="stable")
        mass = np.cumsum(weights[order]) - 0.5 * weights[order]
        mean = float(weights @ x)
        sd = float(np.sqrt(weights @ (x - mean) ** 2))
        return Spread(sd, *np.interp(_LEVELS, mass, x[order]).tolist())

    def averaged(self, fitted: Mapping[str, NewParameter]) -> dict[str, NewParameter]:
        """Fitted parameters with the intervals of the mixture, where all structures have them."""
        found = dict(fitted)
        for name in self.draws:
            s = self.mixture(name)
            found[name] = replace(fitted[name], sd=s.sd, q05=s.q05, q50=s.q50, q95=s.q95)
        return found

    def to_dict(self) -> dict[str, object]:
        """Return it as ``loop.averaged`` in result.json."""
        return {
            "structures": [{"terms": list(t), "wins": w} for t, w in zip(self.structures, self.wins, strict=True)],
            "parameters": {
                name: {"chosen": self.chosen(name).to_dict(), "mixture": self.mixture(name).to_dict()}
                for name in self.draws
            },
        }


def structure_average(choice: Choice, parameters: ParameterSet, refit: Optimum) -> StructureAverage | None:
    """Return the chosen structure and those with an equivalent term in place of one of its own; None without any."""
    chosen = choice.fitted
    fits = [choice.explored.fits[s] for s in choice.rivals]
    names = [n for n in _shared(chosen) if n in parameters and parameters.index(n) in refit.free]
    names = [n for n in names if all(n in _shared(f) for f in fits)]
    if len(fits) < 2 or not names:
        return None
    wins = choice.comparison.wins(choice.rivals)
    places, widths = np.array([[_gaussian(f, n) for n in names] for f in fits]).transpose(2, 1, 0)
    columns = [parameters.index(n) for n in names]
    means = {n: float(refit.coordinates[j]) for n, j in zip(names, columns, strict=True)}
    return StructureAverage(
        structures=tuple(f.terms for f in fits),
        wins=tuple(wins[s] for s in choice.rivals),
        parameters=ParameterSet(tuple(parameters.items[j] for j in columns)),
        draws={n: means[n] + refit.sd(j) * NORMAL_POINTS for n, j in zip(names, columns, strict=True)},
        mean=means,
        shift={n: row - row[0] for n, row in zip(names, places, strict=True)},
        scale={n: row / max(float(row[0]), 1e-300) for n, row in zip(names, widths, strict=True)},
    )


def _shared(fitted: FittedModel) -> Iterable[str]:
    """Free parameters of the first model that act in all recordings."""
    items = fitted.model.objective.parameters.items
    return [items[j].name for j in fitted.model.free_base_columns if items[j].recording is None]


def _gaussian(fitted: FittedModel, name: str) -> tuple[float, float]:
    """Mean and standard deviation of a free parameter's search coordinate, under the tempered likelihood."""
    optimum, parameters = fitted.optimum, fitted.model.objective.parameters
    column = parameters.index(name)
    k = optimum.free.index(column)
    covariance = optimum.laplace(parameters, fitted.temperature)[0]
    return float(optimum.coordinates[column]), float(np.sqrt(max(float(covariance[k, k]), 0.0)))
