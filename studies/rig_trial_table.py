"""The many-rig trial's table: rates over the information distance, false names, wins; as JSON and as text."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from trial_runs import Row, answer, as_text, quantile, rate, rates_by_band

FRICTION = {"coulomb_friction", "friction_by_direction", "stribeck_friction", "presliding_friction", "rounded_friction"}
#: Limits of the wins between which their calibration is given.
WINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


def in_class(row: Row, name: str) -> set[str]:
    """Return a name and all that the program calls equivalent to it."""
    return {name, *(other for same in row["equivalent"] if name in same for other in same)}


def right_law(row: Row) -> bool:
    """Return whether the true law at its place, or one equivalent to it, was found first."""
    return bool(row["found"]) and bool(in_class(row, row["found"][0]["id"]) & set(row["ids"][0]))


def right_or_similar(row: Row) -> bool:
    """Return whether :func:`right_law` holds, any dry friction passing for another at the same place."""
    law = row["truth"][0]["law"]
    similar = FRICTION if law in FRICTION else {law}
    wanted = {f"{one}@{id_.partition('@')[2]}" for id_ in row["ids"][0] for one in similar}
    return bool(row["found"]) and bool(in_class(row, row["found"][0]["id"]) & wanted)


def right_place(row: Row) -> bool:
    """Return whether what was found first, or an equivalent, acts where the true law does."""
    places = {id_.partition("@")[2] for id_ in row["ids"][0]}
    found = in_class(row, row["found"][0]["id"]) if row["found"] else set()
    return bool(found and ({one.partition("@")[2] for one in found} & places or row["found"][0]["port"] in places))


def right_pair(row: Row) -> bool:
    """Return whether both laws were found and no third one was."""
    classes = [in_class(row, one["id"]) for one in row["found"]]
    return len(classes) == 2 and all(any(one & set(ids) for one in classes) for ids in row["ids"])


def names_a_law(row: Row) -> bool:
    """Return whether a law of the library was named."""
    return any(one["kind"] != "free_form" for one in row["found"])


def summarise(rows: Sequence[Row], base: int, development: int) -> tuple[dict[str, Any], str]:
    """Compute the summary, and the table to print."""
    good = [row for row in rows if "error" not in row]
    law, none, pair, outside = ([r for r in good if r["what"] == what] for what in ("law", "none", "pair", "outside"))
    strong = [row for row in law if row["d"][0] >= 20.0]
    weak = [row for row in law if 8.0 <= row["d"][0] < 20.0]
    seen = [*strong, *weak]
    clear_pairs = [row for row in pair if min(row["d"]) >= 20.0]
    after = [max(row["after_over_noise"].values()) for row in seen if row["after_over_noise"]]
    summary: dict[str, Any] = {
        "trials": len(rows),
        "right_law": {"d>=20": rate(strong, right_law), "8<=d<20": rate(weak, right_law)},
        "right_law_or_similar": {"d>=20": rate(strong, right_or_similar), "8<=d<20": rate(weak, right_or_similar)},
        "right_place": rate(seen, right_place),
        "right_pair": rate(clear_pairs, right_pair),
        "nothing_missing": rate(none, lambda row: row["outcome"] == "adequate"),
        "false_name": rate(none, names_a_law),
        "no_name_outside": rate(outside, lambda row: not names_a_law(row)),
        "after_over_noise_median": quantile(after, 0.5),
        "after_over_noise_q95": quantile(after, 0.95),
        "seconds_median": quantile([row["seconds"] for row in good], 0.5),
        "counts": {
            "d>=20": len(strong), "8<=d<20": len(weak), "none": len(none), "pair": len(clear_pairs),
            "outside": len(outside), "failed": len(rows) - len(good),
        },
        "wins": calibration(law + none),
        "by_rig": _by(good, lambda row: row["rig"]),
        "by_law": _by(law, lambda row: row["truth"][0]["law"]),
        "by_noise": _by(good, lambda row: row["noise"]),
        "by_law_outside": {
            name: {"trials": len(of), "no_name": rate(of, lambda row: not names_a_law(row))}
            for name, of in _groups(outside, lambda row: row["truth"][0]["law"]).items()
        },
        "curve": rates_by_band(law, {"right_law": right_law, "right_place": right_place}),
        "seeds": {"table": [base, "rig", "number", "what"], "development": [development, "rig", "number", "what"]},
        "table": list(rows),
    }  # fmt: skip
    missed = [f"  {r['key']} {r['noise']}: {r['ids'][0][0]} {answer(r)}" for r in seen if not right_law(r)]
    failed = [f"  {row['key']}: {row['error']}" for row in rows if "error" in row]
    notes = [*(["missed with d >= 8:", *missed] if missed else ()), *(["failed:", *failed] if failed else ())]
    return summary, as_text(summary, notes)


def calibration(rows: Sequence[Row]) -> dict[str, Any]:
    """Compute how often a named effect, or one that is called equivalent to it, is right, by how often it wins."""
    answers: list[tuple[float, bool]] = []
    for row in rows:
        truth = {id_ for ids in row["ids"] for id_ in ids}
        answers += [(float(wins), bool(in_class(row, name) & truth)) for name, wins in row["wins"].items()]
    bins = []
    for low, high in pairwise(WINS):
        inside = [(p, right) for p, right in answers if low <= p < high or p == high == 1.0]
        bins.append(
            {
                "wins": [low, high],
                "answers": len(inside),
                "mean_wins": float(np.mean([p for p, _ in inside])) if inside else None,
                "right": float(np.mean([right for _, right in inside])) if inside else None,
            }
        )
    sure = [right for p, right in answers if p >= 0.9]
    return {"given_90": {"answers": len(sure), "right": float(np.mean(sure)) if sure else None}, "bins": bins}


def _groups(rows: Sequence[Row], key: Any) -> dict[str, list[Row]]:
    return {name: [row for row in rows if key(row) == name] for name in sorted({key(row) for row in rows})}


def _by(rows: Sequence[Row], key: Any) -> dict[str, Any]:
    found = {}
    for name, of in _groups(rows, key).items():
        seen = [row for row in of if row["what"] == "law" and row["d"][0] >= 8.0]
        none = [row for row in of if row["what"] == "none"]
        found[name] = {"seen": len(seen), "right_law": rate(seen, right_law), "false_name": rate(none, names_a_law)}
    return found
