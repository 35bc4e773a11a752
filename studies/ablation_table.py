"""What leaving a part of the search out does to the trials: rates with their errors, and each trial that changed."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

from rig_trial_table import names_a_law, right_law, right_pair
from trial_runs import Row, markdown_table, quantile

#: Rates by name: the sort of trials, and whether a row counts.
RATES = {
    "right_law": ("law", right_law),
    "false_name": ("none", names_a_law),
    "right_pair": ("pair", right_pair),
    "named_outside": ("outside", names_a_law),
}
HEAD = ("left out", "trials", "right law", "false name", "right pair", "named outside", "median s", "lost", "won")


def good(row: Row) -> bool:
    """Return whether the answer is right: the law or both are found, or nothing is named where nothing can be."""
    return {"law": right_law, "pair": right_pair}.get(row["what"], lambda one: not names_a_law(one))(row)


def rated(rows: Sequence[Row], name: str) -> dict[str, float | int | None]:
    """Compute one rate with its binomial standard error."""
    what, counts = RATES[name]
    of = [counts(row) for row in rows if row["what"] == what]
    if not of:
        return {"trials": 0, "rate": None, "standard_error": None}
    share = sum(of) / len(of)
    return {"trials": len(of), "rate": share, "standard_error": sqrt(share * (1.0 - share) / len(of))}


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Compute the rates of each part on the trials that were also run with nothing left out, and what changed there.

    ``change`` of a rate is paired: the same trials with and without the part. Its standard error comes from the trials
    that changed; ``matters`` says whether any rate moves by more than its own.
    """
    done = [row for row in rows if "error" not in row]
    whole = {row["trial"]: row for row in done if not row["part"]}
    parts = list(dict.fromkeys(row["part"] for row in done))
    failed = [{"key": row["key"], "error": row["error"]} for row in rows if "error" in row]
    return {
        "code": sorted({row["code"] for row in done}),
        "parts": [_part(part, [row for row in done if row["part"] == part], whole) for part in parts],
        "failed": failed,
        "table": list(rows),
    }


def _part(part: str, rows: Sequence[Row], whole: dict[str, Row]) -> dict[str, Any]:
    paired = [row for row in rows if row["trial"] in whole]
    before = [whole[row["trial"]] for row in paired]
    rates = {name: {**rated(paired, name), "change": _change(paired, before, name)} for name in RATES}
    return {
        "left_out": part or None,
        "trials": len(paired),
        **rates,
        "seconds_median": quantile([row["seconds"] for row in paired], 0.5),
        "seconds_median_whole": quantile([row["seconds"] for row in before], 0.5),
        "matters": any(
            rate["change"] is not None and abs(rate["change"]["by"]) > rate["change"]["standard_error"] > 0.0
            for rate in rates.values()
        ),
        "changed": [
            {"trial": row["trial"], "truth": _truth(row), "whole": _says(old), "without": _says(row),
             "right": [good(old), good(row)]}
            for row, old in zip(paired, before, strict=True)
            if _says(row) != _says(old)
        ],
    }  # fmt: skip


def _change(rows: Sequence[Row], before: Sequence[Row], name: str) -> dict[str, float] | None:
    what, counts = RATES[name]
    steps = [counts(row) - counts(old) for row, old in zip(rows, before, strict=True) if row["what"] == what]
    if not steps:
        return None
    by = sum(steps) / len(steps)
    return {"by": by, "standard_error": sqrt(max(sum(s * s for s in steps) / len(steps) - by * by, 0.0) / len(steps))}


def _truth(row: Row) -> str:
    return (
        " and ".join(
            ids[0] if ids else law["named"] or law["law"] for ids, law in zip(row["ids"], row["truth"], strict=True)
        )
        or "nothing"
    )


def _says(row: Row) -> str:
    return " and ".join(sorted(one["id"] for one in row["found"])) or row["outcome"]


def table(summary: dict[str, Any]) -> str:
    """Write the rates in Markdown, then the trials that changed, part by part."""
    cells = []
    for part in summary["parts"]:
        flips = [one["right"] for one in part["changed"]]
        cells.append([
            f"`{part['left_out']}`" if part["left_out"] else "nothing",
            str(part["trials"]),
            *(_share(part[name]) for name in RATES),
            "-" if part["seconds_median"] is None else f"{part['seconds_median']:.1f}",
            *((str(flips.count(flip)) for flip in ([True, False], [False, True])) if part["left_out"] else ("", "")),
        ])  # fmt: skip
    lines = [
        *markdown_table(HEAD, cells),
        "",
        "Rates with their binomial standard error, in %; lost and won: trials that come out wrong or right then.",
    ]
    idle = [f"`{part['left_out']}`" for part in summary["parts"] if part["left_out"] and not part["matters"]]
    if idle:
        lines += ["", f"Left out without moving a rate by more than its error: {', '.join(idle)}."]
    for part in summary["parts"]:
        if part["changed"]:
            lines += ["", f"Without `{part['left_out']}`:", ""]
            lines += [
                f"- {one['trial']} ({one['truth']}): {one['whole']} → {one['without']}"
                + {(True, False): ", lost", (False, True): ", won"}.get(tuple(one["right"]), "")
                for one in part["changed"]
            ]
    lines += [f"- failed: {one['key']}: {one['error']}" for one in summary["failed"]]
    return "\n".join([*lines, "", f"Code: {', '.join(summary['code'])}"])


def _share(rate: dict[str, Any]) -> str:
    return "-" if rate["rate"] is None else f"{100 * rate['rate']:.0f} ± {100 * rate['standard_error']:.0f}"
