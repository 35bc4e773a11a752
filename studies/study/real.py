"""Measured recordings of real rigs: what the closed loop names, held against what is known.

``real_rigs``: ``real_rigs/cases.toml`` says what is fitted to what and which names are right. The recordings are not
part of the project and are looked for in the folders of ``--recordings``.

``real_trial``: ``real_rigs/complete.toml`` names complete models: first models with the effects that the literature
knows, with starts from a fit. Each is a task by itself, in which no law should be claimed, and a task for each term
that a law of the library can express: the model without it, on the same recordings. Noise and errors of the model are
real, the truth is known. Tasks of short recordings come first.
"""

from __future__ import annotations

import re
import tomllib
from argparse import Namespace
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aero_bayes.loop.table import MATERIAL
from study.answers import LoopTask, claims_law, same_as, unseen
from study.study import Row, Study, Told, matches, number, rate_cells, rate_of

STUDIES = Path(__file__).resolve().parents[1]
MODELS = STUDIES / "real_rigs"
#: Where recordings are looked for.
RECORDINGS = tuple(STUDIES.parents[1] / "shared" / name for name in ("rigs", "data"))
#: A term is material if the error of an output on unseen data is this much larger without it.
MATERIAL_GROWTH = 1.0 / MATERIAL
#: What an answer can be: all of what is expected, nothing by right, a part of it or a near law at its place, something
#: that is not missing, nothing of what is expected; or the run did not end.
VERDICTS = ("right", "silent", "place_right", "false", "missed", "failed")


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """What is known of a rig, as patterns of ids (see ``cases.toml``)."""

    expected: Sequence[Sequence[str]] = ()
    silence: bool = False
    place: Sequence[str] = ()
    fine: Sequence[str] = ()


@dataclass(frozen=True)
class RigCase(Expectation):
    """One loop: recordings, the folder of the first model, and what may be named (see ``cases.toml``)."""

    name: str
    train: Sequence[str]
    test: Sequence[str] = ()
    model: str = ""

    @property
    def folder(self) -> Path:
        """Folder of the first model and its configuration."""
        return MODELS / (self.model or self.name)

    def find(self, folders: Sequence[Path] | None = None) -> dict[str, Path]:
        """Find all recordings by name; none where one of them is in none of the folders, which is printed."""
        places, files = folders or RECORDINGS, (*self.train, *self.test)
        there = {file: [place / file for place in places if (place / file).is_file()] for file in files}
        if not all(there.values()):
            print(f"{self.name}: its recordings are not there")
            return {}
        return {file: paths[0].resolve() for file, paths in there.items()}


def cases() -> dict[str, RigCase]:
    """Read all cases, quick ones first."""
    document = tomllib.loads((MODELS / "cases.toml").read_text(encoding="utf-8"))
    return {name: RigCase(name, **entries) for name, entries in document.items()}


def loop_task(case: RigCase, files: Mapping[str, Path], key: str, texts: Mapping[str, str], options: Namespace,
              minutes: float) -> LoopTask:  # fmt: skip
    """Make the task of a loop on the recordings of a case, found as ``files``."""
    train, test = (tuple(files[file] for file in role) for role in (case.train, case.test))
    folder = (options.out / options.study / "runs" / key).resolve()
    return LoopTask(texts, train, test, folder, options.seed, options.loop_minutes or minutes)


def case_tasks(options: Namespace) -> dict[str, LoopTask]:
    """List the cases whose recordings are there."""
    found = {}
    for case in cases().values():
        if files := case.find(options.recordings):
            texts = {path.name: path.read_text(encoding="utf-8") for path in case.folder.glob("[Rr]ig.*")}
            found[case.name] = loop_task(case, files, case.name, texts, options, 20.0)
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
    right = [next((n for n, same in enumerate(names) if matches(same, group)), None) for group in known.expected]
    found = {n for n in right if n is not None}
    rest = [n for n in range(len(names)) if n not in found and not matches(names[n], [*every, *known.fine])]
    ports = [f"*@{pattern.partition('@')[2]}" for pattern in every]
    there = [n for n in rest if matches(names[n], known.place)]
    there += [n for n in rest if effects[n].get("claim") == "place" and matches({f"@{effects[n]['port']}"}, ports)]
    wrong = [n for n in rest if n not in there]
    missed = [" or ".join(group) for group, n in zip(known.expected, right, strict=True) if n is None]
    untold = {name for same in row["equivalent"] for name in same} if not effects else set()
    if wrong:
        verdict = "false"
    elif not effects and matches(untold, every):
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


def case_summary(rows: Sequence[Row]) -> Row:
    """Return how many cases got which verdict."""
    known = cases()
    rows = [judged(row, known[row["key"]]) for row in rows]
    counts = Counter(row["verdict"] for row in rows)
    return {
        "cases": len(rows),
        "verdicts": {verdict: counts[verdict] for verdict in VERDICTS},
        "false_law": sum(row.get("false_law", False) for row in rows),
        "rows": rows,
    }


def case_table(found: Mapping[str, Any]) -> Told:
    """Write the answer for each rig."""
    told = ", ".join(f"{n} {verdict.replace('_', ' ')}" for verdict, n in found["verdicts"].items())
    text = f"{found['cases']} cases: {told}. Goals: 90 % right or silent, a false law in none ({found['false_law']})."
    return text, [(row["key"], said(row), row["verdict"].replace("_", " "), change(row)) for row in found["rows"]]


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


@dataclass(frozen=True)
class Term:
    """A term of a complete model: the texts that go and what stands there then, and what names it."""

    edits: Sequence[tuple[str, str]]
    expected: Sequence[str]
    without: Sequence[str] = ()
    place: Sequence[str] = ()


@dataclass(frozen=True)
class CompleteModel:
    """A complete model of a rig: the case with its recordings, free parameters, and terms by name."""

    case: RigCase
    folder: Path
    free: Sequence[str]
    fine: Sequence[str] = ()
    terms: Mapping[str, Term] = field(default_factory=dict)

    def source(self, term: Term | None) -> str:
        """Return its Modelica text, without a term where one is given.

        Raises ValueError where an edit does not stand in the text once, or a parameter of the term is still used.
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
        case = known[entries.pop("case", name)]
        terms = {key: Term(**one) for key, one in entries.pop("terms", {}).items()}
        found[name] = CompleteModel(case, MODELS / name, terms=terms, **entries)
    return found


def term_tasks(options: Namespace) -> dict[str, LoopTask]:
    """List each complete model, and each without one of its terms, where their recordings are there."""
    found = {}
    for name, model in complete_models().items():
        files = model.case.find(options.recordings)
        terms = {name: None, **{f"{name}-{key}": term for key, term in model.terms.items()}} if files else {}
        for key, term in terms.items():
            texts = {"Rig.mo": model.source(term), "rig.toml": model.configuration(term)}
            found[key] = loop_task(model.case, files, key, texts, options, 5.0)
    return found


def material(row: Row, complete: Row | None) -> bool:
    """Whether the error of an output on unseen data is known to grow by :data:`MATERIAL_GROWTH` without the term."""
    if complete is None or "error" in row or "error" in complete:
        return False
    whole, less = (unseen(one, "before") for one in (complete, row))
    return any(less[name] > MATERIAL_GROWTH * whole[name] for name in whole if whole[name] and less.get(name))


def term_summary(rows: Sequence[Row]) -> Row:
    """Return the rates of all rows; no law should be claimed of a complete model."""
    models, deleted = complete_models(), []
    complete = {row["key"]: row for row in rows if "-" not in row["key"]}
    for row in rows:
        name, _, key = row["key"].partition("-")
        if key:
            term = models[name].terms[key]
            known = Expectation(expected=(term.expected,), place=term.place, fine=models[name].fine)
            deleted.append({**judged(row, known), "material": material(row, complete.get(name))})
    some = [row for row in deleted if row["material"]]
    return {
        "rates": [
            rate_of("a material term: it, or one that does as well, is named", "80 %", some, right),
            rate_of("a material term: something false is named", "≤ 5 %", some, lambda row: row["verdict"] == "false"),
            rate_of("any term: it, or one that does as well, is named", "", deleted, right),
            rate_of("nothing is missing: a law is named", "0 %", list(complete.values()), names_law),
        ],
        "rows": [*complete.values(), *deleted],
    }


def right(row: Row) -> bool:
    """Whether the verdict is the best one."""
    return bool(row["verdict"] == "right")


def names_law(row: Row) -> bool:
    """Whether a law of the library is claimed."""
    return any(map(claims_law, row.get("effects", ())))


def term_table(found: Mapping[str, Any]) -> Told:
    """Write the rates with their goals."""
    return "A term is material if an error on unseen data is a third larger without it.", rate_cells(found["rates"])


REAL_RIGS = Study(
    "real_rigs",
    "The loop on measured recordings, which are not part of the project.",
    case_tasks, LoopTask.close, case_summary, case_table, ("rig", "the model lacks", "verdict", "error on test data"),
)  # fmt: skip
REAL_TRIAL = Study(
    "real_trial",
    "Known terms are deleted from complete models of real rigs, one at a time: real noise, real errors of the model, "
    "known truth.",
    term_tasks, LoopTask.close, term_summary, term_table, minutes=15.0,
)  # fmt: skip
