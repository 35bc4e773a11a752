"""Known terms deleted from complete models of real rigs: does the loop find them, and nothing where none is missing?

``real_rigs/complete.toml`` names the complete models: first models with the effects that the literature knows, with
starts from a fit. Each is a task by itself, in which nothing should be named, and a task for each term that a law of
the library can express: the model without it, on the same recordings. Noise and errors of the model are real, the truth
is known. A task is one row, kept as a JSON file in OUT/real_trial; one that has its row is not run again unless
``--again`` names it. Tasks of short recordings come first.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import re
import shutil
import time
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from real_rigs import MODELS, RECORDINGS, RigCase, cases, run_loop
from real_rigs_table import Expectation, judge_names
from trial_runs import Row, quantile, write_summary

#: A term is material if the error of an output on unseen data is this much larger without it.
MATERIAL_GROWTH = 4.0 / 3.0


@dataclass(frozen=True)
class Term:
    """A term of a complete model: the texts that go and what stands there then, and what names it."""

    edits: tuple[tuple[str, str], ...]
    expected: tuple[str, ...]
    without: tuple[str, ...] = ()
    place: tuple[str, ...] = ()


@dataclass(frozen=True)
class CompleteModel:
    """A complete model of a rig: the case with its recordings, free parameters, and terms by name."""

    case: RigCase
    folder: Path
    free: tuple[str, ...]
    fine: tuple[str, ...]
    terms: dict[str, Term]

    def source(self, term: Term | None) -> str:
        """Return its Modelica text, without a term where one is given.

        Raises
        ------
        ValueError
            Where an edit does not stand in the text once, or a parameter of the term is still used.
        """
        text = (self.folder / "Complete.mo").read_text(encoding="utf-8")
        for old, new in term.edits if term else ():
            if text.count(old) != 1:
                raise ValueError(f"{self.folder.name}: {old!r} stands {text.count(old)} times in the model")
            text = text.replace(old, new)
        for name in term.without if term else ():
            text = re.sub(rf"^  parameter Real {name}\(.*\n", "", text, flags=re.MULTILINE)
            if re.search(rf"\b{name}\b", text.partition("equation\n")[2]):
                raise ValueError(f"{self.folder.name}: {name} is used by what is left")
        return text

    def configuration(self, term: Term | None) -> str:
        """Return the configuration of the first model with the free parameters of this one."""
        head = (self.case.folder / "rig.toml").read_text(encoding="utf-8").partition("[parameters]")[0]
        gone = term.without if term else ()
        return head + "[parameters]\n" + "".join(f"{n} = {{free = true}}\n" for n in self.free if n not in gone)


def complete_models() -> dict[str, CompleteModel]:
    """Read all complete models, those of short recordings first."""
    known, found = cases(), {}
    for name, entries in tomllib.loads((MODELS / "complete.toml").read_text(encoding="utf-8")).items():
        terms = {
            key: Term(
                tuple(map(tuple, one["edits"])), *(tuple(one.get(k, ())) for k in ("expected", "without", "place"))
            )
            for key, one in entries.get("terms", {}).items()
        }
        case = known[entries.get("case", name)]
        found[name] = CompleteModel(case, MODELS / name, tuple(entries["free"]), tuple(entries.get("fine", ())), terms)
    return found


def tasks(models: dict[str, CompleteModel]) -> dict[str, tuple[CompleteModel, Term | None]]:
    """Return the tasks by name: each complete model, and each without one of its terms."""
    found: dict[str, tuple[CompleteModel, Term | None]] = {}
    for name, model in models.items():
        found[name] = (model, None)
        found |= {f"{name}-{key}": (model, term) for key, term in model.terms.items()}
    return found


def attempt(
    key: str,
    model: CompleteModel,
    term: Term | None,
    files: dict[str, list[Path]],
    out: Path,
    options: argparse.Namespace,
) -> Row:
    """Close the loop of a task and judge what is named."""
    shutil.rmtree(out, ignore_errors=True)
    (out / "model").mkdir(parents=True)
    (out / "model" / "Rig.mo").write_text(model.source(term), encoding="utf-8")
    (out / "model" / "rig.toml").write_text(model.configuration(term), encoding="utf-8")
    row = run_loop(key, files, out, options)
    return {**row, "task": "deleted" if term else "complete", **judged(row, model, term)}


def judged(row: Row, model: CompleteModel, term: Term | None) -> Row:
    """Return the verdict of a task: of a complete model, whether something is named."""
    if "error" in row:
        return {"verdict": "failed"}
    if term is None:
        return {"verdict": "false" if row["named"] else "silent"}
    known = Expectation(expected=(term.expected,), place=term.place, fine=model.fine)
    return judge_names(row["named"], row["equivalent"], known)


def material(row: Row, complete: Row | None) -> bool | None:
    """Return whether the error of an output on unseen data grows by :data:`MATERIAL_GROWTH` without the term."""
    if complete is None or "before" not in row or "before" not in complete:
        return None
    whole, less = (one["before"].get("test") or one["before"].get("train", {}) for one in (complete, row))
    return any(less[name] > MATERIAL_GROWTH * whole[name] for name in whole if whole[name] and less.get(name))


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rates of all rows. A run that failed counts as missed."""
    wholes = {row["key"]: row for row in rows if row["task"] == "complete"}
    rows = [
        {**row, "material": material(row, wholes.get(row["key"].partition("-")[0]))}
        if row["task"] == "deleted"
        else row
        for row in rows
    ]
    deleted, complete = ([row for row in rows if row["task"] == task] for task in ("deleted", "complete"))
    return {
        "deleted": _rates(deleted),
        "deleted_material": _rates([row for row in deleted if row["material"]]),
        "complete": {
            "tasks": len(complete),
            "named": float(np.mean([row["verdict"] == "false" for row in complete])) if complete else None,
        },
        "seconds_median": quantile([row["seconds"] for row in rows], 0.5),
        "rows": rows,
    }


def _rates(rows: Sequence[Row]) -> dict[str, Any]:
    counts = Counter("missed" if row["verdict"] in ("silent", "failed") else row["verdict"] for row in rows)
    shares = {name: counts[name] / len(rows) if rows else None for name in ("right", "place_right", "false", "missed")}
    return {"tasks": len(rows), **shares}


def table(found: dict[str, Any]) -> str:
    """Write the rates and all rows in Markdown, misses first."""
    order = ("failed", "false", "missed", "place_right", "right", "silent")
    rows = sorted(found["rows"], key=lambda row: (row["task"], order.index(row["verdict"])))
    lines = ["| task | verdict | named | material | s |", "|" + " --- |" * 5]
    for row in rows:
        named = row.get("error") or ", ".join(f"`{name}`" for name in row["named"]) or "-"
        big = {True: "yes", False: "no", None: "-"}[row.get("material")]
        lines.append(f"| {row['key']} | {row['verdict'].replace('_', ' ')} | {named} | {big} | {row['seconds']:.0f} |")
    for key in ("deleted", "deleted_material", "complete"):
        lines += ["", f"{key}: " + ", ".join(f"{n} {v if v is None else f'{v:.3g}'}" for n, v in found[key].items())]
    return "\n".join(lines)


def main() -> None:
    every = tasks(complete_models())
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, action="append", help="folder of recordings (may be repeated)")
    parser.add_argument("--out", type=Path, default=Path("reports"), help="summary; rows and runs: OUT/real_trial")
    parser.add_argument("--only", action="append", metavar="NAME", help="tasks, or rigs with all of theirs")
    parser.add_argument("--again", choices=every, action="append", default=[], metavar="NAME", help="run it anew")
    parser.add_argument("--workers", type=int, default=2, help="processes of a loop")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--max-minutes", type=float, default=5.0, help="[loop] max_minutes of each loop")
    parser.add_argument("--stop-after", type=float, default=15.0, help="start no loop after so many minutes")
    parser.add_argument("--table", action="store_true", help="run no loop")
    options = parser.parse_args()
    out = (options.out / "real_trial").resolve()
    out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60.0 * options.stop_after
    rows: list[Row] = []
    for key, (model, term) in every.items():
        if options.only and not {key, key.partition("-")[0]} & set(options.only):
            continue
        path, files = out / f"{key}.json", model.case.find(options.recordings or RECORDINGS)
        if files is None:
            print(f"{key}: its recordings are not there")
            continue
        wanted = not path.exists() or key in options.again
        if wanted and not options.table and time.monotonic() < end:
            row = attempt(key, model, term, files, out / "runs" / key, options)
            write_summary(row, path)
            print(
                f"{key}: {row['verdict']}: {row.get('sentence') or row.get('error')} ({row['seconds']:.0f} s)",
                flush=True,
            )
        if path.exists():
            rows.append(json.loads(path.read_text(encoding="utf-8")))
    rows = [{**row, **judged(row, *every[row["key"]])} for row in rows]
    found = summary(rows)
    print(table(found))
    write_summary({**found, "left": len(every) - len(rows)}, options.out / "real_trial.json")


if __name__ == "__main__":
    main()
