"""Known terms deleted from complete models of real rigs: does the loop find them, and nothing where none is missing?

``real_rigs/complete.toml`` names the complete models: first models with the effects that the literature knows, with
starts from a fit. Each is a task by itself, in which no law should be claimed, and a task for each term that a law of
the library can express: the model without it, on the same recordings. Noise and errors of the model are real, the truth
is known. Tasks of short recordings come first.
"""

from __future__ import annotations

import re
import tomllib
from argparse import Namespace
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.answers import LoopTask, claims_law, close_loop_of, unseen
from study.real_rigs import MODELS, RECORDINGS, Expectation, RigCase, cases, judged
from study.study import Row, Study, markdown, percent, quantile, rate

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
    terms: Mapping[str, Term]

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
                tuple((old, new) for old, new in one["edits"]),
                *(tuple(one.get(k, ())) for k in ("expected", "without", "place")),
            )
            for key, one in entries.get("terms", {}).items()
        }
        case = known[entries.get("case", name)]
        found[name] = CompleteModel(case, MODELS / name, tuple(entries["free"]), tuple(entries.get("fine", ())), terms)
    return found


def tasks(options: Namespace) -> list[LoopTask]:
    """List each complete model, and each without one of its terms, where their recordings are there."""
    found = []
    for name, model in complete_models().items():
        files = model.case.find(options.recordings or RECORDINGS)
        terms = {name: None, **{f"{name}-{key}": term for key, term in model.terms.items()}} if files else {}
        for key, term in terms.items():
            texts = {"Rig.mo": model.source(term), "rig.toml": model.configuration(term)}
            train, test = (tuple(files[file] for file in role) for role in (model.case.train, model.case.test))
            folder = (options.out / "real_trial" / "runs" / key).resolve()
            found.append(LoopTask(key, texts, train, test, folder, options.seed, options.loop_minutes or 5.0))
    return found


def judged_term(row: Row, models: Mapping[str, CompleteModel]) -> Row:
    """Add the verdict of a task; of a complete model it is false if a law is claimed."""
    name, _, key = row["key"].partition("-")
    if key:
        model, term = models[name], models[name].terms[key]
        known = Expectation(expected=(term.expected,), place=term.place, fine=model.fine)
        return {**judged(row, known), "task": "deleted"}
    row = {**judged(row, Expectation()), "task": "complete"}
    if row["verdict"] != "failed":
        row["verdict"] = "false" if any(map(claims_law, row["effects"])) else "silent"
    return row


def material(row: Row, complete: Row | None) -> bool | None:
    """Return whether the error of an output on unseen data grows by :data:`MATERIAL_GROWTH` without the term."""
    if complete is None or "error" in row or "error" in complete:
        return None
    whole, less = (unseen(one, "before") for one in (complete, row))
    return any(less[name] > MATERIAL_GROWTH * whole[name] for name in whole if whole[name] and less.get(name))


def summary(rows: Sequence[Row]) -> Row:
    """Return the rates of all rows. A run that failed counts as missed."""
    models = complete_models()
    rows = [judged_term(row, models) for row in rows]
    complete = {row["key"]: row for row in rows if row["task"] == "complete"}
    deleted = [
        {**row, "material": material(row, complete.get(row["key"].partition("-")[0]))}
        for row in rows
        if row["task"] == "deleted"
    ]
    return {
        "deleted": _rates(deleted),
        "deleted_material": _rates([row for row in deleted if row["material"]]),
        "complete": {
            "tasks": len(complete),
            "named": rate(list(complete.values()), lambda row: row["verdict"] == "false"),
        },
        "seconds_median": quantile([row["seconds"] for row in rows], 0.5),
        "rows": [*complete.values(), *deleted],
    }


def _rates(rows: Sequence[Row]) -> Row:
    counts = Counter("missed" if row["verdict"] in ("silent", "failed") else row["verdict"] for row in rows)
    shares = {name: counts[name] / len(rows) if rows else None for name in ("right", "place_right", "false", "missed")}
    return {"tasks": len(rows), **shares, "false_law": rate(rows, lambda row: row.get("false_law"))}


def table(found: Mapping[str, Any]) -> list[str]:
    """Write the rates with their goals."""
    rates = [("material terms", found["deleted_material"]), ("all terms", found["deleted"])]
    lines = [
        (
            words, one["tasks"], percent(one["right"], one["tasks"]), percent(one["place_right"]),
            percent(one["missed"]), percent(one["false"], one["tasks"]),
        )
        for words, one in rates
    ]  # fmt: skip
    complete = found["complete"]
    return [
        *markdown(("deleted", "tasks", "right, or in its class", "the right place", "missed", "false"), lines), "",
        f"Goals for material terms (error on unseen data a third larger without): 80 % right, at most 5 % false. Of "
        f"{complete['tasks']} complete models {percent(complete['named'])} got the name of a law (goal: none).",
    ]  # fmt: skip


STUDY = Study(
    "real_trial",
    "Known terms are deleted from complete models of real rigs, one at a time: real noise, real errors of the model, "
    "known truth.",
    tasks, close_loop_of, summary, table, minutes=15.0,
)  # fmt: skip
