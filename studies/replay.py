"""Replay Table 1 and Fig. 6 of the paper (Podlaski et al.) on a simulated recording, since its own is not public.

The paper's models are run with its values and with those that its recipe finds here. RaPId's swarm has no transform of
the axes, its particles stop at the bounds, and its command template asks for few of them; the number of iterations is
ours. Its template hands ``fmincon`` a ``FinDiffRelStep`` of 0.1, which MATLAB takes relative to ``max(|x|, 1)``: a step
of 0.1 in the parameter's own unit (but for R_a), four orders above the inertias. The paper does not say which of
``fmincon``'s algorithms ran; here SciPy's L-BFGS-B does. Beside them stands the fit of this package.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import Bounds, minimize

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, to_experiment
from aero_bayes.estimate.fit import declared_overrides, fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import ParameterSpec, parameters_from_model
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.swarm import SwarmSettings, minimise
from aero_bayes.figures import Picture
from aero_bayes.files import one_run_at_a_time
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.report.drawing import Line, Panel
from aero_bayes.report.plots import panels_picture
from aero_bayes.report.svg import MEASURED, SERIES
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool
from simulated_rigs.aero import default_truth, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.sensors import white
from study.study import markdown

#: Columns of Table 1, and the only parameters that the paper searches.
NAMES = ("R_a", "L_a", "J_r", "J_s", "k_d", "k_t")
#: The paper fits the electrical parameters on current, the mechanical ones on speed, the aerodynamic ones on pitch.
STAGES = ((("R_a", "L_a"), "i_m"), (("J_r", "J_s"), "omega_m"), (("k_d", "k_t"), "theta"))
#: What Quanser documents for the voltage-to-pitch model (torque about the pitch axis for each volt), N.m/V.
TRANSFER_GAIN = 0.0011
#: Upper corner of the box that is searched; the lower one is zero. The paper does not print its own; this one reaches,
#: on every axis, to the next power of ten above everything that Table 1 holds.
BOX = dict(zip(NAMES, (10.0, 0.1, 100.0, 100.0, 1.0, 1e-3), strict=True))
PARTICLES, ITERATIONS = 8, 30
RELATIVE_STEP, TYPICAL, MAX_ITERATIONS = 0.1, 1.0, 60
#: How far thrust and drag of the linear law may be from the data sheet, as a factor; bounds are its square.
SPREAD = 10.0
PAPER, RERUN, JOINT = "paper's values", "recipe rerun", "joint fit"
NOTES = (
    "The recording here is simulated; the paper's is not public. Eq. 6 sums squares over samples, so only the order of "
    "the models can be compared.",
    "Table 1 gives `k_t` and `k_d` in the units of a linear law, so they are used with it; Eqs. 4 and 5 are quadratic.",
)


@dataclass(frozen=True)
class Published:
    """One row of Table 1: values as ``Aero.Systems.OneDofLinear`` takes them, and Eq. 6 of data that is not public.

    The paper's ``k_d`` is negative; the model's drag opposes the rotation by itself.
    """

    values: Mapping[str, float]
    fitness: float


def _published(fitness: float, *values: float) -> Published:
    return Published(dict(zip(NAMES, values, strict=True)), fitness)


TABLE_1 = {
    "Unoptimised": _published(29.3903, 8.4, 0.00116, 4e-6, 4e-6, 1e-5, 0.00045),
    "PSO Model 1": _published(498.7173, 0.187, 0.0487, 84.2, 0.0, 0.587, 0.000689),
    "PSO + data sheet": _published(28.2230, 8.4, 0.00116, 84.2, 0.0, 0.587, 0.000689),
    "fmincon": _published(0.2280, 8.4, 0.00116, 3.45e-11, 0.000174, 1e-5, 0.0004),
    "Transfer function": Published({"R_a": 8.4, "k_d": 1e-5, "k_t": 0.00045}, 42.7060),
}
SHEET = TABLE_1["Unoptimised"].values
#: Eq. 6 of a batch of points, shape (n, p): shape (n,), infinite where a run failed.
Cost = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Row:
    """A model on the paper's experiment: its values, pitch (n,), and Eq. 6 of the pitch, None where it failed."""

    model: str
    variant: str
    values: Mapping[str, float]
    pitch: FloatArray
    fitness: float | None
    paper_fitness: float | None = None


def paper_recording(seed: int = 0) -> Recording:
    """Simulate the paper's experiment, whose recording is not public: 24 V for 20 s, 0 V for 20 s, 2,001 samples."""
    rng = np.random.default_rng([seed, 2])
    return simulate_recording(
        default_truth(), paper_step(), white(), rng, duration=40.0, rate_hz=50.0, name="paper_step"
    )


class Evaluator:
    """One model on a recording, with a column for each of ``names``."""

    def __init__(self, recording: Recording, model: Model, names: Sequence[str], pool: WorkerPool) -> None:
        self.outputs = tuple(name for name in recording.outputs if name in {item.name for item in model.outputs})
        experiment = to_experiment(recording, self.outputs, zero_at_rest=("omega_m", "i_m"))
        targets, settings = tuple(map(ParameterTarget, names)), SolverSettings(time_limit=5.0)
        self.measured = recording.measured(self.outputs)
        self.simulator = open_simulator(Problem(model, (experiment,), (targets,), settings=settings), pool=pool)

    def simulate(self, points: FloatArray) -> FloatArray:
        """Simulate a batch (n, p): outputs of shape (n, samples, m), NaN where a run failed."""
        found = self.simulator.simulate(np.atleast_2d(points))
        outputs = found.outputs[0].copy()
        outputs[found.outcomes[:, 0] != Outcome.OK] = np.nan
        return outputs

    def cost(self, points: FloatArray, output: str) -> FloatArray:
        """Compute Eq. 6 of one output for a batch (n, p): shape (n,), infinite where a run failed."""
        k = self.outputs.index(output)
        total = np.sum((self.measured[:, k] - self.simulate(points)[:, :, k]) ** 2, axis=1)
        return np.where(np.isfinite(total), total, np.inf)


def swarm(cost: Cost, start: FloatArray, top: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Search from zero to ``top`` with RaPId's particle swarm; where nothing runs, the start is kept."""
    settings = SwarmSettings(particles=PARTICLES, iterations=ITERATIONS, patience=ITERATIONS, reflect=False)
    found = minimise(cost, np.zeros(top.size), top, rng, settings)
    return found.best if np.isfinite(found.cost) else start


def coarse_search(cost: Cost, start: FloatArray, top: FloatArray) -> FloatArray:
    """Search from zero to ``top`` by the paper's constrained search. A failed run counts as a very large cost."""
    options = {"eps": RELATIVE_STEP * np.maximum(np.abs(start), TYPICAL), "maxiter": MAX_ITERATIONS}
    bounds = Bounds(np.zeros(top.size), top)
    best = minimize(
        lambda x: min(float(cost(x[None])[0]), 1e30), start, method="L-BFGS-B", bounds=bounds, options=options
    )
    return np.asarray(best.x)


def in_stages(evaluator: Evaluator, search: Callable[[Cost, FloatArray, FloatArray], FloatArray]) -> dict[str, float]:
    """Search stage by stage from the data sheet, each with what the one before found and all other values held."""
    values = np.array(list(SHEET.values()))
    for names, output in STAGES:
        columns = [NAMES.index(name) for name in names]

        def cost(points: FloatArray, columns: list[int] = columns, output: str = output) -> FloatArray:
            batch = np.tile(values, (len(points), 1))
            batch[:, columns] = points
            return evaluator.cost(batch, output)

        found = search(cost, values[columns], np.array([BOX[name] for name in names]))
        values[columns] = found
    return dict(zip(NAMES, values.tolist(), strict=True))


def fit_jointly(recording: Recording, model: Model, *, linear_law: bool, seed: int, workers: int | None) -> Fit:
    """Fit all outputs at once under white noise: the table compares sums of squares."""
    overrides = declared_overrides(model)
    for name in ("k_d", "k_t") if linear_law else ():
        centre = SHEET[name]
        prior = LogNormal.factor(centre, SPREAD)
        overrides[name] = ParameterSpec(centre, centre / SPREAD**2, centre * SPREAD**2, prior, "log")
    parameters = parameters_from_model(model, overrides=overrides)
    settings = FitSettings(noise=NoiseModel("white"))
    return fit([recording], model, parameters=parameters, settings=settings, seed=seed, workers=workers)


def replay_paper(recording: Recording, *, seed: int, workers: int | None, out: Path) -> list[Row]:
    """Run the five models of Table 1 in their variants, and the joint fits; the FMUs are built into ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    models = {
        name: Model.load(export_fmu(f"Aero.Systems.{name}", out / f"{name}.fmu"))
        for name in ("OneDofLinear", "OneDof", "TransferFunction")
    }
    streams = iter(np.random.default_rng([seed, 3]).spawn(1)[0].spawn(len(STAGES)))
    with WorkerPool(workers) as pool:
        linear = Evaluator(recording, models["OneDofLinear"], NAMES, pool)
        transfer = Evaluator(recording, models["TransferFunction"], ("K_pp",), pool)
        with linear.simulator, transfer.simulator:
            rerun = {
                "PSO Model 1": in_stages(linear, lambda cost, start, top: swarm(cost, start, top, next(streams))),
                "fmincon": in_stages(linear, coarse_search),
            }
            rerun["PSO + data sheet"] = rerun["PSO Model 1"] | {name: SHEET[name] for name in ("R_a", "L_a")}
            rows = []
            for label, published in TABLE_1.items():
                motor = label != "Transfer function"
                point = np.array(list(published.values.values())) if motor else np.array([TRANSFER_GAIN])
                rows.append(
                    _row(label, PAPER, published.values, linear if motor else transfer, point, published.fitness)
                )
            for label, values in rerun.items():
                rows.append(_row(label, RERUN, values, linear, np.array(list(values.values()))))
    for label, name in (("Linear law", "OneDofLinear"), ("Quadratic law", "OneDof")):
        linear_law = name == "OneDofLinear"
        found = fit_jointly(recording, models[name], linear_law=linear_law, seed=seed, workers=workers)
        theta = found.outputs.index("theta")
        known = {n: one.value for n, one in found.parameters.items() if n in NAMES}
        rows.append(
            Row(label, JOINT, known, found.fitted[0][:, theta], float(np.sum(found.residuals[0][:, theta] ** 2)))
        )
    return rows


def _row(
    label: str, variant: str, values: Mapping[str, float], evaluator: Evaluator, point: FloatArray,
    paper_fitness: float | None = None,
) -> Row:  # fmt: skip
    theta = evaluator.outputs.index("theta")
    pitch = evaluator.simulate(point)[0][:, theta]
    fitness = float(np.sum((evaluator.measured[:, theta] - pitch) ** 2))
    return Row(label, variant, values, pitch, fitness if np.isfinite(fitness) else None, paper_fitness)


def table_lines(rows: Sequence[Row]) -> list[str]:
    """Write Table 1 of the paper, replayed: SI units, fitness by Eq. 6 (smaller is better)."""
    lines = [
        (f"{row.model}: {row.variant}", *(number(row.values.get(name), 3) for name in NAMES), number(row.fitness, 4),
         number(row.paper_fitness, 6))
        for row in rows
    ]  # fmt: skip
    return markdown(["model", *NAMES, "fitness, here", "fitness, paper"], lines)


def number(value: float | None, digits: int) -> str:
    """Write a number of the table; a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}g}"


def figure_6(recording: Recording, rows: Sequence[Row]) -> Picture:
    """Draw the pitch as measured and as given by each model; one that leaves the frame is cut off by it."""
    measured = recording.outputs["theta"]
    shown = {row.model: row.pitch for row in rows if row.variant == PAPER} | {"Joint fit": rows[-1].pitch}
    curves = [Line(recording.time, measured, MEASURED, 3.0)]
    curves += [Line(recording.time, pitch, colour) for colour, pitch in zip(SERIES, shown.values(), strict=False)]
    low, span = float(np.nanmin(measured)), float(np.ptp(measured))
    panel = Panel("theta: pitch (rad)", tuple(curves), 300, y_limits=(low - 1.2 * span, low + 2.2 * span))
    labels = [(MEASURED, "measured"), *zip(SERIES, shown, strict=False)]
    return panels_picture([panel], labels, "", dark=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("reports/replay"))
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same numbers")
    parser.add_argument("--workers", type=int, help="simulation processes; by default one a core")
    options = parser.parse_args()
    with one_run_at_a_time(options.out):
        recording = paper_recording(options.seed)
        rows = replay_paper(recording, seed=options.seed, workers=options.workers, out=options.out)
        figure_6(recording, rows).save(options.out / "figure_6.svg")
        table = options.out / "replay.md"
        table.write_text("\n".join([*table_lines(rows), "", *NOTES]) + "\n", "utf-8")
    print(f"wrote {table}")


if __name__ == "__main__":
    main()
