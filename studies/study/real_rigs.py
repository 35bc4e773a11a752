"""Measured recordings of real rigs: what the closed loop names, held against what is known of the rig.

``real_rigs/cases.toml`` says what is fitted to what and which names are right. The recordings are not part of the
project and are looked for in the folders of ``--recordings``. With ``--alone`` each recording of a rig is also fitted
alone, with the others unseen: the answer should not depend on which one was fitted.
"""

from __future__ import annotations

import tomllib
from argparse import Namespace
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations
from pathlib import Path
from typing import Any

from study.answers import LoopTask, claims_law, close_loop_of, same_as, unseen
from study.study import Row, Study, markdown, number, percent, rate

STUDIES = Path(__file__).resolve().parents[1]
MODELS = STUDIES / "real_rigs"
#: Where recordings are looked for.
RECORDINGS = tuple(STUDIES.parents[1] / "shared" / name for name in ("rigs", "data"))
#: What an answer can be: all of what is expected, nothing by right, a part of it or a near law at its place, something
#: that is not missing, nothing of what is expected; or the run did not end.
VERDICTS = ("right", "silent", "place_right", "false", "missed", "failed")


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """What is known of a rig, as patterns of ids (see ``cases.toml``)."""

    expected: tuple[tuple[str, ...], ...] = ()
    silence: bool = False
    place: tuple[str, ...] = ()
    fine: tuple[str, ...] = ()
    false: tuple[str, ...] = ()


@dataclass(frozen=True)
class RigCase(Expectation):
    """One loop: recordings, the folder of the first model, and what may be named (see ``cases.toml``)."""

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...] = ()
    model: str = ""

    @property
    def folder(self) -> Path:
        """Folder of the first model and its configuration."""
        return MODELS / (self.model or self.name)

    def find(self, folders: Sequence[Path]) -> dict[str, Path]:
        """Find all recordings by name; none where one of them is in none of the folders, which is printed."""
        there = {file: [f / file for f in folders if (f / file).is_file()] for file in (*self.train, *self.test)}
        if not all(there.values()):
            print(f"{self.name}: its recordings are not there")
            return {}
        return {file: paths[0].resolve() for file, paths in there.items()}


def cases() -> dict[str, RigCase]:
    """Read all cases, quick ones first."""
    document = tomllib.loads((MODELS / "cases.toml").read_text(encoding="utf-8"))
    return {name: RigCase(name, **entries) for name, entries in document.items()}


def tasks(options: Namespace) -> list[LoopTask]:
    """List the cases whose recordings are there, and with ``--alone`` each of their recordings."""
    found = []
    for case in cases().values():
        files = case.find(options.recordings or RECORDINGS)
        texts = {path.name: path.read_text(encoding="utf-8") for path in case.folder.glob("[Rr]ig.*")}
        splits = {case.name: (case.train, case.test)} if files else {}
        if options.alone and len(files) > 1 and not case.model:
            for one in files:
                splits[f"{case.name}:{Path(one).stem}"] = (one,), tuple(other for other in files if other != one)
        for key, split in splits.items():
            train, test = (tuple(files[file] for file in role) for role in split)
            folder = (options.out / "real_rigs" / "runs" / key.replace(":", "_")).resolve()
            found.append(LoopTask(key, texts, train, test, folder, options.seed, options.loop_minutes or 20.0))
    return found


def judged(row: Row, known: Expectation) -> Row:
    """Add to a row what is right, at the right place, missed and false of it, and its verdict.

    An effect stands for all that do as well. Where only its place is claimed, the port has to be right.
    """
    if "error" in row:
        return {**row, "verdict": "failed"}
    effects = row["effects"]
    names = [same_as(row, effect) for effect in effects]
    every = [pattern for group in known.expected for pattern in group]
    right = [next((n for n, same in enumerate(names) if _any(same, group)), None) for group in known.expected]
    found = {n for n in right if n is not None}
    rest = [n for n in range(len(names)) if n not in found and not _any(names[n], known.fine)]
    ports = [f"*@{pattern.partition('@')[2]}" for pattern in every]
    there = [n for n in rest if _any(names[n], known.place)]
    there += [n for n in rest if effects[n].get("claim") == "place" and _any({f"@{effects[n]['port']}"}, ports)]
    wrong = [n for n in rest if n not in there]
    missed = [" or ".join(group) for group, n in zip(known.expected, right, strict=True) if n is None]
    untold = {name for same in row["equivalent"] for name in same} if not effects else set()
    if wrong:
        verdict = "false"
    elif not effects and _any(untold, every):
        verdict = "place_right"
    elif not effects and (known.silence or not known.expected):
        verdict = "silent"
    elif not missed and not (there and not known.expected):
        verdict = "right"
    else:
        verdict = "place_right" if found or there else "missed"
    return {
        **row,
        "named": [effect["id"] for effect in effects],
        "missed": missed,
        "false": [effects[n]["id"] for n in wrong],
        "false_law": any(claims_law(effects[n]) for n in wrong),
        "verdict": verdict,
    }


def _any(names: set[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def summary(rows: Sequence[Row]) -> Row:
    """Return how many cases got which verdict, and whether the recordings of a rig agree."""
    known = cases()
    rows = [judged(row, known[row["key"].partition(":")[0]]) for row in rows]
    whole = [row for row in rows if ":" not in row["key"]]
    counts = Counter(row["verdict"] for row in whole)
    return {
        "cases": len(whole),
        "verdicts": {verdict: counts[verdict] for verdict in VERDICTS},
        "false_law": sum(row.get("false_law", False) for row in whole),
        "alone": agreement([row for row in rows if ":" in row["key"] and "error" not in row]),
        "rows": rows,
    }


def agreement(rows: Sequence[Row]) -> Row:
    """Return how often two recordings of a rig, each fitted alone, get the same verdict.

    What they name overlaps, or one of them names nothing.
    """
    classes = {row["key"]: {name for effect in row["effects"] for name in same_as(row, effect)} for row in rows}
    pairs = [
        (one, other) for one, other in combinations(classes, 2) if one.partition(":")[0] == other.partition(":")[0]
    ]
    same = [not classes[one] or not classes[other] or bool(classes[one] & classes[other]) for one, other in pairs]
    return {
        "recordings": len(rows),
        "named": rate(rows, lambda row: row["effects"]),
        "pairs": len(pairs),
        "same": sum(same) / len(same) if same else None,
        "unlike": [list(pair) for pair, agree in zip(pairs, same, strict=True) if not agree],
    }


def table(found: Mapping[str, Any]) -> list[str]:
    """Write the answer for each rig, and how often single recordings agree."""
    rows = [row for row in found["rows"] if ":" not in row["key"]]
    lines = [(row["key"], said(row), row["verdict"].replace("_", " "), change(row)) for row in rows]
    told = ", ".join(f"{n} {verdict.replace('_', ' ')}" for verdict, n in found["verdicts"].items())
    text = [
        *markdown(("rig", "the model lacks", "verdict", "error on unseen data"), lines), "",
        f"{found['cases']} cases: {told}. Goals: 90 % right or silent, a false law in none ({found['false_law']}).",
    ]  # fmt: skip
    alone = found["alone"]
    if alone["pairs"]:
        text += [
            f"Of {alone['recordings']} recordings, each fitted alone, {percent(alone['named'])} name something (goal "
            f"70 %); {percent(alone['same'])} of {alone['pairs']} pairs of a rig have the same verdict (goal 90 %)."
        ]
    return text


def said(row: Row) -> str:
    """Write what is named, with what does as well."""
    if "error" in row:
        return str(row["error"])
    names = [
        f"`{effect['id']}`" + "".join(f" or `{other}`" for other in sorted(same_as(row, effect) - {effect["id"]})[:2])
        for effect in row["effects"]
    ]
    return ", ".join(names) or "nothing"


def change(row: Row) -> str:
    """Write the errors before and after, by output."""
    if "error" in row:
        return "-"
    before, after = unseen(row, "before"), unseen(row, "after")
    return ", ".join(
        f"{f'{name} ' if len(before) > 1 else ''}{number(value)} → {number(after.get(name))}"
        for name, value in before.items()
    )


STUDY = Study(
    "real_rigs",
    "The loop on measured recordings, which are not part of the project.",
    tasks, close_loop_of, summary, table,
)  # fmt: skip
