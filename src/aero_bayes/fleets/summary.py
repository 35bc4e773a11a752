"""Summarise the table of rows: parameters, effects and outliers of the fleet."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import betaincinv

from aero_bayes.arrays import FloatArray
from aero_bayes.check.residual_tests import MAX_FLOOR_RATIO
from aero_bayes.fleets.population import MIN_RIGS, Population, fit_population, stand_out
from aero_bayes.fleets.table import Row, Table
from aero_bayes.report.fleet_page import FleetColumns, ParameterColumn
from aero_bayes.schema import (
    FleetCostJson,
    FleetEffectJson,
    FleetJson,
    FleetParameterJson,
    RangeJson,
    RigReasonJson,
    VerdictJson,
)
from aero_bayes.schema.base import Level

QUANTILE_LEVELS = np.array([0.05, 0.5, 0.95])
#: A rig stands out where one so far away is expected once in so many fleets.
OUTLIER_FLEETS = 100.0
#: Its residual does where it is structured and so many times the fleet's median.
MIN_MEDIAN_RATIO = 3.0
#: Rigs that a list names.
MAX_LISTED_RIGS = 100


def summarise_fleet(
    table: Table, *, work: str, seed: int, versions: Mapping[str, str]
) -> tuple[FleetJson, FleetColumns]:
    """Summarise parameters over the rigs, the share of rigs with each effect, and outliers."""
    every = list(table.rows())
    rows, failures = [row for row in every if "error" not in row], [row for row in every if "error" in row]
    names = [row["key"] for row in rows]
    outliers = _Outliers(names)
    units = {name: entry["unit"] for row in reversed(rows) for name, entry in row["parameters"].items()}
    parameters, drawn = {}, {}
    for name in dict.fromkeys(name for row in rows for name in row["parameters"]):
        parameters[name], drawn[name] = _parameter(name, units[name], rows, len(units), outliers)
    over_floor = np.array([math.nan if row["over_floor"] is None else row["over_floor"] for row in rows])
    _residuals(over_floor, outliers)
    result = FleetJson(
        work=work, seed=seed, simulated=any(row["simulated"] for row in rows), versions=dict(versions),
        rigs=len(every), failed=len(failures),
        outcomes=dict(Counter(row["outcome"] for row in rows if row["outcome"])),
        levels=dict(Counter(row["level"] for row in rows if row["level"])),
        parameters=parameters, effects=_effects(rows),
        standing_out=len(outliers.reasons), stand_out=outliers.listed(),
        failures=[RigReasonJson(rig=row["key"], reasons=[row["error"]]) for row in failures[:MAX_LISTED_RIGS]],
        cost=_cost(table), table_sha256=table.digest(),
    )  # fmt: skip
    result = result.model_copy(update={"verdict": _verdict(result)})
    flagged = np.array([name in outliers.reasons for name in names], dtype=bool)
    return result, FleetColumns(names, drawn, over_floor, flagged)


class _Outliers:
    """Rigs that stand out: why, and how unlikely each is."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self.reasons: dict[str, list[str]] = defaultdict(list)
        self._unlikely: dict[str, float] = {}

    def add(self, rig: int, reason: str, p_value: float | None = None) -> None:
        """Note a reason for a rig."""
        name = self._names[rig]
        self.reasons[name].append(reason)
        if p_value is not None:
            self._unlikely[name] = min(self._unlikely.get(name, 1.0), p_value)

    def listed(self) -> list[RigReasonJson]:
        """List the rigs, the least likely first."""
        order = sorted(self.reasons, key=lambda rig: (self._unlikely.get(rig, 1.0), rig))[:MAX_LISTED_RIGS]
        return [RigReasonJson(rig=rig, reasons=self.reasons[rig], p_value=self._unlikely.get(rig)) for rig in order]


def _cost(table: Table) -> FleetCostJson:
    costs = list(table.costs())
    seconds, cpu_seconds = (sum(cost.get(key, 0.0) for cost in costs) for key in ("seconds", "cpu_seconds"))
    workers = {cost["worker"] for cost in costs if "worker" in cost}
    again = sum(cost.get("tries", 1) > 1 for cost in costs)
    return FleetCostJson(seconds=seconds, cpu_seconds=cpu_seconds, workers=len(workers), tries=again)


def _parameter(
    name: str, unit: str, rows: Sequence[Row], parameters: int, outliers: _Outliers
) -> tuple[FleetParameterJson, ParameterColumn]:
    """Summarise one parameter over the fleet; rigs that stand out are added to ``outliers``."""
    told = {k: entry for k, row in enumerate(rows) if "centre" in (entry := row["parameters"].get(name, {}))}
    log = bool(told) and Counter(entry["log"] for entry in told.values()).most_common(1)[0][0]
    at = np.array([k for k, entry in told.items() if entry["log"] == log], dtype=np.intp)
    centres, widths = (np.array([told[k][part] for k in at.tolist()]) for part in ("centre", "width"))
    out = np.exp if log else np.asarray
    values, shrunk, halves = (np.full(len(rows), math.nan) for _ in range(3))
    values[at], halves[at] = out(centres), widths
    shared = FleetParameterJson(unit=unit, log=log, rigs=len(at))
    if len(at) < MIN_RIGS:
        return shared, ParameterColumn(values, halves, shrunk, None, shared)
    fleet = fit_population(centres, widths)
    shrunk[at] = out(fleet.shrunken(centres, widths)[0])
    p_values, away = stand_out(centres, widths, fleet)
    for k in np.flatnonzero(p_values < 1.0 / (OUTLIER_FLEETS * len(at) * parameters)).tolist():
        outliers.add(at[k], _outlier_text(name, centres[k], float(away[k]), fleet, log=log), float(p_values[k]))
    ranges = {
        "mean": _range(out(fleet.mean_quantiles(QUANTILE_LEVELS))),
        "spread": _range(fleet.spread_quantiles(QUANTILE_LEVELS)),
        "next": _range(out(fleet.next_quantiles(QUANTILE_LEVELS))),
    }
    grid = np.linspace(0.0005, 0.9995, 121)
    curve = out(fleet.next_quantiles(grid)), grid
    shared = shared.model_copy(update=ranges)
    return shared, ParameterColumn(values, halves, shrunk, curve, shared)


def _outlier_text(name: str, centre: float, away: float, fleet: Population, *, log: bool) -> str:
    middle = float(fleet.mean_quantiles(QUANTILE_LEVELS)[1])
    far = f"{math.exp(centre - middle):.3g} times" if log else f"{centre - middle:+.3g} from"
    return f"`{name}` is {far} the typical value of the fleet, {abs(away):.1f} standard deviations from the other rigs"


def _residuals(over_floor: FloatArray, outliers: _Outliers) -> None:
    """Note rigs whose residual is far above the fleet's median and above the noise."""
    median = float(np.nanmedian(over_floor)) if np.isfinite(over_floor).any() else math.nan
    for k in np.flatnonzero(over_floor > max(MAX_FLOOR_RATIO, MIN_MEDIAN_RATIO * median)).tolist():
        text = f"its residual is {over_floor[k]:.3g} times the noise floor (median of the fleet: {median:.3g})"
        outliers.add(k, text)


def _effects(rows: Sequence[Row]) -> list[FleetEffectJson]:
    """Estimate the share of rigs whose loop names each effect, the commonest first.

    A rig whose residual stays unexplained tells nothing of effects that it does not name. The share is binomial with
    Jeffreys' prior; a name among others that do as well counts in equal parts."""
    times = Counter(effect["id"] for row in rows for effect in row["effects"])
    conclusive = [row for row in rows if row["outcome"] in ("adequate", "extended")]
    words: dict[str, str] = {id_: text for row in rows for id_, text in row["words"].items()}
    counts: dict[str, float] = defaultdict(float)
    for effect in (effect for row in conclusive for effect in row["effects"]):
        for id_ in (effect["id"], *effect["alike"]):
            counts[id_] += 1.0 / (1 + len(effect["alike"]))
    found = []
    for id_ in sorted(times, key=lambda id_: (-times[id_], id_)):
        others = max(len(conclusive) - counts[id_], 0.0)
        share = betaincinv(counts[id_] + 0.5, others + 0.5, QUANTILE_LEVELS) if conclusive else None
        known = {} if share is None else {"share": _range(share)}
        found.append(FleetEffectJson(id=id_, summary=words.get(id_, ""), named=times[id_], **known))
    return found


def _range(values: FloatArray) -> RangeJson:
    low, middle, high = (float(v) for v in values)
    return RangeJson(q05=low, q50=middle, q95=high)


def _verdict(result: FleetJson) -> VerdictJson:
    """Return the fleet in a few sentences."""
    done = result.rigs - result.failed
    text = f"{done} of {result.rigs} rigs were fitted" if result.failed else f"All {result.rigs} rigs were fitted"
    spreads = {name: p.spread.q50 for name, p in result.parameters.items() if p.log and p.spread.q50}
    if spreads:
        widest = max(spreads, key=lambda name: spreads[name] or 0.0)
        text += f". They differ most in `{widest}` (standard deviation {100.0 * (spreads[widest] or 0.0):.2g} %)"
    text += "."
    if result.effects:
        first = result.effects[0]
        share = first.share
        text += f" The model lacks {first.id} in {first.named} of them"
        if share.q05 is not None and share.q95 is not None:
            text += f": {100 * share.q05:.0f} to {100 * share.q95:.0f} % of the fleet"
        text += "."
    if result.standing_out:
        text += f" {result.standing_out} {'is an outlier' if result.standing_out == 1 else 'are outliers'}."
    level: Level = "bad" if done < 0.5 * result.rigs else "warning" if result.failed or result.standing_out else "good"
    return VerdictJson(level=level, text=text)
