"""The blind trial's table: rates over the information distance, as JSON by contract and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from aero_bayes.default_model import DEFAULT_MODEL
from aero_bayes.export import declaration_of
from trial_runs import Row, answer, as_text, quantile, rate, rates_by_band


def right_effect(row: Row) -> bool:
    """Return whether the true effect, or one equivalent to it, was found first."""
    return bool(row["found"]) and _matches(row, row["truth"][0]["id"], [row["found"][0]["id"]])


def right_pair(row: Row) -> bool:
    """Return whether both effects were found and no third one was."""
    names = [found["id"] for found in row["found"]]
    return len(names) == 2 and all(_matches(row, truth["id"], names) for truth in row["truth"])


def abstained(row: Row) -> bool:
    """Return whether no effect of the catalogue was named."""
    return all(found["kind"] == "free_form" for found in row["found"])


def right_port(row: Row) -> bool:
    """Return whether the first effect found, or one equivalent to it, acts where the true one does.

    A disturbance of a moment is at no port: then nothing is to be named.
    """
    if row["truth"][0]["port"] == "moment":
        return not row["found"]
    if not row["found"]:
        return False
    first = row["found"][0]
    same = {other for ids in row["equivalent"] if first["id"] in ids for other in ids}
    return row["truth"][0]["port"] in {first["port"], *(_port(id_) for id_ in same)}


def _port(id_: str) -> str:
    """Where an effect acts; of a curve as its id says."""
    declared = declaration_of(DEFAULT_MODEL)
    return declared.port_of(id_) if id_ in declared.effects else id_.partition("@")[2]


def learned(row: Row) -> bool:
    """Return whether a curve was learned."""
    return any(found["kind"] == "free_form" for found in row["found"])


def _matches(row: Row, truth: str, names: Sequence[str]) -> bool:
    return truth in names or any(truth in same and any(name in same for name in names) for same in row["equivalent"])


def summarise(rows: Sequence[Row], root: int, development: int) -> tuple[dict[str, Any], str]:
    """Compute the summary by contract, and the table to print."""
    good = [row for row in rows if "error" not in row]
    single, none, pair, outside = (
        [row for row in good if row["kind"] == kind] for kind in ("single", "none", "pair", "outside")
    )
    strong = [row for row in single if row["d"][0] >= 20.0]
    weak = [row for row in single if 8.0 <= row["d"][0] < 20.0]
    clear_pairs = [row for row in pair if min(row["d"]) >= 20.0]
    clear_outside = [row for row in outside if row["d"][0] >= 8.0]
    after = [max(row["after_over_noise"].values()) for row in [*strong, *weak]]
    curves = [row for row in clear_outside if learned(row)]
    unseen = [max(row["after_over_noise"].values()) for row in curves]
    summary: dict[str, Any] = {
        "trials": len(rows),
        "right_effect": {"d>=20": rate(strong, right_effect), "8<=d<20": rate(weak, right_effect)},
        "right_pair": rate(clear_pairs, right_pair),
        "right_port": rate([*strong, *weak], right_port),
        "right_port_outside": rate(clear_outside, right_port),
        "nothing_missing": rate(none, lambda row: row["outcome"] == "adequate"),
        "false_discovery": rate(none, lambda row: bool(row["found"])),
        "abstained_outside": rate(outside, abstained),
        "learned_outside": {
            "trials": len(curves),
            "right_port": rate(curves, right_port),
            "unseen_over_noise_median": quantile(unseen, 0.5),
            "unseen_within_1.3": rate(curves, lambda row: max(row["after_over_noise"].values()) <= 1.3),
        },
        "outside_by_effect": {
            id_: _of_one([row for row in outside if row["truth"][0]["id"] == id_])
            for id_ in sorted({row["truth"][0]["id"] for row in outside})
        },
        "abstained_outside_d>=8": rate(clear_outside, abstained),
        "extra_effects": rate([*strong, *weak], lambda row: len(row["found"]) > 1),
        "after_over_noise_median": quantile(after, 0.5),
        "after_over_noise_q95": quantile(after, 0.95),
        "after_within_1.05": rate([*strong, *weak], lambda row: max(row["after_over_noise"].values()) <= 1.05),
        "seconds_median": quantile([row["seconds"] for row in good], 0.5),
        "cpu_seconds_median": quantile([row["cpu_seconds"] for row in good], 0.5),
        "counts": {
            "d>=20": len(strong), "8<=d<20": len(weak), "none": len(none), "pair": len(clear_pairs),
            "outside": len(outside), "failed": len(rows) - len(good),
        },
        "by_noise": {
            noise: {
                "d>=20": rate([r for r in strong if r["noise"] == noise], right_effect),
                "8<=d<20": rate([r for r in weak if r["noise"] == noise], right_effect),
                "false_discovery": rate([r for r in none if r["noise"] == noise], lambda row: bool(row["found"])),
            }
            for noise in ("white", "real")
        },
        "curve": rates_by_band(single, {"right_effect": right_effect, "right_port": right_port}),
        "seeds": {"table": [root, "kind", "number"], "development": [development, "kind", "number"]},
        "table": list(rows),
    }  # fmt: skip
    wrong = [row for row in single if row["d"][0] >= 8.0 and not right_effect(row)]
    missed = [f"  {row['key']} {row['noise']}: {row['truth'][0]['id']} {answer(row)}" for row in wrong]
    return summary, as_text(summary, ["missed with d >= 8:", *missed] if missed else [])


def _of_one(rows: Sequence[Row]) -> dict[str, Any]:
    return {
        "trials": len(rows),
        "no_false_name": rate(rows, abstained),
        "learned": sum(map(learned, rows)),
        "right_port": rate(rows, right_port),
        "unseen_over_noise_median": quantile([max(row["after_over_noise"].values()) for row in rows], 0.5),
    }
