"""The blind trial: recordings of a simulated rig with an undeclared effect, and what the closed loop makes of them.

The loop sees nothing but CSV files. Truths are drawn at random: base parameters off nominal by up to 15 %, an effect of
the catalogue of random size (half of them scaled down to where the data begin to fail), none, two, or one that no
catalogue lists; half with white noise, half with the noise of a real AERO. Finished trials are kept, one row each, so
that a run that was stopped goes on where it was.

Seeds of the table are ``[7201, kind, number]``; what was tuned was tuned on ``[1001, kind, number]``
(``--development``).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.data import read_recording
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.modelica_family import ModelicaFamily
from aero_bayes.loop import LoopSettings, close_loop
from aero_trial import draw_aero_trial
from trial_distance import effect_distances, scaled_to
from trial_runs import run_study, trial_counts, trial_parser, write_summary
from trial_table import summarise

TABLE, DEVELOPMENT = 7201, 1001
KINDS = ("single", "none", "pair", "outside")
FULL = {"single": 420, "none": 200, "pair": 60, "outside": 80}
QUICK = {"single": 10, "none": 4, "pair": 2, "outside": 2}
BASE = "Aero.Systems.OneDof"


@dataclass(frozen=True)
class AeroTrialTask:
    """One trial: the root of its seed, its kind, its number, and where compiled models are kept."""

    root: int
    kind: str
    number: int
    cache: Path

    @property
    def noise(self) -> str:
        """Kind of noise: white and real in turn."""
        return "white" if self.number % 2 == 0 else "real"

    @property
    def key(self) -> str:
        """Key of the row: root of the seed, kind, number."""
        return f"{self.root}/{self.kind}/{self.number}"


def aero_trial_tasks(root: int, counts: dict[str, int], cache: Path) -> list[AeroTrialTask]:
    """List all trials, kinds interleaved so that a partial run says something of each."""
    tasks = [AeroTrialTask(root, kind, k, cache) for kind, n in counts.items() for k in range(n)]
    return sorted(tasks, key=lambda t: ((t.number + 0.5) / counts[t.kind], t.kind))


def run(task: AeroTrialTask) -> dict[str, Any]:
    """Draw, record, close the loop, and compare with the truth."""
    began = time.perf_counter()
    rng = np.random.default_rng([task.root, KINDS.index(task.kind), task.number])
    spec = draw_aero_trial(rng, task.kind, task.noise)  # type: ignore[arg-type]
    family = ModelicaFamily(LawPlaces(BASE), task.cache)
    if task.kind == "single" and (task.number // 2) % 2 == 0:
        spec = scaled_to(spec, float(np.exp(rng.uniform(np.log(5.0), np.log(40.0)))), family)
    with tempfile.TemporaryDirectory(prefix="trial-") as folder:
        made = spec.record()
        paths = spec.write(made, Path(folder) / "seen", Path(folder) / "truth" / "truth.json")
        train, test = (read_recording(path) for path in paths)
        loop_began, cpu = time.perf_counter(), time.process_time()
        settings = LoopSettings(cache=task.cache)
        result = close_loop([train], [test], model=BASE, settings=settings, workers=0, out_dir=Path(folder) / "out")
        seconds, cpu = time.perf_counter() - loop_began, time.process_time() - cpu
    noise_free = spec.noise_free().record()
    over = {}
    for output, values in made.test[0].outputs.items():
        noise = values - noise_free.test[0].outputs[output]
        after = result.predicted_after.test[test.name, output].rms
        over[output] = after / float(np.sqrt(np.nanmean(noise**2)))
    truth = [effect.id for effect in spec.truth.effects]
    return {
        "key": task.key,
        "kind": task.kind,
        "noise": task.noise,
        "truth": [{"id": e.id, "port": e.port, **e.parameters} for e in spec.truth.effects],
        "d": effect_distances(spec, noise_free.train[0], family, truth),
        "outcome": result.outcome,
        "found": [{"id": e.id, "port": e.port, "kind": e.kind, "share": e.share} for e in result.effects],
        "equivalent": [list(ids) for ids in result.equivalent],
        "best": [(c.id, round(c.share, 3)) for c in (result.steps[0].candidates[:3] if result.steps else ())],
        "after_over_noise": over,
        "sentence": result.sentence,
        "simulations": result.simulations,
        "seconds": round(seconds, 3),
        "cpu_seconds": round(cpu, 3),
        "whole_seconds": round(time.perf_counter() - began, 3),
    }


def main() -> None:
    parser = trial_parser(__doc__, KINDS)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    options = parser.parse_args()
    counts = trial_counts(options, FULL, QUICK)
    root = DEVELOPMENT if options.development else TABLE
    work = options.out / "trial"
    cache = (work / "fmu").resolve()
    ModelicaFamily(LawPlaces(BASE), cache).base_model()
    tasks = [t for t in aero_trial_tasks(root, counts, cache) if t.number >= options.first]
    rows = run_study(tasks, run, work / "trials.sqlite", options)
    summary, text = summarise(rows, root, DEVELOPMENT)
    print(text)
    write_summary(summary, options.out / ("trial-quick.json" if options.quick else "trial.json"))


if __name__ == "__main__":
    main()
