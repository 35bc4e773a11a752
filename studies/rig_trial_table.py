"""The many-rig trial's table: rates over the information distance, false names, wins; as JSON and as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def sort_trials(rows: Sequence[Row], kind: str, one: str) -> dict[str, list[Row]]:
    """Sort the trials that did not fail by what is missing, and by the distance at which it shows.

    ``kind`` is the entry of a row that says what is missing: ``one`` law, or ``none``, ``pair`` or ``outside``.
    """
    good = [row for row in rows if "error" not in row]
    sorts = {what: [row for row in good if row[kind] == what] for what in (one, "none", "pair", "outside")}
    strong = [row for row in sorts[one] if row["d"][0] >= 20.0]
    weak = [row for row in sorts[one] if 8.0 <= row["d"][0] < 20.0]
    pairs = [row for row in sorts["pair"] if min(row["d"]) >= 20.0]
    return {**sorts, "good": good, "strong": strong, "weak": weak, "seen": [*strong, *weak], "clear pairs": pairs}


def shared_rates(rows: Sequence[Row], sorts: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """Return the rates, times and counts that the summaries of all blind trials have."""
    after = [max(row["after_over_noise"].values()) for row in sorts["seen"] if row["after_over_noise"]]
    return {
        "trials": len(rows),
        "right_pair": rate(sorts["clear pairs"], right_pair),
        "nothing_missing": rate(sorts["none"], lambda row: row["outcome"] == "adequate"),
        "after_over_noise_median": quantile(after, 0.5),
        "after_over_noise_q95": quantile(after, 0.95),
        "seconds_median": quantile([row["seconds"] for row in sorts["good"]], 0.5),
        "counts": {
            "d>=20": len(sorts["strong"]), "8<=d<20": len(sorts["weak"]), "none": len(sorts["none"]),
            "pair": len(sorts["clear pairs"]), "outside": len(sorts["outside"]),
            "failed": len(rows) - len(sorts["good"]),
        },
        "table": list(rows),
    }  # fmt: skip


def trials_as_text(summary: Mapping[str, Any], seen: Sequence[Row]) -> str:
    """Write a summary for the terminal, with the trials that were missed or failed."""
    missed = [f"  {r['key']} {r['noise']}: {r['ids'][0][0]} {answer(r)}" for r in seen if not right_law(r)]
    failed = [f"  {row['key']}: {row['error']}" for row in summary["table"] if "error" in row]
    notes = [*(["missed with d >= 8:", *missed] if missed else ()), *(["failed:", *failed] if failed else ())]
    return as_text(summary, notes)


def summarise(rows: Sequence[Row], base: int, development: int) -> tuple[dict[str, Any], str]:
    """Compute the summary, and the table to print."""
    sorts = sort_trials(rows, "what", "law")
    good, law, none, outside, seen = (sorts[name] for name in ("good", "law", "none", "outside", "seen"))
    summary: dict[str, Any] = {
        **shared_rates(rows, sorts),
        **{
            name: {"d>=20": rate(sorts["strong"], right), "8<=d<20": rate(sorts["weak"], right)}
            for name, right in (("right_law", right_law), ("right_law_or_similar", right_or_similar))
        },
        "right_place": rate(seen, right_place),
        "false_name": rate(none, names_a_law),
        "no_name_outside": rate(outside, lambda row: not names_a_law(row)),
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
    }
    return summary, trials_as_text(summary, seen)


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
