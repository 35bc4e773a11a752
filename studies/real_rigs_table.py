"""What the loop says of a rig, judged by what is known of it, and the table of all rigs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from trial_runs import Row

HEAD = (
    "rig", "verdict", "outcome", "named", "missed", "false", "residual, fitted", "residual, unseen", "s",
)  # fmt: skip
#: What an answer can be, best first; a run that failed is ``failed``.
VERDICTS = {
    "right": "all that is expected is named, and nothing false",
    "silent": "nothing is named where no law is what is missing, or where the readings are too few",
    "place_right": "a part of what is expected, a curve or near law there, or a class that holds it; nothing false",
    "false": "something is named that is not missing",
    "missed": "nothing is named that is expected",
    "failed": "the run did not end",
}


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """What is known of a rig, as patterns of ids (see ``cases.toml``)."""

    expected: tuple[tuple[str, ...], ...] = ()
    silence: bool = False
    place: tuple[str, ...] = ()
    fine: tuple[str, ...] = ()
    false: tuple[str, ...] = ()


def judge_answer(row: Row, known: Expectation) -> Row:
    """Add to a row what is right and false of it, and its verdict.

    An effect stands for all that the program calls equivalent to it.
    """
    if "error" in row:
        return {**row, "verdict": "failed"}
    return {**row, **judge_names(row["named"], row["equivalent"], known)}


def judge_names(named: Sequence[str], equivalent: Sequence[Sequence[str]], known: Expectation) -> Row:
    """Return what is right, at the right place, missed, false and other among names, and the verdict.

    Parameters
    ----------
    named : sequence of str
        Ids of the effects that are named.
    equivalent : sequence of sequence of str
        Ids that the program calls equivalent.
    known : Expectation
    """
    classes = [_class(equivalent, name) for name in named]
    right = [next((n for n, same in enumerate(classes) if _any(same, group)), None) for group in known.expected]
    found = {n for n in right if n is not None}
    rest = [n for n in range(len(classes)) if n not in found and not _any(classes[n], known.fine)]
    there = [n for n in rest if _any(classes[n], known.place)]
    rest = [n for n in rest if n not in there]
    wrong = [n for n in rest if _any({named[n]}, known.false)]
    answer = {
        "right": [named[n] for n in sorted(found)],
        "at_place": [named[n] for n in there],
        "missed": [" or ".join(group) for group, n in zip(known.expected, right, strict=True) if n is None],
        "false": [named[n] for n in wrong],
        "other": [named[n] for n in rest if n not in wrong],
    }
    open_class = {name for same in equivalent for name in same} if not named else set()
    if any(_any(open_class, group) for group in known.expected):
        return {**answer, "verdict": "place_right"}
    return {**answer, "verdict": _verdict(answer, bool(named), known)}


def _verdict(answer: Row, something: bool, known: Expectation) -> str:
    if answer["false"] or answer["other"]:
        return "false"
    if not something and (known.silence or not known.expected):
        return "silent"
    if not answer["missed"] and not (answer["at_place"] and not known.expected):
        return "right"
    return "place_right" if answer["right"] or answer["at_place"] else "missed"


def _class(equivalent: Sequence[Sequence[str]], name: str) -> set[str]:
    return {name, *(other for same in equivalent if name in same for other in same)}


def _any(names: set[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def table(rows: Sequence[Row]) -> str:
    """Write all rows in Markdown, and below them the errors of the simulated cases' parameters."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    good = [row for row in rows if "error" not in row]
    right, missed = (sum(len(row[key]) for row in good) for key in ("right", "missed"))
    wrong = sum(len(row["false"]) + len(row["other"]) for row in good)
    counts = Counter(row["verdict"] for row in rows)
    lines += ["", ", ".join(f"{counts[verdict]} {verdict.replace('_', ' ')}" for verdict in VERDICTS)]
    lines += [f"{right} of {right + missed} expected names found, {wrong} false names"]
    codes = sorted({row["code"] for row in rows})
    return "\n".join([*lines, f"code: {', '.join(codes)}"])


def _cells(row: Row) -> list[str]:
    if "error" in row:
        return [row["key"], "failed", f"{row['error']}", *([""] * (len(HEAD) - 4)), f"{row['seconds']:.0f}"]
    marks = {n: " (place)" for n in row["at_place"]} | {n: " (other)" for n in row["other"]}
    return [
        row["key"],
        row["verdict"].replace("_", " "),
        row["outcome"],
        ", ".join(f"`{name}`{marks.get(name, '')}" for name in row["named"]) or "-",
        ", ".join(row["missed"]) or "-",
        ", ".join(f"`{name}`" for name in (*row["false"], *row["other"])) or "-",
        _change(row, "train"),
        _change(row, "test"),
        f"{row['seconds']:.0f}",
    ]


def _name(row: Row, output: str) -> str:
    return f"{output} " if len(row["before"].get("train", {})) > 1 else ""


def _change(row: Row, role: str) -> str:
    before, after = (row[when].get(role, {}) for when in ("before", "after"))
    return ", ".join(f"{_name(row, name)}{_number(before[name])} → {_number(after.get(name))}" for name in before)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
