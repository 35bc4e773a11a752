"""The blind trial over many kinds of rigs: a law that the model lacks, and what the closed loop makes of it.

The program is given a folder with ``Rig.mo``, ``rig.toml``, ``train.csv`` and ``test.csv`` and nothing else. One law of
the library is missing from the model (a third of the trials with correlated noise), none, two, or one that no library
lists. Finished trials are kept, one row each, so that a run that was stopped goes on where it was.

Seeds of the table are ``[17601, kind, number, what]``; what was tuned was tuned on ``[11001, ...]``
(``--development``).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rig_trial_table import summarise
from simulated_rigs import DEVELOPMENT, REPORT, RigTrial, draw_rig_trial, rig_kinds, write_trial
from simulated_rigs.nodes import same_places
from trial_runs import Row, run_study, trial_counts, trial_parser, write_summary

WHATS = ("law", "none", "pair", "outside")
#: Trials of each kind of rig.
FULL = {"law": 18, "none": 20, "pair": 2, "outside": 4}
QUICK = {"law": 1, "none": 1}


@dataclass(frozen=True)
class Answer:
    """What the program says of a rig.

    Parameters
    ----------
    outcome : str
        ``adequate``, ``extended`` or ``unexplained``.
    found : tuple of mapping
        Effects in the order found: ``id`` (``law@port``), ``port``, ``kind`` (``catalogue`` or ``free_form``) and
        ``wins``.
    equivalent : tuple of tuple of str
        Ids that the recording cannot tell apart.
    wins : mapping of str to float
        Of the first round, by id; ``nothing`` and what was not tried among them.
    unseen : mapping of str to float
        Root mean square of the residual on the test recording, per output.
    """

    outcome: str
    found: tuple[Mapping[str, Any], ...] = ()
    equivalent: tuple[tuple[str, ...], ...] = ()
    wins: Mapping[str, float] = field(default_factory=dict)
    unseen: Mapping[str, float] = field(default_factory=dict)


#: The program: a folder with model, configuration and recordings -> what it says.
CloseLoop = Callable[[Path], Answer]


def close_loop_by_command(folder: Path) -> Answer:
    """Run the command of the README in a process of its own and read ``result.json`` (both are contracts)."""
    command = [str(Path(sys.executable).parent / "aero-bayes"), "close-loop", "--config", "rig.toml", "--workers", "1"]
    command += ["--train", "train.csv", "--test", "test.csv", "--out", "out"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])
    return answer_of(json.loads((folder / "out" / "result.json").read_text(encoding="utf-8")))


def answer_of(result: Mapping[str, Any]) -> Answer:
    """Return the parts of ``result.json`` that are judged."""
    loop = result["loop"]
    return Answer(
        loop["outcome"],
        tuple({key: effect.get(key) for key in ("id", "port", "kind", "wins")} for effect in loop["effects"]),
        tuple(tuple(ids) for ids in loop.get("equivalent", [])),
        {effect["id"]: effect["wins"] for effect in loop["effects"] if effect.get("wins") is not None},
        loop.get("after", {}).get("test", {}),
    )


@dataclass(frozen=True)
class RigTrialTask:
    """One trial."""

    base: int
    rig: str
    what: str
    number: int

    @property
    def key(self) -> str:
        """Key of the row: seed, rig, sort of trial, number."""
        return f"{self.base}/{self.rig}/{self.what}/{self.number}"


def rig_trial_tasks(base: int, counts: Mapping[str, int], rigs: tuple[str, ...]) -> list[RigTrialTask]:
    """List all trials, kinds interleaved so that a partial run says something of each."""
    tasks = [RigTrialTask(base, rig, what, k) for rig in rigs for what, n in counts.items() for k in range(n)]
    return sorted(tasks, key=lambda t: ((t.number + 0.5) / counts[t.what], t.what, t.rig))


def run_rig_trial(task: RigTrialTask, program: CloseLoop = close_loop_by_command) -> Row:
    """Draw, record, close the loop, and set the answer beside the truth."""
    began = time.perf_counter()
    trial = draw_rig_trial(task.rig, task.number, task.base, task.what)  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory(prefix="rig-trial-") as folder:
        write_trial(trial, folder)
        loop_began = time.perf_counter()
        answer = program(Path(folder))
        seconds = time.perf_counter() - loop_began
    return {
        "key": task.key,
        "rig": task.rig,
        "what": task.what,
        "noise": "correlated" if any(noise.slow for noise in trial.truth.noise.values()) else "white",
        "truth": [
            {"law": law.law, "place": law.place.kind, "name": law.place.name, "named": law.named, **law.parameters}
            for law in trial.truth.laws
        ],
        "ids": [same_places(trial, law) for law in trial.truth.laws],
        "d": [law.d for law in trial.truth.laws],
        "outcome": answer.outcome,
        "found": list(answer.found),
        "equivalent": [list(ids) for ids in answer.equivalent],
        "wins": dict(answer.wins),
        "after_over_noise": _over_noise(trial, answer),
        "seconds": round(seconds, 3),
        "whole_seconds": round(time.perf_counter() - began, 3),
    }


def _over_noise(trial: RigTrial, answer: Answer) -> dict[str, float]:
    """Return the residual on the unseen recording over the noise that is truly in it."""
    over = {}
    for output, rms in answer.unseen.items():
        noise = trial.test.outputs[output] - trial.noise_free["test"].outputs[output]
        over[output] = rms / float(np.sqrt(np.mean(noise**2)))
    return over


def main() -> None:
    parser = trial_parser(__doc__, WHATS)
    parser.add_argument("--rig", choices=rig_kinds(), action="append")
    options = parser.parse_args()
    base = DEVELOPMENT if options.development else REPORT
    tasks = rig_trial_tasks(base, trial_counts(options, FULL, QUICK), tuple(options.rig or rig_kinds()))
    rows = run_study(tasks, run_rig_trial, options.out / "rig_trial" / "trials.sqlite", options)
    summary, text = summarise(rows, base, DEVELOPMENT)
    print(text)
    write_summary(summary, options.out / ("rig_trial-quick.json" if options.quick else "rig_trial.json"))


if __name__ == "__main__":
    main()
