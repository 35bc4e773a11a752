"""Simulated rigs of many kinds: a law that the model lacks, and what the closed loop makes of it.

The program is given a folder with ``Rig.mo``, ``rig.toml``, ``train.csv`` and ``test.csv`` and nothing else. One law of
the library is missing from the model (a third of the trials with correlated noise), none, two, or one that no library
lists. Seeds are ``[17601, kind, number, what]`` for ``--seed 1``.
"""

from __future__ import annotations

import re
import tempfile
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simulated_rigs.kinds import KINDS
from simulated_rigs.trial import REPORT, RigTrial, draw_rig_trial, write_trial
from simulated_rigs.truth import LawTruth
from study.answers import claims_law, close_loop, same_as, unseen
from study.study import Row, Study, Tasks, Told, keyed, number, quantile, rate, rate_cells, rate_of

#: Trials of each kind of rig.
COUNTS = {"law": 4, "none": 3, "pair": 1, "outside": 1}


def joined_connectors(source: str) -> list[set[str]]:
    """Find the sets of connectors that the ``connect`` equations of a Modelica text join."""
    nodes: list[set[str]] = []
    for pair in re.findall(r"connect\s*\(\s*([\w.]+)\s*,\s*([\w.]+)\s*\)", source):
        joined = [node for node in nodes if node & set(pair)]
        nodes = [node for node in nodes if node not in joined]
        nodes.append(set(pair).union(*joined))
    return nodes


def same_places(trial: RigTrial, law: LawTruth) -> list[str]:
    """Return the ids ``law@port`` that name this law at this place.

    A balance goes by its state or, where the state belongs to a component, by any connector that is joined to it. What
    is in series with a component is at its own connectors, or at the other end of a joint of two. An output that is a
    state itself, whose name stands for the balance, is called ``output_NAME``.
    """
    name, kind = law.place.name, law.place.kind
    names = [name, f"output_{name}"] if kind == "output" else [name]
    component = name.rpartition(".")[0]
    if component and kind in ("balance", "coupling"):
        series = kind == "coupling" or trial.kind.states[name].family == "electrical"
        for node in joined_connectors(trial.model.read_text(encoding="utf-8")):
            own = {connector for connector in node if connector.startswith(f"{component}.")}
            if own:
                names += sorted(own if series and len(node) > 2 else node)
    return [f"{law.law}@{one}" for one in dict.fromkeys(names)]


def tasks(options: Namespace) -> Tasks:
    """List all trials, kinds interleaved so that a partial run says something of each."""
    base = REPORT + options.seed - 1
    every = [((k + 0.5) / n, what, rig, k) for rig in KINDS for what, n in COUNTS.items() for k in range(n)]
    return keyed((base, rig, what, k) for _, what, rig, k in sorted(every))


def by_command(folder: Path) -> Row:
    """Close the loop in a folder of a trial."""
    return close_loop(folder, [Path("train.csv")], [Path("test.csv")])


def attempt(task: tuple[int, str, Any, int], program: Callable[[Path], Row] = by_command) -> Row:
    """Draw, record, close the loop, and set the answer beside the truth."""
    base, rig, what, k = task
    trial = draw_rig_trial(rig, k, base, what)
    with tempfile.TemporaryDirectory(prefix="rig-trial-") as folder:
        write_trial(trial, Path(folder))
        answer = program(Path(folder))
    return {
        **answer,
        "rig": rig,
        "what": what,
        "noise": "correlated" if any(noise.slow for noise in trial.noise.values()) else "white",
        "truth": [{"law": law.law, "place": law.place.name, **law.parameters} for law in trial.laws],
        "ids": [same_places(trial, law) for law in trial.laws],
        "d": [law.d for law in trial.laws],
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


def right_pair(row: Row) -> bool:
    """Whether both laws were found and no third one was."""
    return len(row["effects"]) == 2 and all(finds(row, ids, row["effects"]) for ids in row["ids"])


def names_no_law(row: Row) -> bool:
    """Whether no law of the library is claimed."""
    return not any(map(claims_law, row["effects"]))


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
        "failed": len(rows) - len(good),
        "rates": [
            rate_of("right law first, or one that does as well, d ≥ 20", "90 %", strong, right_effect),
            rate_of("the same, 8 ≤ d < 20", "80 %", weak, right_effect),
            rate_of("two laws missing, both d ≥ 20: both found, no third", "80 %", clear, right_pair),
            rate_of("nothing missing: nothing is found", "98 %", none, lambda row: row["outcome"] == "adequate"),
            rate_of("a law that no library lists: none is claimed", "", outside, names_no_law),
        ],
        "after_over_noise": [quantile(after, 0.5), quantile(after, 0.95), len(after)],
        "seconds_median": quantile([row["seconds"] for row in good], 0.5),
        "by_rig": {rig: rate([row for row in strong + weak if row["rig"] == rig], right_effect) for rig in KINDS},
    }


def table(found: Mapping[str, Any]) -> Told:
    """Write the rates, each with its goal and its number of trials."""
    half, most, count = found["after_over_noise"]
    text = (
        f"{found['failed']} of {found['trials']} trials failed. One loop took {number(found['seconds_median'])} s "
        f"(median). The error on unseen data is {number(half)} times the noise (median of {count} trials; in "
        f"95 % at most {number(most)})."
    )
    return text, rate_cells(found["rates"])


STUDY = Study(
    "rig_trial",
    "A law is missing from the model of a simulated rig. *d* is the part of its signature, in units of the noise, that "
    "no change of the model's own parameters imitates.",
    tasks, attempt, summary, table,
)  # fmt: skip
