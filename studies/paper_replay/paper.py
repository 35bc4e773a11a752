"""The replay itself: record, export, run the five models of Table 1 in their variants, and write what happened."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.estimate.fit import declared_overrides, fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import Override, parameters_from_model
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.estimate.result import Fit
from aero_bayes.report.drawing import Line, Panel
from aero_bayes.report.plots import draw_panels
from aero_bayes.report.results import versions, write_result, write_series
from aero_bayes.report.schema_run import SCHEMA
from aero_bayes.report.svg import MEASURED, SERIES
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool
from paper_replay.models import ModelEvaluator, export_models, open_models, paper_recording
from paper_replay.published import FMINCON, PSO, PSO_DATASHEET, TABLE_PARAMETERS, TRANSFER, UNOPTIMISED
from paper_replay.search import StageEnd, coarse_stage, in_stages, scaled_stage, swarm_recipe
from study.study import markdown

PAPER, RERUN, SCALED, JOINT = "paper's values", "recipe rerun", "scaled axes", "joint fit"
#: How far thrust and drag of the linear law may be from the data sheet, as a factor; bounds are its square.
SPREAD = 10.0
#: Key of the numbers in ``result.json``, and prefix of the curves in ``series.npz``.
NAME = "replay"
NOTES = (
    "The recording here is simulated; the paper's is not public. Eq. 6 sums squares over samples, so only the order of "
    "the models can be compared.",
    "Table 1 gives `k_t` and `k_d` in the units of a linear law, so they are used with it; Eqs. 4 and 5 are quadratic.",
)


@dataclass(frozen=True)
class ReplayRow:
    """A model on the paper's experiment; ``fitness`` is Eq. 6 of the pitch, None where it failed."""

    model: str
    variant: str
    parameters: Mapping[str, float]
    fitness: float | None
    note: str
    rms: Mapping[str, float]
    paper_fitness: float | None = None

    @property
    def label(self) -> str:
        """Model and variant."""
        return f"{self.model}: {self.variant}"


@dataclass(frozen=True, eq=False)
class Replay:
    """The rows, Fig. 6's curves by their key in ``series.npz``, where each stage ended, and how simulations ended."""

    rows: tuple[ReplayRow, ...]
    series: Mapping[str, FloatArray]
    ends: Mapping[str, tuple[StageEnd, ...]]
    failures: Mapping[str, int]
    seed: int
    seconds: float

    def row(self, model: str, variant: str) -> ReplayRow:
        """Return a row by name."""
        return next(row for row in self.rows if (row.model, row.variant) == (model, variant))


def replay_paper(*, seed: int = 1, workers: int | None = None, out: Path) -> Replay:
    """Replay the paper's Table 1 and Fig. 6 on the simulated bench; the FMUs are built into ``out``."""
    began = time.perf_counter()
    recording, streams = paper_recording(seed), np.random.default_rng([seed, 3]).spawn(2)
    models = export_models(out)
    with WorkerPool(workers) as pool:
        linear, transfer = open_models(recording, models, lambda problem: open_simulator(problem, pool=pool))
        with linear.simulator, transfer.simulator:
            ends = {
                "swarm": swarm_recipe(linear, "linear", streams[0]),
                "swarm, scaled": swarm_recipe(linear, "log", streams[1]),
                "search": in_stages(coarse_stage, linear),
                "search, scaled": in_stages(scaled_stage, linear),
            }
            rows, curves = table_1(linear, transfer, {name: one[-1].values for name, one in ends.items()})
    outcomes = linear.outcomes + transfer.outcomes
    laws = (("Linear law", models["OneDofLinear"], True), ("Quadratic law", models["OneDof"], False))
    for label, model, linear_law in laws:
        found = fit_jointly(recording, model, linear_law=linear_law, seed=seed, workers=workers)
        known = {n: one.value for n, one in found.parameters.items()}
        errors = dict(zip(found.outputs, found.residuals[0].T, strict=True))
        rows.append(row_of(label, JOINT, known, "all outputs at once", errors))
        curves["Joint fit"] = found.fitted[0][:, found.outputs.index("theta")]
        outcomes += Counter(found.outcomes)
    curves |= {"time": recording.time, "measured": recording.outputs["theta"]}
    failures = {outcome.key: outcomes[outcome] for outcome in Outcome}
    series = {f"{NAME}/{label}": values for label, values in curves.items()}
    return Replay(tuple(rows), series, ends, failures, seed, time.perf_counter() - began)


def table_1(
    linear: ModelEvaluator, transfer: ModelEvaluator, found: Mapping[str, Mapping[str, float]]
) -> tuple[list[ReplayRow], dict[str, FloatArray]]:
    """Build the rows of the paper's five models, and the pitch of those that Fig. 6 shows."""
    sheet = {name: UNOPTIMISED.parameters[name] for name in ("R_a", "L_a")}
    entries = [(one, PAPER, linear, one.model_values, "") for one in (UNOPTIMISED, PSO, PSO_DATASHEET, FMINCON)]
    entries += [
        (TRANSFER, PAPER, transfer, transfer.start, "0.0011 N·m/V, no motor in it"),
        (PSO, RERUN, linear, dict(found["swarm"]), "8 particles, linear axes"),
        (PSO, SCALED, linear, dict(found["swarm, scaled"]), "8 particles, log axes"),
        (PSO_DATASHEET, RERUN, linear, {**found["swarm"], **sheet}, "R_a and L_a put back"),
        (PSO_DATASHEET, SCALED, linear, {**found["swarm, scaled"], **sheet}, "R_a and L_a put back"),
        (FMINCON, RERUN, linear, dict(found["search"]), "steps of 0.1, line search"),
        (FMINCON, SCALED, linear, dict(found["search, scaled"]), "fine steps, log axes"),
    ]
    rows, pitch = [], {}
    for published, variant, evaluator, values, note in entries:
        outputs = evaluator.simulate(evaluator.vector(values))[0]
        row = row_of(
            published.label,
            variant,
            values,
            note,
            dict(zip(evaluator.outputs, (evaluator.measured - outputs).T, strict=True)),
        )
        if variant == PAPER:
            row = replace(row, paper_fitness=published.fitness)
            pitch[published.label] = outputs[:, evaluator.outputs.index("theta")]
        rows.append(row)
    return rows, pitch


def row_of(
    label: str, variant: str, values: Mapping[str, float], note: str, errors: Mapping[str, FloatArray]
) -> ReplayRow:
    """Make a row from the errors of each output; a simulation that failed has no fitness and says so."""
    shown = {name: float(values[name]) for name in TABLE_PARAMETERS if name in values}
    if any(np.isnan(error).all() for error in errors.values()):
        return ReplayRow(label, variant, shown, None, f"the simulation failed; {note}", {})
    rms = {name: float(np.sqrt(np.nanmean(error**2))) for name, error in errors.items()}
    return ReplayRow(label, variant, shown, float(np.nansum(errors["theta"] ** 2)), note, rms)


def fit_jointly(recording: Recording, model: Model, *, linear_law: bool, seed: int, workers: int | None) -> Fit:
    """Fit all outputs at once under white noise: the table compares sums of squares."""
    overrides = declared_overrides(model)
    for name in ("k_d", "k_t") if linear_law else ():
        centre = UNOPTIMISED.model_values[name]
        prior = LogNormal.factor(centre, SPREAD)
        overrides[name] = Override(centre, centre / SPREAD**2, centre * SPREAD**2, prior, "log")
    parameters = parameters_from_model(model, overrides=overrides)
    settings = FitSettings(noise=NoiseModel("white"))
    return fit([recording], model, parameters=parameters, settings=settings, seed=seed, workers=workers)


def write_run(replay: Replay, folder: Path) -> Path:
    """Write ``result.json``, ``series.npz``, the figure and the table into a folder; return the table's path."""
    write_series(folder, replay.series)
    write_result(folder, run_result(replay))
    figure_6(replay).savefig(folder / "figure_6.svg")
    table = folder / "replay.md"
    table.write_text("\n".join([*table_lines(replay), "", *NOTES]) + "\n", "utf-8")
    return table


def table_lines(replay: Replay) -> list[str]:
    """Write Table 1 of the paper, replayed: SI units, fitness by Eq. 6 (smaller is better)."""
    head = ["model", *TABLE_PARAMETERS, "fitness, here", "fitness, paper", "note"]
    rows = [
        [row.label, *(number(row.parameters.get(n), 3) for n in TABLE_PARAMETERS), number(row.fitness, 4),
         number(row.paper_fitness, 6), row.note]
        for row in replay.rows
    ]  # fmt: skip
    return markdown(head, rows)


def number(value: float | None, digits: int) -> str:
    """Write a number of the table; a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}g}"


def figure_6(replay: Replay) -> Figure:
    """Draw the pitch as measured and as given by each model; one that leaves the frame is cut off by it."""
    curves = {key.removeprefix(f"{NAME}/"): values for key, values in replay.series.items()}
    time, measured = curves.pop("time"), curves.pop("measured")
    lines = [Line(time, measured, MEASURED, 3.0, label="measured")]
    lines += [Line(time, y, SERIES[k % len(SERIES)], label=name) for k, (name, y) in enumerate(curves.items())]
    low, span = float(np.nanmin(measured)), float(np.ptp(measured))
    panel = Panel("theta: pitch (rad)", tuple(lines), 270, y_limits=(low - 1.2 * span, low + 2.2 * span))
    return draw_panels([panel], "time (s)", [(line.colour, line.label) for line in lines])


def run_result(replay: Replay) -> dict[str, Any]:
    """Return the content of ``result.json``; ``replay`` holds the rows with all errors."""
    return {
        "schema": SCHEMA, "command": NAME, "seed": replay.seed, "versions": versions(), "data": [], "simulated": True,
        NAME: {"rows": [asdict(row) | {"model": row.label} for row in replay.rows]},
        "failures": dict(replay.failures),
        "seconds": replay.seconds,
    }  # fmt: skip
