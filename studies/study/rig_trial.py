"""Simulated rigs of many kinds: a law that the model lacks, and what the closed loop makes of it.

The program is given a folder with ``Rig.mo``, ``rig.toml``, ``train.csv`` and ``test.csv`` and nothing else. One law of
the library is missing from the model (a third of the trials with correlated noise), none, two, or one that no library
lists. Seeds are ``[17601, kind, number, what]``; those of ``--development`` are for tuning.
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simulated_rigs import DEVELOPMENT, REPORT, RigTrial, draw_rig_trial, rig_kinds, write_trial
from simulated_rigs.nodes import same_places
from study.answers import claims_law, close_loop, same_as, unseen
from study.study import Row, Study, markdown, number, percent, quantile, rate

#: Trials of each kind of rig.
COUNTS = {"law": 18, "none": 20, "pair": 4, "outside": 4}


@dataclass(frozen=True)
class RigTask:
    """One trial."""

    base: int
    rig: str
    what: str
    number: int

    @property
    def key(self) -> str:
        """Seed, rig, sort of trial, number."""
        return f"{self.base}/{self.rig}/{self.what}/{self.number}"


def tasks(options: Namespace) -> list[RigTask]:
    """List all trials, kinds interleaved so that a partial run says something of each."""
    base = DEVELOPMENT if options.development else REPORT
    found = [RigTask(base, rig, what, k) for rig in rig_kinds() for what, n in COUNTS.items() for k in range(n)]
    return sorted(found, key=lambda task: ((task.number + 0.5) / COUNTS[task.what], task.what, task.rig))


def by_command(folder: Path) -> Row:
    """Close the loop in a folder of a trial."""
    return close_loop(folder, [Path("train.csv")], [Path("test.csv")])


def attempt(task: RigTask, program: Callable[[Path], Row] = by_command) -> Row:
    """Draw, record, close the loop, and set the answer beside the truth."""
    trial = draw_rig_trial(task.rig, task.number, task.base, task.what)  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory(prefix="rig-trial-") as folder:
        write_trial(trial, folder)
        answer = program(Path(folder))
    return {
        **answer,
        "rig": task.rig,
        "what": task.what,
        "noise": "correlated" if any(noise.slow for noise in trial.truth.noise.values()) else "white",
        "truth": [{"law": law.law, "place": law.place.name, **law.parameters} for law in trial.truth.laws],
        "ids": [same_places(trial, law) for law in trial.truth.laws],
        "d": [law.d for law in trial.truth.laws],
        "after_over_noise": over_noise(trial, answer),
    }


def over_noise(trial: RigTrial, answer: Row) -> dict[str, float]:
    """Return the error on the unseen recording over the noise that is truly in it, by output."""
    clean = trial.noise_free["test"].outputs
    noise = {name: trial.test.outputs[name] - values for name, values in clean.items()}
    return {name: rms / float(np.sqrt(np.mean(noise[name] ** 2))) for name, rms in unseen(answer, "after").items()}


def finds(row: Row, ids: Sequence[str], effects: Sequence[Mapping[str, Any]]) -> bool:
    """Whether one of the effects, or what does as well in its place, is one of the ids."""
    return any(same_as(row, effect) & set(ids) for effect in effects)


def right_effect(row: Row) -> bool:
    """Whether the true law, or one that does as well, was found first."""
    return finds(row, row["ids"][0], row["effects"][:1])


def right_port(row: Row) -> bool:
    """Whether what was found first, or what does as well, acts where the true law does."""
    places = {place(name) for name in row["ids"][0]}
    return any({effect["port"], *map(place, same_as(row, effect))} & places for effect in row["effects"][:1])


def place(name: str) -> str:
    """Return the port of an id."""
    return name.partition("@")[2]


def right_pair(row: Row) -> bool:
    """Whether both laws were found and no third one was."""
    return len(row["effects"]) == 2 and all(finds(row, ids, row["effects"]) for ids in row["ids"])


def names_a_law(row: Row) -> bool:
    """Whether a law of the library is claimed."""
    return any(map(claims_law, row["effects"]))


def summary(rows: Sequence[Row]) -> Row:
    """Return the rates over the distance at which the missing law shows."""
    good = [row for row in rows if "error" not in row]
    law, none, pair, outside = ([row for row in good if row["what"] == what] for what in COUNTS)
    strong = [row for row in law if row["d"][0] >= 20.0]
    weak = [row for row in law if 8.0 <= row["d"][0] < 20.0]
    clear = [row for row in pair if min(row["d"], default=0.0) >= 20.0]
    after = [max(row["after_over_noise"].values()) for row in strong + weak if row["after_over_noise"]]
    return {
        "trials": len(rows),
        "right_effect": {"d>=20": rate(strong, right_effect), "8<=d<20": rate(weak, right_effect)},
        "right_pair": rate(clear, right_pair),
        "right_port": rate(strong + weak, right_port),
        "nothing_missing": rate(none, lambda row: row["outcome"] == "adequate"),
        "false_discovery": rate(none, names_a_law),
        "abstained_outside": rate(outside, lambda row: not names_a_law(row)),
        "after_over_noise_median": quantile(after, 0.5),
        "after_over_noise_q95": quantile(after, 0.95),
        "seconds_median": quantile([row["seconds"] for row in good], 0.5),
        "counts": {
            "d>=20": len(strong), "8<=d<20": len(weak), "none": len(none), "pair": len(clear),
            "outside": len(outside), "failed": len(rows) - len(good),
        },
        "by_rig": {rig: one_rig([row for row in strong + weak if row["rig"] == rig]) for rig in rig_kinds()},
        "seeds": {"table": [REPORT, "rig", "number", "what"], "development": [DEVELOPMENT, "rig", "number", "what"]},
        "table": list(rows),
    }  # fmt: skip


def one_rig(rows: Sequence[Row]) -> Row:
    """Return the rate of one kind of rig."""
    return {"trials": len(rows), "right_effect": rate(rows, right_effect)}


def table(found: Mapping[str, Any]) -> list[str]:
    """Write the rates, each with its goal and its number of trials."""
    counts = found["counts"]
    rates = (
        ("right law first, or one that does as well, d ≥ 20", "90 %", found["right_effect"]["d>=20"], "d>=20"),
        ("the same, 8 ≤ d < 20", "80 %", found["right_effect"]["8<=d<20"], "8<=d<20"),
        ("two laws missing, both d ≥ 20: both found, no third", "80 %", found["right_pair"], "pair"),
        ("nothing missing: nothing is found", "98 %", found["nothing_missing"], "none"),
        ("a law that no library lists: none is claimed", "", found["abstained_outside"], "outside"),
    )
    lines = [(words, goal, percent(share, counts[key]), counts[key]) for words, goal, share, key in rates]
    after = f"{number(found['after_over_noise_median'])} ({number(found['after_over_noise_q95'])})"
    seen = counts["d>=20"] + counts["8<=d<20"]
    lines += [("error on unseen data over the noise, median (95 % below)", "", after, seen)]
    lines += [("one loop, median", "", f"{number(found['seconds_median'])} s", found["trials"] - counts["failed"])]
    failed = [f"{counts['failed']} of {found['trials']} trials failed."] if counts["failed"] else []
    return [*markdown(("", "goal", "measured", "trials"), lines), *(["", *failed] if failed else [])]


STUDY = Study(
    "rig_trial",
    "A law is missing from the model of a simulated rig. *d* is the part of its signature, in units of the noise, that "
    "no change of the model's own parameters imitates.",
    tasks, attempt, summary, table,
)  # fmt: skip
