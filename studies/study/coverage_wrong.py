"""How far do intervals hold where the model is wrong? Coverage and width over repeated experiments.

Simulated rigs are recorded again and again in states that the model knows nothing of: nothing is missing, a law is
missing, an effect that no library lists acts, a random force drives a state. In a fifth state the closed loop has found
the missing law, and the extended model is fitted to recordings in which the law acts.

What an interval should hold is what the fit would give if the experiment went on for very long: the best values, those
of one recording :data:`LONG` times as long. Where the model is right or mended, it is the true values. Beside the
intervals of the program stand those of least squares under white noise. Widths are relative to the narrowest interval
that could hold: 1.645 times the root mean square error of the estimates, to either side.
"""

from __future__ import annotations

import json
import tempfile
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

import aero_bayes
from aero_bayes.data import Recording, write_csv
from study.answers import close_loop
from study.coverage import HEAD, RepeatedRig, repeated_rigs
from study.study import Row, Study, Told, percent, rate, write_json

STATES = {
    "right": "the model is right",
    "missing": "a listed law is missing",
    "mended": "the loop found the law and added it",
    "unlisted": "something acts that no law lists",
    "process_noise": "a random force drives a state",
}
#: First number of the seeds of ``--seed 1``, those of the report.
REPORT = 35902
#: Recordings of each rig in each state, factors of the size of what is missing, length of the recording of best values.
COUNT, SIZES, LONG = 26, (1.0, 3.0), 40.0
#: The first posteriors predict a new recording.
PREDICTING = 2
SHORT = aero_bayes.SampleSettings(ess=200.0, max_steps=400, max_minutes=1.0, predictive=20)
#: Half a central interval of 90 % of a Gaussian in standard deviations, and one of 50 % over it.
HALF_90, HALF_50_OVER_90 = 1.6448536269514722, 0.41006
METHODS = {"ours": "aero-bayes", "curve_fit": "least squares, white noise"}


@dataclass(frozen=True)
class Repetition:
    """One repetition of an experiment; ``folder`` keeps what the repetitions of a rig share."""

    seed: int
    rig: str
    state: str
    number: int
    folder: Path

    @property
    def size(self) -> float:
        """Factor of the size of what is missing."""
        return SIZES[self.number % len(SIZES)]

    def generator(self, *parts: int) -> Generator:
        """Return random numbers of this rig and state."""
        return np.random.default_rng([self.seed, *self.rig.encode(), *self.state.encode(), *parts])


def tasks(options: Namespace) -> dict[str, Repetition]:
    """List all repetitions, states and rigs in turn."""
    seed, folder = REPORT + options.seed - 1, (options.out / "coverage_wrong").resolve()
    cells = product(range(COUNT), STATES, repeated_rigs())
    return {f"{seed}/{state}/{rig}/{k}": Repetition(seed, rig, state, k, folder) for k, state, rig in cells}


def kept(path: Path, make: Callable[[], Row]) -> Row:
    """Read what was made before, or make it; two processes that make it at once make the same."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(make(), path)
    found: Row = json.loads(path.read_text(encoding="utf-8"))
    return found


def true_values(task: Repetition, rig: RepeatedRig) -> dict[str, float]:
    """Draw the rig: the same in all repetitions and states."""
    return rig.draw(np.random.default_rng([task.seed, *task.rig.encode()]))


def best_values(task: Repetition, rig: RepeatedRig, model: aero_bayes.Model) -> Row:
    """Fit a long recording as plain least squares does, which weighs each output by its error."""
    rng = task.generator(SIZES.index(task.size), 1)
    recording = rig.record(true_values(task, rig), rng, "long", state=task.state, size=task.size, times=LONG)
    found = rig.fit([recording], model, noise="white")
    return {name: found[name].value for name in rig.kind.free}


def mend(task: Repetition, rig: RepeatedRig) -> Row:
    """Let the closed loop add to the model, from two recordings in which the law is large; files stay in the folder."""
    rng, folder = task.generator(1), task.folder / f"mended_{task.seed}_{task.rig}"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("Rig.mo", "rig.toml"):
        (folder / name).write_text(rig.source.with_name(name).read_text(encoding="utf-8"), encoding="utf-8")
    for name in ("train", "test"):
        recording = rig.record(true_values(task, rig), rng, name, state="missing", size=max(SIZES))
        write_csv(recording, folder / f"{name}.csv")
    found = close_loop(folder, [Path("train.csv")], [Path("test.csv")])
    loop = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))["loop"]
    right = [e for e in loop["effects"] if e["id"].partition("@")[0] == rig.missing.law]
    return {
        "effects": [effect["id"] for effect in found["effects"]],
        "model": loop["model"],
        "sources": [str(folder / "out" / effect["modelica"]) for effect in loop["effects"]],
        "starts": {name: one["value"] for effect in loop["effects"] for name, one in effect["parameters"].items()},
        "law": list(right[0]["parameters"]) if right else [],
    }


def attempt(task: Repetition) -> Row:
    """Return the intervals of all methods on one recording, beside what they should hold."""
    rig, rng = repeated_rigs()[task.rig], task.generator(task.number, 2)
    truth, shared = true_values(task, rig), f"{task.seed}_{task.rig}"
    acts = "missing" if task.state == "mended" else task.state
    with tempfile.TemporaryDirectory(prefix="coverage-wrong-") as folder:
        model, targets, starts = rig.build(Path(folder)), dict(truth), {}
        if task.state == "mended":
            found = kept(task.folder / f"mended_{shared}.json", lambda: mend(task, rig))
            if not found["law"]:
                return {"effects": found["effects"], "error": "the loop did not find the law"}
            sources, starts = [rig.source, *map(Path, found["sources"])], found["starts"]
            model = aero_bayes.load_model(found["model"], sources=sources, folder=Path(folder) / "mended")
            targets |= dict(zip(found["law"], rig.law("missing", task.size).parameters.values(), strict=False))
        elif task.state != "right":
            name = f"best_{shared}_{task.state}_{task.size:g}.json"
            targets = kept(task.folder / name, lambda: best_values(task, rig, model))

        def record(name: str) -> Recording:
            return rig.record(truth, rng, name, state=acts, size=task.size)

        fit = rig.fit([record("train")], model, starts=starts)
        white = fit
        if any(noise.kind != "white" for noise in fit.noise.values()):
            white = rig.fit(list(fit.calibration.data.recordings), model, "white", starts)
        methods = {"ours": intervals(fit), "curve_fit": least_squares_intervals(white)}
        row: Row = {
            "targets": targets,
            "methods": {m: {n: of[n] for n in of if n in targets} for m, of in methods.items()},
            "error_of_model": [output for output, noise in fit.noise.items() if noise.model_error],
        }
        if task.number < PREDICTING:
            posterior = aero_bayes.sample(fit, settings=SHORT, seed=int(rng.integers(2**31)), workers=0)
            row["bands"] = posterior.predict(record("unseen")).coverage
    return row


def intervals(fit: aero_bayes.Fit) -> dict[str, list[float]]:
    """Return estimate and intervals of 50 and 90 % of a fit, for parameters that have an interval."""
    found = {}
    for name, one in fit.parameters.items():
        if one.q05 is not None and one.q50 is not None and one.q95 is not None:
            half = [one.q50 + HALF_50_OVER_90 * (end - one.q50) for end in (one.q05, one.q95)]
            found[name] = [one.q50, *half, one.q05, one.q95]
    return found


def least_squares_intervals(fit: aero_bayes.Fit) -> dict[str, list[float]]:
    """Return the same of a fit under white noise with the covariance that ``curve_fit`` gives."""
    slopes = fit.optimum.whitened.slopes
    sds = np.sqrt(np.diag(np.linalg.pinv(slopes @ slopes.T, hermitian=True)))
    found = {}
    for name, sd in zip((fit.calibration.parameters.items[j].name for j in fit.free), sds, strict=True):
        one = fit.parameters.get(name)
        if one is not None and one.value > 0.0:  # all positive, and searched by their logarithm
            halves = np.array([0.0, -HALF_50_OVER_90, HALF_50_OVER_90, -1.0, 1.0]) * HALF_90 * sd
            found[name] = (one.value * np.exp(halves)).tolist()
    return found


def summary(rows: Sequence[Row]) -> Row:
    """Return shares held and relative widths by state, and by state and rig."""
    rows = [dict(zip(("seed", "state", "rig", "number"), row["key"].split("/"), strict=True)) | row for row in rows]
    good = [row for row in rows if "methods" in row]
    bands = [share for row in good for share in row.get("bands", {}).values()]
    by_rig = of_rigs(good)
    means = by_rig.groupby(["state", "method"])[["50", "90", "width_90"]].mean()
    return {
        "states": {
            state: {
                "recordings": len(own), "error_of_model": rate(own, lambda row: row["error_of_model"]),
                **{method: means.loc[state, method].to_dict() for method in METHODS if (state, method) in means.index},
            }
            for state in STATES for own in [[row for row in good if row["state"] == state]]
        },
        "by_rig": by_rig.to_dict("records"),
        "bands_90": float(np.mean(bands)) if bands else None,
        "bands": len(bands),
        "failed": sorted({f"{row['rig']}, {row['state']}: {row['error']}" for row in rows if "error" in row}),
    }  # fmt: skip


def of_rigs(rows: Sequence[Row]) -> pd.DataFrame:
    """Return shares held and relative widths of each state, method and rig, the mean over parameters.

    Recordings with different sizes of what is missing have different errors: widths are compared within each size.
    """
    cell, columns = ["state", "method", "rig"], ["name", "size", "50", "90", "width", "square"]
    entries = [
        (row["state"], method, row["rig"], name, int(row["number"]) % len(SIZES), low_50 < target < high_50,
         low_90 < target < high_90, high_90 - low_90, (estimate - target) ** 2)
        for row in rows
        for method, intervals in row["methods"].items()
        for name, (estimate, low_50, high_50, low_90, high_90) in intervals.items()
        for target in [row["targets"][name]]
    ]  # fmt: skip
    frame = pd.DataFrame(entries, columns=[*cell, *columns])
    groups = frame.groupby([*cell, "name", "size"])[["width", "square"]]
    repeated = groups.mean()[groups.size() > 1]
    widths = (repeated["width"] / (2.0 * HALF_90 * np.sqrt(repeated["square"]))).groupby(cell).mean()
    held = frame.groupby(cell)[["50", "90"]].mean()
    return held.join(widths.rename("width_90"), how="inner").reset_index()


def table(found: Mapping[str, Any]) -> Told:
    """Write a line for each state: what the intervals hold, and how wide they are."""
    lines: list[tuple[object, ...]] = []
    for state, own in found["states"].items():
        ours, plain = own.get("ours"), own.get("curve_fit")
        cells = [percent(ours["50"]), percent(ours["90"]), f"{ours['width_90']:.2f}"] if ours else ["-"] * 3
        lines.append((STATES[state], own["recordings"], *cells, percent(plain["90"]) if plain else "-"))
    bands = f"90 % prediction bands hold {percent(found['bands_90'])} of unseen readings ({found['bands']} outputs)."
    return bands + (f" Failed: {'; '.join(found['failed'])}." if found["failed"] else ""), lines


STUDY = Study(
    "coverage_wrong",
    "Intervals where the model is wrong: they should hold the values that serve best, and true ones after the loop has "
    "mended the model. Width is relative to the narrowest interval that could hold.",
    tasks, attempt, summary, table, HEAD, minutes=14.0,
)  # fmt: skip
