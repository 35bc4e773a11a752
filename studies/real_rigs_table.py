"""What the loop says of a rig, judged by what is known of it, and the table of all rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from trial_runs import Row

HEAD = (
    "rig", "outcome", "named", "missed", "false", "residual, fitted", "residual, unseen",
    "before over least squares, start free / as read", "s",
)  # fmt: skip
#: The two references, and how much larger than them "before" may be.
STARTS = {"free": "with the start free", "as_read": "with the start as read"}
LIMIT = 1.02


def judge_answer(
    row: Row,
    reference: Mapping[str, Any],
    expected: Sequence[Sequence[str]],
    fine: Sequence[str],
    false: Sequence[str],
    truth: Mapping[str, float],
) -> Row:
    """Add to a row what is right, missed, false and other, and "before" over the reference.

    An effect stands for all that the program calls equivalent to it. ``over_reference`` holds "before" over least
    squares with the start ``free`` and ``as_read``, by output and, ``together``, as the geometric mean of these: what
    one output gains where another loses is a matter of their weights.
    """
    if "error" in row:
        return {**row, "reference": dict(reference)}
    classes = [_class(row, name) for name in row["named"]]
    right = [next((n for n, same in enumerate(classes) if _any(same, group)), None) for group in map(tuple, expected)]
    found = {n for n in right if n is not None}
    rest = [n for n in range(len(classes)) if n not in found and not _any(classes[n], fine)]
    wrong = [n for n in rest if _any({row["named"][n]}, false)]
    return {
        **row,
        "right": [row["named"][n] for n in sorted(found)],
        "missed": [" or ".join(group) for group, n in zip(expected, right, strict=True) if n is None],
        "false": [row["named"][n] for n in wrong],
        "other": [row["named"][n] for n in rest if n not in wrong],
        "reference": dict(reference),
        "over_reference": {
            start: _over(row["before"].get("train", {}), reference[start]["rms"])
            for start in ("free", "as_read")
            if start in reference
        },
        "standard_deviations_off": _off(row["parameters"], truth),
    }


def _over(before: Mapping[str, float], best: Mapping[str, float]) -> dict[str, float]:
    over = {name: before[name] / rms for name, rms in best.items() if before.get(name)}
    return {**over, "together": float(np.exp(np.mean(np.log(list(over.values()))))) if over else float("nan")}


def _class(row: Row, name: str) -> set[str]:
    return {name, *(other for same in row["equivalent"] if name in same for other in same)}


def _any(names: set[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def _off(parameters: Mapping[str, Mapping[str, Any]], truth: Mapping[str, float]) -> dict[str, float | None]:
    """How far each known parameter is off, in its standard deviations; None where it was not fitted."""
    off: dict[str, float | None] = {}
    for name, value in truth.items():
        # A parameter of a law may stand under its own name or under one with its port.
        one = parameters.get(name) or next((p for n, p in parameters.items() if n.startswith(f"{name}_")), {})
        off[name] = (one["value"] - value) / one["sd"] if one.get("sd") else None
    return off


def table(rows: Sequence[Row]) -> str:
    """Write all rows in Markdown, and below them the errors of the simulated cases' parameters."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    good = [row for row in rows if "error" not in row]
    right, missed = (sum(len(row[key]) for row in good) for key in ("right", "missed"))
    wrong = sum(len(row["false"]) for row in good)
    lines += ["", f"{right} of {right + missed} expected names found, {wrong} false names"]
    for start, words in STARTS.items():
        over = [row["over_reference"][start]["together"] for row in good if row["over_reference"]]
        above = sum(ratio > LIMIT for ratio in over)
        lines += [f'"before" more than {LIMIT} times least squares {words}: {above} of {len(over)}']
    for row in good:
        if row["standard_deviations_off"]:
            off = ", ".join(
                f"{n} {'-' if z is None else f'{z:+.1f}'}" for n, z in row["standard_deviations_off"].items()
            )
            lines += [f"{row['key']}: off by standard deviations: {off}"]
    codes = sorted({row["code"] for row in rows})
    return "\n".join([*lines, f"code: {', '.join(codes)}"])


def _cells(row: Row) -> list[str]:
    if "error" in row:
        return [row["key"], f"failed: {row['error']}", *([""] * (len(HEAD) - 3)), f"{row['seconds']:.0f}"]
    marks = {**{n: "" for n in row["right"]}, **{n: " (other)" for n in row["other"]}}
    over = [
        ", ".join(f"{name} {ratio:.3f}" for name, ratio in ratios.items())
        if len(ratios) > 2
        else f"{ratios['together']:.3f}"
        for ratios in row["over_reference"].values()
    ]
    return [
        row["key"],
        row["outcome"],
        ", ".join(f"`{name}`{marks.get(name, '')}" for name in row["named"]) or "-",
        ", ".join(row["missed"]) or "-",
        ", ".join(f"`{name}`" for name in row["false"]) or "-",
        _change(row, "train"),
        _change(row, "test"),
        " / ".join(over) or "-",
        f"{row['seconds']:.0f}",
    ]


def _name(row: Row, output: str) -> str:
    return f"{output} " if len(row["before"].get("train", {})) > 1 else ""


def _change(row: Row, role: str) -> str:
    before, after = (row[when].get(role, {}) for when in ("before", "after"))
    return ", ".join(f"{_name(row, name)}{_number(before[name])} → {_number(after.get(name))}" for name in before)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
