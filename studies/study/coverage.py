"""Do the intervals hold what they promise where the model is right? Simulation-based calibration.

Every trial draws the truth from the prior, records it with a simulator that shares no code with the model's, fits,
samples, and asks where the truth ranks in the posterior. If inference is right the ranks are uniform and an interval of
90 % holds the truth in 90 % of the trials (Talts et al., 2018, arXiv:1804.06788).
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kstest

import aero_bayes
from study.repeated import repeated_rigs
from study.study import Row, Study, markdown, number, percent

#: Kinds of noise, and how many recordings are fitted together in every trial.
NOISES, RECORDINGS = ("white", "correlated"), (1, 2)
#: Trials of each rig, noise and number of recordings, and the seed of all.
COUNT, SEED = 35, 1
SETTINGS = aero_bayes.SampleSettings(ess=400.0, max_steps=1000, max_minutes=2.0, predictive=0)


@dataclass(frozen=True)
class CoverageTask:
    """One trial."""

    seed: int
    rig: str
    noise: str
    recordings: int
    number: int

    @property
    def key(self) -> str:
        """Seed, rig, noise, recordings, number."""
        return f"{self.seed}/{self.rig}/{self.noise}/{self.recordings}/{self.number}"


def tasks(options: Namespace) -> list[CoverageTask]:
    """List all trials, cells in turn."""
    return [
        CoverageTask(options.seed + SEED - 1, rig, noise, recordings, number)
        for number in range(COUNT)
        for rig in repeated_rigs()
        for noise in NOISES
        for recordings in RECORDINGS
    ]


def attempt(task: CoverageTask) -> Row:
    """Rank the truth in the posterior; everything random follows from the task."""
    rig, cell = repeated_rigs()[task.rig], [*task.rig.encode(), NOISES.index(task.noise), task.recordings]
    rng = np.random.default_rng([task.seed, task.number, *cell])
    truth = rig.draw(rng)
    made = [rig.record(truth, rng, f"r{k}", correlated=task.noise == "correlated") for k in range(task.recordings)]
    with tempfile.TemporaryDirectory(prefix="coverage-") as folder:
        fit = rig.fit(made, rig.build(Path(folder)))
        posterior = aero_bayes.sample(fit, settings=SETTINGS, seed=int(rng.integers(2**31)), workers=0)
    known = [name for name in truth if posterior.parameters[name].q05 is not None]
    return {
        "ranks": {name: float(np.mean(posterior.samples(name) < truth[name])) for name in known},
        "noise_found": {output: noise.kind for output, noise in fit.noise.items()},
        "warned": len(fit.warnings),
    }


def summary(rows: Sequence[Row]) -> Row:
    """Return the shares within the intervals by kind of noise, and by rig and parameter."""
    good = [{**row, "cell": row["key"].split("/")} for row in rows if "ranks" in row]
    entries = []
    for noise in NOISES:
        for rig in repeated_rigs():
            of = [row for row in good if row["cell"][1:3] == [rig, noise]]
            for name in {name: None for row in of for name in row["ranks"]}:
                ranks = [row["ranks"][name] for row in of if name in row["ranks"]]
                entries.append({"noise": noise, "rig": rig, "parameter": name, "trials": len(ranks), **held(ranks)})
    every = {noise: [r for row in good if row["cell"][2] == noise for r in row["ranks"].values()] for noise in NOISES}
    return {
        "recordings": sum(int(row["cell"][3]) for row in good),
        "trials": len(good),
        "failed": len(rows) - len(good),
        **{noise: {key: held(ranks)[key] for key in ("50", "90")} for noise, ranks in every.items()},
        "rank_uniformity_p_min": min((entry["p"] for entry in entries if entry["p"] is not None), default=None),
        "rank_uniformity_tests": len(entries),
        "rows": entries,
    }


def held(ranks: Sequence[float]) -> Row:
    """Return the shares of ranks (n,) within central intervals, and how probable ranks less uniform are."""
    if not ranks:
        return {"50": None, "90": None, "p": None}
    away, p = np.abs(np.array(ranks) - 0.5), kstest(ranks, "uniform").pvalue
    return {"50": float(np.mean(away < 0.25)), "90": float(np.mean(away < 0.45)), "p": float(p)}


def table(found: Mapping[str, Any]) -> list[str]:
    """Write what the intervals hold."""
    counts = {noise: sum(e["trials"] for e in found["rows"] if e["noise"] == noise) for noise in NOISES}
    lines = [(noise, percent(found[noise]["50"]), percent(found[noise]["90"]), counts[noise]) for noise in NOISES]
    tests = found["rank_uniformity_tests"]
    return [
        *markdown(("noise", "50 % hold (goal 50 %)", "90 % hold (goal 90 %)", "intervals"), lines), "",
        f"{found['recordings']} recordings, {found['failed']} trials failed. The least of {tests} p-values of uniform "
        f"ranks is {number(found['rank_uniformity_p_min'])} (about {1 / max(tests + 1, 2):.2g} if all is well).",
    ]  # fmt: skip


STUDY = Study(
    "coverage",
    "Intervals where the model is right: they should hold the truth, which is drawn from the prior.",
    tasks, attempt, summary, table, minutes=18.5,
)  # fmt: skip
