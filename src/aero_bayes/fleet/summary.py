"""Summarise the table of rows: parameters, effects and outliers of the fleet."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.fleet.population import MIN_RIGS, Population, fit_population, stand_out
from aero_bayes.fleet.prevalence import NamedEffect, Prevalence, estimate_prevalence, shared_out
from aero_bayes.fleet.table import Table
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

FloatArray = NDArray[np.float64]
QUANTILE_LEVELS = np.array([0.05, 0.5, 0.95])
#: A rig stands out where one so far away is expected once in so many fleets.
OUTLIER_FLEETS = 100.0
#: Its residual does where it is so many times the fleet's median, and so far above the noise.
MIN_MEDIAN_RATIO, MIN_FLOOR_RATIO = 3.0, 1.5
#: Rigs that a list names.
MAX_LISTED_RIGS = 100


@dataclass(frozen=True, eq=False)
class FleetFacts:
    """Columns of the table, for the rigs that were fitted."""

    names: list[str]
    simulated: bool
    parameters: dict[str, dict[str, Any]]
    over_floor: FloatArray
    levels: list[str]
    outcomes: list[str]
    effects: list[list[NamedEffect]]
    words: dict[str, str]
    failures: list[tuple[str, str]]


def summarise_fleet(
    table: Table, *, work: str, seed: int, versions: Mapping[str, str]
) -> tuple[FleetJson, FleetColumns]:
    """Summarise parameters over the rigs, the prevalence of effects, and outliers.

    Parameters
    ----------
    table : Table
        Of rows as :func:`aero_bayes.fleet.row.fleet_row` and :func:`aero_bayes.fleet.runner.failure` make them.
    work : str
    seed : int
    versions : mapping of str to str

    Returns
    -------
    FleetJson
        As ``fleet.json`` holds it.
    FleetColumns
        A number a rig for everything that the page draws.
    """
    facts = _read(table)
    cost, seconds = _cost(table, facts.names)
    reasons: dict[str, list[str]] = {}
    unlikely: dict[str, float] = {}
    parameters, drawn = {}, {}
    for name, entry in facts.parameters.items():
        parameters[name], drawn[name] = _parameter(name, entry, facts.names, len(facts.parameters), reasons, unlikely)
    _residuals(facts, reasons)
    effects, present = _effects(facts)
    result = FleetJson(
        work=work,
        seed=seed,
        simulated=facts.simulated,
        versions=dict(versions),
        rigs=len(facts.names) + len(facts.failures),
        failed=len(facts.failures),
        outcomes=dict(Counter(filter(None, facts.outcomes))),
        levels=dict(Counter(filter(None, facts.levels))),
        parameters=parameters,
        effects=effects,
        standing_out=len(reasons),
        stand_out=[
            RigReasonJson(rig=rig, reasons=reasons[rig], p_value=unlikely.get(rig))
            for rig in sorted(reasons, key=lambda rig: (unlikely.get(rig, 1.0), rig))[:MAX_LISTED_RIGS]
        ],
        failures=[RigReasonJson(rig=rig, reasons=[reason]) for rig, reason in facts.failures[:MAX_LISTED_RIGS]],
        cost=cost,
        table_sha256=table.digest(),
    )
    result = result.model_copy(update={"verdict": _verdict(result)})
    flagged = np.array([name in reasons for name in facts.names], dtype=bool)
    return result, FleetColumns(facts.names, drawn, facts.over_floor, seconds, present, flagged)


def _read(table: Table) -> FleetFacts:
    names: list[str] = []
    found: dict[str, dict[str, Any]] = {}
    words: dict[str, str] = {}
    simulated = False
    over, levels, outcomes, effects, failures = [], [], [], [], []
    for row in table.rows():
        if "error" in row:
            failures.append((row["key"], row["error"]))
            continue
        for name, entry in row["parameters"].items():
            one = found.setdefault(name, {"unit": entry["unit"], "log": Counter(), "rows": []})
            if "centre" in entry:
                one["log"][entry["log"]] += 1
                one["rows"].append((len(names), entry["centre"], entry["width"], entry["log"]))
        names.append(row["key"])
        simulated = simulated or row["simulated"]
        over.append(row["over_floor"] if row["over_floor"] is not None else math.nan)
        levels.append(row["level"])
        outcomes.append(row["outcome"])
        effects.append([NamedEffect(one["id"], tuple(one["alike"]), one["strength"]) for one in row["effects"]])
        words |= row["words"]
    return FleetFacts(names, simulated, found, np.array(over), levels, outcomes, effects, words, failures)


def _cost(table: Table, names: list[str]) -> tuple[FleetCostJson, FloatArray]:
    total, workers, again, seconds = [0.0, 0.0], set(), 0, {}
    for key, cost in table.costs():
        total[0] += cost.get("seconds", 0.0)
        total[1] += cost.get("cpu_seconds", 0.0)
        workers.add(cost.get("worker", ""))
        again += cost.get("tries", 1) > 1
        seconds[key] = cost.get("seconds", math.nan)
    found = FleetCostJson(seconds=total[0], cpu_seconds=total[1], workers=len(workers - {""}), tries=again)
    return found, np.array([seconds[name] for name in names])


def _parameter(
    name: str,
    entry: Mapping[str, Any],
    names: list[str],
    parameters: int,
    reasons: dict[str, list[str]],
    unlikely: dict[str, float],
) -> tuple[FleetParameterJson, ParameterColumn]:
    """One parameter over the fleet; rigs that stand out are added to ``reasons`` and ``unlikely``."""
    log = bool(entry["log"]) and entry["log"].most_common(1)[0][0]
    used = [row for row in entry["rows"] if row[3] == log]
    at = np.array([row[0] for row in used], dtype=np.intp)
    centres, widths = np.array([row[1] for row in used]), np.array([row[2] for row in used])
    out = np.exp if log else np.asarray
    values, shrunk, halves = (np.full(len(names), math.nan) for _ in range(3))
    values[at], halves[at] = out(centres), widths
    if len(at) < MIN_RIGS:
        shared = FleetParameterJson(unit=entry["unit"], log=log, rigs=len(at))
        return shared, ParameterColumn(values, halves, shrunk, None, shared)
    found = fit_population(centres, widths)
    shrunk[at] = out(found.shrunken(centres, widths)[0])
    p_values, away = stand_out(centres, widths, found)
    for k in np.flatnonzero(p_values < 1.0 / (OUTLIER_FLEETS * len(at) * parameters)).tolist():
        rig = names[at[k]]
        reasons.setdefault(rig, []).append(_outlier_text(name, centres[k], float(away[k]), found, log=log))
        unlikely[rig] = min(unlikely.get(rig, 1.0), float(p_values[k]))
    shared = FleetParameterJson(
        unit=entry["unit"],
        log=log,
        rigs=len(at),
        mean=_range(out(found.mean_quantiles(QUANTILE_LEVELS))),
        spread=_range(found.spread_quantiles(QUANTILE_LEVELS)),
        next=_range(out(found.next_quantiles(QUANTILE_LEVELS))),
    )
    grid = np.linspace(0.0005, 0.9995, 121)
    return shared, ParameterColumn(values, halves, shrunk, (out(found.next_quantiles(grid)), grid), shared)


def _outlier_text(name: str, centre: float, away: float, found: Population, *, log: bool) -> str:
    middle = float(found.mean_quantiles(QUANTILE_LEVELS)[1])
    far = f"{math.exp(centre - middle):.3g} times" if log else f"{centre - middle:+.3g} from"
    return f"`{name}` is {far} the typical value of the fleet, {abs(away):.1f} standard deviations from the other rigs"


def _residuals(facts: FleetFacts, reasons: dict[str, list[str]]) -> None:
    known = facts.over_floor[np.isfinite(facts.over_floor)]
    if not known.size:
        return
    limit = max(MIN_FLOOR_RATIO, MIN_MEDIAN_RATIO * float(np.median(known)))
    for k in np.flatnonzero(facts.over_floor > limit).tolist():
        ratio, median = facts.over_floor[k], np.median(known)
        text = f"its residual is {ratio:.3g} times the noise floor (median of the fleet: {median:.3g})"
        reasons.setdefault(facts.names[k], []).append(text)


def _effects(facts: FleetFacts) -> tuple[list[FleetEffectJson], FloatArray]:
    """Effects that some rig's loop named, the commonest first; and how probable each is in each rig, (n, k).

    A rig whose residual stays unexplained conclusive nothing of effects that it does not name.
    """
    named = Counter(one.id for effects in facts.effects for one in effects)
    ids = sorted(named, key=lambda id_: (-named[id_], id_))
    conclusive = np.array([outcome in ("adequate", "extended") for outcome in facts.outcomes], dtype=bool)
    shares = shared_out(facts.effects)
    present = np.full((len(facts.names), len(ids)), math.nan)
    found = []
    for column, id_ in enumerate(ids):
        sure = {
            rig: (one.strength, share[id_])
            for rig, (effects, split) in enumerate(zip(facts.effects, shares, strict=True))
            for one, share in zip(effects, split, strict=True)
            if id_ in share
        }
        used = [pair for rig, pair in sure.items() if conclusive[rig]]
        strengths, weights = np.array(used).reshape(-1, 2).T
        common = estimate_prevalence(strengths, weights, int(conclusive.sum()))
        present[conclusive, column] = common.unseen
        for rig, (_, weight) in sure.items():
            present[rig, column] = weight
        summary = facts.words.get(id_, "")
        found.append(_effect(FleetEffectJson(id=id_, summary=summary, named=named[id_]), common, known=bool(used)))
    return found, present


def _effect(effect: FleetEffectJson, common: Prevalence, *, known: bool) -> FleetEffectJson:
    if not known:
        return effect
    return effect.model_copy(update={"share": _range(common.quantiles(QUANTILE_LEVELS)), "noticed": common.seen})


def _range(values: FloatArray) -> RangeJson:
    low, middle, high = (float(v) for v in values)
    return RangeJson(q05=low, q50=middle, q95=high)


def _verdict(result: FleetJson) -> VerdictJson:
    """The fleet in a few sentences."""
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
