"""What each part of the closed loop's search contributes: the development trials with one part left out at a time.

The parts are the start rules, edits and checks that ``aero_bayes.search.PARTS`` names; a trial is run with
``[loop] leave_out = ["name"]``. The same 40 trials of the many-rig trial are run with nothing left out and without each
part, ten trials at a time for all parts, so that a run that was stopped compares all of them on what it has. Finished
trials are kept in OUT/ablation/trials.sqlite and not run again: take another OUT for other code. The summary is
OUT/ablation.json, the table OUT/ablation.md.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ablation_table import summarise, table
from aero_bayes.search import PARTS
from rig_trial import Answer, RigTrialTask, close_loop_by_command, run_rig_trial
from simulated_rigs import DEVELOPMENT, rig_kinds
from trial_runs import Row, code, run_study, study_parser, write_summary

#: Trials of each sort, over all kinds of rigs.
COUNTS = {"law": 20, "none": 6, "pair": 8, "outside": 6}
#: Numbers of the trials with one law: the first ones whose law is visible (d >= 8).
LAWS = {
    "pendulum": (0, 1), "cart": (1, 2), "shaft": (2, 3), "motor": (0, 1), "circuit": (0, 3), "tanks": (1, 2),
    "heat": (0, 1), "reservoirs": (0, 3), "oscillator": (0, 1), "carriages": (0, 1),
}  # fmt: skip
#: So many trials are run for all parts before the next ones.
PARCEL = 10


@dataclass(frozen=True)
class Ablation:
    """One trial with one part left out; none where the name is empty."""

    part: str
    trial: RigTrialTask

    @property
    def key(self) -> str:
        """Key of the row: the part that is left out, and the trial."""
        return f"{self.part or 'nothing'}/{self.trial.key}"


def trials() -> list[RigTrialTask]:
    """List the trials, their kinds and sorts interleaved so that the beginning of the list is balanced."""
    kinds = rig_kinds()
    placed = []
    for shift, (what, count) in zip((0, 0, 2, 5), COUNTS.items(), strict=True):
        for k in range(count):
            kind = kinds[(k + shift) % len(kinds)]
            number = LAWS[kind][k // len(kinds)] if what == "law" else 0
            placed.append(((k + 0.5) / count, what, RigTrialTask(DEVELOPMENT, kind, what, number)))
    return [task for *_, task in sorted(placed, key=lambda one: one[:2])]


def ablations(parts: Sequence[str], count: int) -> list[Ablation]:
    """List parcels of trials, each for all parts; those with nothing left out come first."""
    chosen = trials()[:count]
    parcels = [chosen[first : first + PARCEL] for first in range(0, len(chosen), PARCEL)]
    return [Ablation(part, trial) for parcel in parcels for part in ("", *parts) for trial in parcel]


def close_without(folder: Path, part: str) -> Answer:
    """Close the loop with a part of the search left out."""
    if part:
        with (folder / "rig.toml").open("a", encoding="utf-8") as config:
            config.write(f'\n[loop]\nleave_out = ["{part}"]\n')
    return close_loop_by_command(folder)


def run(task: Ablation, version: str) -> Row:
    """Run the trial, and return its row under the key of the ablation."""
    row = run_rig_trial(task.trial, partial(close_without, part=task.part))
    return {**row, "key": task.key, "trial": task.trial.key, "part": task.part, "code": version}


def main() -> None:
    parts = tuple(PARTS)
    parser = study_parser(__doc__)
    parser.add_argument("--part", choices=parts, action="append", help="only these parts (may be repeated)")
    parser.add_argument("--baseline", action="store_true", help="leave nothing out: the comparison alone")
    parser.add_argument("--trials", type=int, default=sum(COUNTS.values()), help="so many of the list, from its top")
    parser.add_argument("--table", action="store_true", help="run nothing, only summarise what is there")
    options = parser.parse_args()
    if options.table:
        options.stop_after = 0.0
    wanted = () if options.baseline else tuple(options.part or parts)
    rows = run_study(
        ablations(wanted, options.trials), partial(run, version=code()),
        options.out / "ablation" / "trials.sqlite", options,
    )  # fmt: skip
    summary = summarise(rows)
    write_summary(summary, options.out / "ablation.json")
    (options.out / "ablation.md").write_text(table(summary) + "\n", encoding="utf-8")
    print(table(summary))


if __name__ == "__main__":
    main()
