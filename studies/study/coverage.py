"""Do the intervals hold what they promise where the model is right? Simulation-based calibration.

Every trial draws the truth from the prior, records it with a simulator that shares no code with the model's, fits,
samples, and asks where the truth ranks in the posterior. If inference is right the ranks are uniform and an interval of
90 % holds the truth in 90 % of the trials (Talts et al., 2018, arXiv:1804.06788).
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kstest

import aero_bayes
from study.repeated import repeated_rigs
from study.study import Row, Study, Tasks, Told, keyed, number, percent

#: Kinds of noise, and how many recordings are fitted together in every trial.
NOISES, RECORDINGS = ("white", "correlated"), (1, 2)
#: Trials of each rig, noise and number of recordings.
COUNT = 35
SETTINGS = aero_bayes.SampleSettings(ess=400.0, max_steps=1000, max_minutes=2.0, predictive=0)


def tasks(options: Namespace) -> Tasks:
    """List all trials, cells in turn."""
    cells = product(range(COUNT), repeated_rigs(), NOISES, RECORDINGS)
    return keyed((options.seed, rig, noise, recordings, number) for number, rig, noise, recordings in cells)


def attempt(task: tuple[int, str, str, int, int]) -> Row:
    """Rank the truth in the posterior; everything random follows from the task."""
    seed, name, noise, recordings, number = task
    rig = repeated_rigs()[name]
    rng = np.random.default_rng([seed, number, *name.encode(), NOISES.index(noise), recordings])
    truth = rig.draw(rng)
    made = [rig.record(truth, rng, f"r{k}", correlated=noise == "correlated") for k in range(recordings)]
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
    """Return the shares within the intervals by kind of noise, and how uniform ranks are by rig and parameter."""
    cells: dict[tuple[str, str, str], list[float]] = {}
    good = [row for row in rows if "ranks" in row]
    for row in good:
        _, rig, noise, _, _ = row["key"].split("/")
        for name, rank in row["ranks"].items():
            cells.setdefault((noise, rig, name), []).append(rank)
    every = {noise: [r for cell, ranks in cells.items() if cell[0] == noise for r in ranks] for noise in NOISES}
    return {
        "recordings": sum(int(row["key"].split("/")[3]) for row in good),
        "failed": len(rows) - len(good),
        "noises": {noise: held(ranks) for noise, ranks in every.items()},
        "cells": [[*cell, held(ranks)] for cell, ranks in cells.items()],
    }


def held(ranks: Sequence[float]) -> Row:
    """Return the shares of ranks (n,) within central intervals, and how probable ranks less uniform are."""
    if not ranks:
        return {"50": None, "90": None, "p": None, "count": 0}
    away, p = np.abs(np.array(ranks) - 0.5), float(kstest(ranks, "uniform").pvalue)
    return {"50": float(np.mean(away < 0.25)), "90": float(np.mean(away < 0.45)), "p": p, "count": len(ranks)}


#: Columns of the tables of both studies of intervals.
HEAD = (
    "state", "number", "50 % hold (goal 50 %)", "90 % hold (goal 85 to 95 %)", "width (goal ≤ 1.5)",
    "least squares: 90 %",
)  # fmt: skip


def table(found: Mapping[str, Any]) -> Told:
    """Write what the intervals hold."""
    p = [of["p"] for *_, of in found["cells"]]
    text = (
        f"{found['recordings']} recordings, {found['failed']} trials failed. The least of {len(p)} p-values of uniform "
        f"ranks is {number(min(p, default=None))} (about {1 / max(len(p) + 1, 2):.2g} if all is well)."
    )
    lines: list[tuple[object, ...]] = [
        (f"the model is right, {noise} noise", of["count"], percent(of["50"]), percent(of["90"]), "", "")
        for noise, of in found["noises"].items()
    ]
    return text, lines


STUDY = Study(
    "coverage",
    "Intervals where the model is right: they should hold the truth, which is drawn from the prior.",
    tasks, attempt, summary, table, HEAD, minutes=18.5,
)  # fmt: skip
