"""Process noise in the closed loop: does it name the state that a random force drives, and nothing where a law acts?

    python studies/process_noise_loop.py --recordings 12

The rigs are those of the study of wrong models (``wrong_rigs.py``). In the state ``process_noise`` a random force acts;
in ``unlisted`` something acts that no law of the library describes, and which is not chance. Each recording is split
into what is fitted and, a second one, what tests the result. Written to ``reports/process_noise_loop.json``, resumable.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes import load_model
from aero_bayes.fleets import open_executor
from coverage_wrong import closed_loop, generator
from trial_runs import code, executor_options, rate, run_trials, write_summary
from wrong_rigs import SIZES, rigs

#: First numbers of the seeds: of development, and of the report.
DEVELOPMENT, REPORT = 36001, 36902
STATES = ("process_noise", "unlisted")
#: The state of the model that the random force drives, by rig.
DRIVEN = {"pendulum": "omega", "motor": "speed", "reservoirs": "level_1"}


@dataclass(frozen=True)
class LoopTask:
    """One loop on one recording."""

    seed: int
    rig: str
    state: str
    number: int

    @property
    def key(self) -> str:
        return f"{self.seed}/{self.state}/{self.rig}/{self.number}"


def attempt(task: LoopTask) -> dict[str, Any]:
    """What the loop says of one recording."""
    rig, began = rigs()[task.rig], time.perf_counter()
    rng = generator(task.seed, task.state, task.rig, task.number)
    size = SIZES[task.number % len(SIZES)]
    with tempfile.TemporaryDirectory() as folder:
        found = closed_loop(rig, load_model(rig.reference), task.state, size, rng, Path(folder))
    noise = found.process_noise
    row: dict[str, Any] = {
        "key": task.key, "state": task.state, "rig": task.rig, "outcome": found.outcome,
        "effects": [effect.id for effect in found.effects], "process_noise": list(noise.states) if noise else [],
        "equivalent": [list(states) for states in noise.equivalent] if noise else [],
        "explains": bool(noise and noise.explains), "stage_seconds": found.seconds.get("process noise", 0.0),
        "seconds": time.perf_counter() - began,
    }  # fmt: skip
    if noise is not None and noise.explains:
        spreads = {name: (noise.parameters[name], found.parameters[name], true) for name, true in rig.truth.items()}
        row["held"] = {n: bool(p.q05 <= true <= p.q95) for n, (p, _, true) in spreads.items()}
        row["held_without"] = {n: bool(p.q05 <= true <= p.q95) for n, (_, p, true) in spreads.items()}
        row["width_ratio"] = {n: (p.q95 - p.q05) / (q.q95 - q.q05) for n, (p, q, _) in spreads.items()}
    return row


def summary_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rates of one state, over the recordings in which the laws leave something."""
    left = [row for row in rows if row["outcome"] == "unexplained" or row["process_noise"]]
    explained = [row for row in left if row["explains"]]
    every = {
        key: [v for row in explained for v in row[key].values()] for key in ("held", "held_without", "width_ratio")
    }
    return {
        "recordings": len(rows),
        "adequate": rate(rows, lambda row: row["outcome"] == "adequate"),
        "laws_named": rate(rows, lambda row: bool(row["effects"])),
        "left": len(left),
        "explained": rate(left, lambda row: bool(row["explains"])),
        "right_state": rate(explained, lambda row: row["process_noise"] == [DRIVEN[row["rig"]]]),
        "right_or_equivalent": rate(
            explained, lambda row: [DRIVEN[row["rig"]]] in [row["process_noise"], *row["equivalent"]]
        ),
        "90_with": float(np.mean(every["held"])) if explained else None,
        "90_without": float(np.mean(every["held_without"])) if explained else None,
        "width_ratio_median": float(np.median(every["width_ratio"])) if explained else None,
        "stage_seconds_median": float(np.median([row["stage_seconds"] for row in left])) if left else None,
        "seconds_median": float(np.median([row["seconds"] for row in rows])) if rows else None,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--development", action="store_true", help="other seeds than those of the report")
    parser.add_argument("--recordings", type=int, default=12, help="of each rig in each state")
    parser.add_argument("--minutes", type=float, default=14.0, help="start no new loop after so long")
    executor_options(parser)
    options = parser.parse_args()
    seed, began = DEVELOPMENT if options.development else REPORT, time.monotonic()
    options.out.mkdir(parents=True, exist_ok=True)
    tasks = [LoopTask(seed, r, s, k) for k in range(options.recordings) for r in DRIVEN for s in STATES]
    with open_executor(options.dask, options.processes) as executor:
        rows = run_trials(
            tasks, attempt, options.out / "process_noise_loop.sqlite", executor,
            until=lambda: time.monotonic() - began > 60.0 * options.minutes,
        )  # fmt: skip
    good = [row for row in rows if "outcome" in row]
    result = {
        "states": {s: summary_of([row for row in good if row["state"] == s]) for s in STATES},
        "by_rig": {f"{s}/{r}": summary_of([w for w in good if (w["state"], w["rig"]) == (s, r)])
                   for s in STATES for r in DRIVEN},
        "failed": [row for row in rows if "outcome" not in row], "seed": seed, "code": code(), "rows": good,
    }  # fmt: skip
    write_summary(result, options.out / "process_noise_loop.json")
    print(json.dumps({key: value for key, value in result.items() if key != "rows"}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
