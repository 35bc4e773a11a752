"""The blind trial's table: rates over the information distance, as JSON by contract and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from aero_bayes.default_model import DEFAULT_MODEL
from aero_bayes.export import declaration_of
from rig_trial_table import in_class, names_a_law, right_law, shared_rates, sort_trials, trials_as_text
from trial_runs import Row, quantile, rate, rates_by_band


def right_port(row: Row) -> bool:
    """Return whether the first effect found, or one equivalent to it, acts where the true one does.

    A disturbance of a moment is at no port: then nothing is to be named.
    """
    if row["truth"][0]["port"] == "moment":
        return not row["found"]
    if not row["found"]:
        return False
    first = row["found"][0]
    same = in_class(row, first["id"]) - {first["id"]}
    return row["truth"][0]["port"] in {first["port"], *map(_port, same)}


def _port(id_: str) -> str:
    """Return where an effect acts; of a curve as its id says."""
    declared = declaration_of(DEFAULT_MODEL)
    return declared.port_of(id_) if id_ in declared.effects else id_.partition("@")[2]


def learned(row: Row) -> bool:
    """Return whether a curve was learned."""
    return any(found["kind"] == "free_form" for found in row["found"])


def after_over_noise(row: Row) -> float:
    """Return the largest error on unseen readings over their noise."""
    return float(max(row["after_over_noise"].values()))


def summarise(rows: Sequence[Row], root: int, development: int) -> tuple[dict[str, Any], str]:
    """Compute the summary by contract, and the table to print."""
    rows = [{**row, "ids": [[effect["id"]] for effect in row.get("truth", ())]} for row in rows]
    sorts = sort_trials(rows, "kind", "single")
    strong, weak, seen, none, outside = (sorts[name] for name in ("strong", "weak", "seen", "none", "outside"))
    clear_outside = [row for row in outside if row["d"][0] >= 8.0]
    curves = list(filter(learned, clear_outside))
    summary: dict[str, Any] = {
        **shared_rates(rows, sorts),
        "right_effect": {"d>=20": rate(strong, right_law), "8<=d<20": rate(weak, right_law)},
        "right_port": rate(seen, right_port),
        "right_port_outside": rate(clear_outside, right_port),
        "false_discovery": rate(none, lambda row: bool(row["found"])),
        "abstained_outside": rate(outside, lambda row: not names_a_law(row)),
        "learned_outside": {
            "trials": len(curves),
            "right_port": rate(curves, right_port),
            "unseen_over_noise_median": quantile([after_over_noise(row) for row in curves], 0.5),
            "unseen_within_1.3": rate(curves, lambda row: after_over_noise(row) <= 1.3),
        },
        "outside_by_effect": {
            id_: _of_one([row for row in outside if row["truth"][0]["id"] == id_])
            for id_ in sorted({row["truth"][0]["id"] for row in outside})
        },
        "abstained_outside_d>=8": rate(clear_outside, lambda row: not names_a_law(row)),
        "extra_effects": rate(seen, lambda row: len(row["found"]) > 1),
        "after_within_1.05": rate(seen, lambda row: after_over_noise(row) <= 1.05),
        "cpu_seconds_median": quantile([row["cpu_seconds"] for row in sorts["good"]], 0.5),
        "by_noise": {
            noise: {
                "d>=20": rate([row for row in strong if row["noise"] == noise], right_law),
                "8<=d<20": rate([row for row in weak if row["noise"] == noise], right_law),
                "false_discovery": rate([row for row in none if row["noise"] == noise], lambda row: bool(row["found"])),
            }
            for noise in ("white", "real")
        },
        "curve": rates_by_band(sorts["single"], {"right_effect": right_law, "right_port": right_port}),
        "seeds": {"table": [root, "kind", "number"], "development": [development, "kind", "number"]},
    }
    return summary, trials_as_text(summary, seen)


def _of_one(rows: Sequence[Row]) -> dict[str, Any]:
    return {
        "trials": len(rows),
        "no_false_name": rate(rows, lambda row: not names_a_law(row)),
        "learned": sum(map(learned, rows)),
        "right_port": rate(rows, right_port),
        "unseen_over_noise_median": quantile([after_over_noise(row) for row in rows], 0.5),
    }
