"""What the rows of a fleet say together: parameters, effects and outliers."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, ndtr, ndtri

from aero_bayes.arrays import FloatArray
from aero_bayes.commands.fleet_runner import Row
from aero_bayes.estimate.residual_tests import MAX_FLOOR_RATIO
from aero_bayes.report.schema_run import (
    FleetEffectJson,
    FleetJson,
    FleetParameterJson,
    Level,
    RangeJson,
    RigReasonJson,
    VerdictJson,
)

#: Fewest rigs from which a spread is inferred: with fewer its flat prior says more than they.
MIN_RIGS = 4
#: Points of the grid over τ, zero and steps of 3 % from the smallest to the largest in units of what is seen.
GRID_POINTS, SMALLEST, LARGEST = 600, 1e-6, 30.0


@dataclass(frozen=True, eq=False)
class Population:
    """Posterior of a fleet's mean and spread: τ with its weights, and mean and standard deviation of μ given each."""

    spreads: FloatArray
    weights: FloatArray
    means: FloatArray
    deviations: FloatArray

    def mean_quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of μ, shape of ``levels``."""
        return self._quantiles(self.deviations, levels)

    def spread_quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of τ, shape of ``levels``."""
        return np.asarray(np.interp(levels, np.cumsum(self.weights) - 0.5 * self.weights, self.spreads))

    def next_quantiles(self, levels: FloatArray) -> FloatArray:
        """Compute quantiles of the next rig's value, shape of ``levels``."""
        return self._quantiles(np.hypot(self.deviations, self.spreads), levels)

    def given_all(self, centre: float, width: float) -> tuple[float, float]:
        """Compute mean and standard deviation of a rig's value in the light of the fleet."""
        pull = width**2 / (width**2 + self.spreads**2)
        given = centre * (1.0 - pull) + pull * self.means
        within = (1.0 - pull) * width**2 + (pull * self.deviations) ** 2
        mean = float(given @ self.weights)
        return mean, float(np.sqrt(within @ self.weights + (given - mean) ** 2 @ self.weights))

    def _quantiles(self, deviations: FloatArray, levels: FloatArray) -> FloatArray:
        """Compute quantiles of a mixture of Gaussians over the grid, by bisection of its distribution function."""
        used = self.weights > 1e-12
        weights, means, sds = self.weights[used], self.means[used], deviations[used]
        low, high = (np.full(levels.shape, end) for end in (np.min(means - 40.0 * sds), np.max(means + 40.0 * sds)))
        for _ in range(80):
            middle = 0.5 * (low + high)
            above = ndtr((middle[..., None] - means) / sds) @ weights > levels
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return np.asarray(0.5 * (low + high))


def fit_population(centres: FloatArray, widths: FloatArray) -> Population:
    """Compute the posterior of mean and spread from m_i and s_i > 0 of at least :data:`MIN_RIGS` rigs, shape (n,)."""
    size = max(float(np.ptp(centres)), float(np.median(widths)))
    spreads = np.append(0.0, size * np.geomspace(SMALLEST, LARGEST, GRID_POINTS))
    terms = [_terms(m, s, spreads) for m, s in zip(centres, widths, strict=True)]
    return _population(np.sum(terms, axis=0), spreads)


def stand_out(centres: FloatArray, widths: FloatArray, population: Population) -> tuple[FloatArray, FloatArray]:
    """Tell how unlikely each rig is to come from the fleet that all the others form: p-values, and how many sd away."""
    spreads = population.spreads
    total = sum(_terms(m, s, spreads) for m, s in zip(centres, widths, strict=True))
    tail, away = np.empty_like(centres), np.empty_like(centres)
    for k, (m, s) in enumerate(zip(centres, widths, strict=True)):
        others = _population(total - _terms(m, s, spreads), spreads)
        z = (m - others.means) / np.sqrt(s**2 + spreads**2 + others.deviations**2)
        lower, upper = (float(others.weights @ ndtr(side)) for side in (z, -z))
        tail[k] = max(min(lower, upper), 1e-300)
        away[k] = -ndtri(tail[k]) if upper < lower else ndtri(tail[k])
    return 2.0 * tail, away


def _terms(centre: float, width: float, spreads: FloatArray) -> FloatArray:
    """Compute a rig's part of the sums over rigs that the posterior at each τ is made of, shape (4, t)."""
    variance = width**2 + spreads**2
    return np.stack([1.0 / variance, centre / variance, centre**2 / variance, np.log(variance)])


def _population(sums: FloatArray, spreads: FloatArray) -> Population:
    """Integrate μ out at each τ, and weigh the grid by the trapezoid rule."""
    precision, weighted, squares, log_variance = sums
    log = -0.5 * (log_variance + np.log(precision) + squares - weighted**2 / precision)
    gaps = np.diff(spreads)
    weights = np.exp(log - log.max()) * (np.append(gaps, 0.0) + np.append(0.0, gaps))
    return Population(spreads, weights / weights.sum(), weighted / precision, precision**-0.5)


QUANTILE_LEVELS = np.array([0.05, 0.5, 0.95])
#: A rig stands out where one so far away is expected once in so many fleets.
OUTLIER_FLEETS = 100.0
#: Its residual does where it is so many times the fleet's median.
MIN_MEDIAN_RATIO = 3.0
#: Rigs that a list names.
MAX_LISTED_RIGS = 100


def summarise_fleet(
    every: Sequence[Row], *, work: str, seed: int, versions: Mapping[str, str]
) -> tuple[FleetJson, list[Row]]:
    """Summarise parameters over the rigs, the share of rigs with each effect, and outliers.

    The second are the rows. Where the fleet's spread is known, each parameter of a rig has its value in the light of
    all rigs under ``given_all``; a rig that stands out has its ``reasons``, and where it is known how unlikely it is,
    under ``p_value``. Outliers are first, then rigs that could not be fitted."""
    table = digest(every)
    rows, failed = [row for row in every if "error" not in row], [row for row in every if "error" in row]
    names = list(dict.fromkeys(name for row in rows for name in row["parameters"]))
    parameters = {name: _parameter(name, rows, OUTLIER_FLEETS * len(names)) for name in names}
    _residuals(rows)
    odd = sorted((row for row in rows if "reasons" in row), key=lambda row: (row.get("p_value", 1.0), row["key"]))
    result = FleetJson(
        work=work, seed=seed, simulated=any(row["simulated"] for row in rows), versions=dict(versions),
        rigs=len(every), failed=len(failed),
        outcomes=dict(Counter(row["outcome"] for row in rows if row["outcome"])),
        parameters=parameters, effects=_effects(rows), standing_out=len(odd),
        stand_out=[RigReasonJson(rig=row["key"], reasons=row["reasons"], p_value=row.get("p_value"))
                   for row in odd[:MAX_LISTED_RIGS]],
        failures=[RigReasonJson(rig=row["key"], reasons=[row["error"]]) for row in failed[:MAX_LISTED_RIGS]],
        seconds=sum(row.get("seconds", 0.0) for row in every),
        workers=len({row["worker"] for row in every if "worker" in row}), table_sha256=table,
    )  # fmt: skip
    others = [row for row in rows if "reasons" not in row]
    return result.model_copy(update={"verdict": _verdict(result)}), odd + failed + others


def digest(rows: Sequence[Row]) -> str:
    """Hash rows, without what it took to make them: equal for equal fleets."""
    total = hashlib.sha256()
    for row in rows:
        kept = {key: value for key, value in row.items() if key not in ("seconds", "worker", "made_of")}
        total.update(f"{json.dumps(kept, sort_keys=True)}\n".encode())
    return total.hexdigest()


def _parameter(name: str, rows: Sequence[Row], fleets: float) -> FleetParameterJson:
    """Summarise one parameter over the fleet; rows get its value in the light of all rigs, and why they stand out."""
    stated = [(row, row["parameters"][name]) for row in rows if name in row["parameters"]]
    unit, told = stated[0][1]["unit"], [(row, entry) for row, entry in stated if "centre" in entry]
    log = bool(told) and Counter(entry["log"] for _, entry in told).most_common(1)[0][0]
    told = [(row, entry) for row, entry in told if entry["log"] == log]
    shared = FleetParameterJson(unit=unit, log=log, rigs=len(told))
    if len(told) < MIN_RIGS:
        return shared
    centres, widths = (np.array([entry[part] for _, entry in told]) for part in ("centre", "width"))
    fleet, out = fit_population(centres, widths), np.exp if log else np.asarray
    middle = float(fleet.mean_quantiles(QUANTILE_LEVELS)[1])
    for (row, entry), p, away in zip(told, *stand_out(centres, widths, fleet), strict=True):
        entry["given_all"] = float(out(fleet.given_all(entry["centre"], entry["width"])[0]))
        if p < 1.0 / (fleets * len(told)):
            off = entry["centre"] - middle
            far = f"{math.exp(off):.3g} times" if log else f"{off:+.3g} from"
            text = f"`{name}` is {far} the typical value of the fleet"
            row.setdefault("reasons", []).append(f"{text}, {abs(away):.1f} standard deviations from the other rigs")
            row["p_value"] = min(float(p), row.get("p_value", 1.0))
    return shared.model_copy(
        update={
            "mean": _range(out(fleet.mean_quantiles(QUANTILE_LEVELS))),
            "spread": _range(fleet.spread_quantiles(QUANTILE_LEVELS)),
            "next": _range(out(fleet.next_quantiles(QUANTILE_LEVELS))),
        }
    )


def _residuals(rows: Sequence[Row]) -> None:
    """Note rigs whose residual is far above the fleet's median and above the noise."""
    known = [row for row in rows if row["over_floor"] is not None]
    median = float(np.median([row["over_floor"] for row in known])) if known else math.nan
    for row in known:
        if row["over_floor"] > max(MAX_FLOOR_RATIO, MIN_MEDIAN_RATIO * median):
            text = f"its residual is {row['over_floor']:.3g} times the noise floor (median of the fleet: {median:.3g})"
            row.setdefault("reasons", []).append(text)


def _effects(rows: Sequence[Row]) -> list[FleetEffectJson]:
    """Estimate the share of rigs whose loop names each effect, the commonest first.

    A rig whose residual stays unexplained tells nothing of effects that it does not name. The share is binomial with
    Jeffreys' prior; a name among others that do as well counts in equal parts."""
    named = [effect for row in rows for effect in row["effects"]]
    times = Counter(effect["id"] for effect in named)
    words = {effect["id"]: effect["summary"] for effect in named}
    conclusive = [row for row in rows if row["outcome"] in ("adequate", "extended")]
    counts: dict[str, float] = defaultdict(float)
    for effect in (effect for row in conclusive for effect in row["effects"]):
        for id_ in (effect["id"], *effect["alike"]):
            counts[id_] += 1.0 / (1 + len(effect["alike"]))
    found = []
    for id_ in sorted(times, key=lambda id_: (-times[id_], id_)):
        others = max(len(conclusive) - counts[id_], 0.0)
        share = _range(betaincinv(counts[id_] + 0.5, others + 0.5, QUANTILE_LEVELS)) if conclusive else RangeJson()
        found.append(FleetEffectJson(id=id_, summary=words[id_], named=times[id_], share=share))
    return found


def _range(values: FloatArray) -> RangeJson:
    low, middle, high = (float(v) for v in values)
    return RangeJson(q05=low, q50=middle, q95=high)


def _verdict(result: FleetJson) -> VerdictJson:
    """Return the fleet in a few sentences."""
    done = result.rigs - result.failed
    told = [f"{done} of {result.rigs} rigs were fitted" if result.failed else f"All {result.rigs} rigs were fitted"]
    spreads = {name: p.spread.q50 for name, p in result.parameters.items() if p.log and p.spread.q50}
    if spreads:
        widest = max(spreads, key=lambda name: spreads[name] or 0.0)
        told.append(f"They differ most in `{widest}` (standard deviation {100.0 * (spreads[widest] or 0.0):.2g} %)")
    for first in result.effects[:1]:
        low, high = first.share.q05, first.share.q95
        share = f": {100 * low:.0f} to {100 * high:.0f} % of the fleet" if low is not None and high is not None else ""
        told.append(f"The model lacks {first.id} in {first.named} of them{share}")
    if result.standing_out:
        told.append(f"{result.standing_out} {'is an outlier' if result.standing_out == 1 else 'are outliers'}")
    level: Level = "bad" if done < 0.5 * result.rigs else "warning" if result.failed or result.standing_out else "good"
    return VerdictJson(level=level, text=". ".join(told) + ".")
