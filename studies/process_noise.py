"""Process noise held against ctsmTMB, repeated simulation, a real rig, and the cost of a plain run.

    python studies/process_noise.py coverage cost
    python studies/process_noise.py ctsm --ctsm FOLDER   (a clone of github.com/phillipbvetter/ctsmTMB; needs rdata)
    python studies/process_noise.py emps --emps FOLDER   (train.csv and test.csv of the EMPS benchmark)

Each part is written to ``reports/process_noise.json`` under its name; parts that are not run keep what they had.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import aero_bayes
from aero_bayes.data import Layout, Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate import CalibrationSettings, Fit, LogUniform, Override, Uniform
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation import Experiment, InputSignal, Model, Problem, ProcessNoise, SolverSettings, open_simulator
from trial_runs import write_summary

ROOT = Path(__file__).resolve().parents[1]

DRIFT = """model Drift
  parameter Real theta = 5; parameter Real mu = 1; input Real u; output Real x(start = 0, fixed = true);
equation
  der(x) = theta * (mu + u - x);
end Drift;
"""
TWO = """model Two
  parameter Real theta = 5; parameter Real mu = 3; parameter Real alpha = 2;
  input Real u; output Real y1(start = 3, fixed = true); output Real y2(start = 3, fixed = true);
equation
  der(y1) = theta * (mu + u - y1); der(y2) = alpha * (y1 - y2);
end Two;
"""
CARRIAGE = """model Carriage
  parameter Real M(unit = "kg") = 100; parameter Real F_v(unit = "N.s/m") = 150; parameter Real F_c(unit = "N") = 20;
  parameter Real o(unit = "N") = 0; input Real u(unit = "N"); output Real q(unit = "m");
  Real s(unit = "m", start = 0, fixed = true); Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(s) = v; M * der(v) = u - F_v * v - F_c * tanh(v / 1e-3) + o; q = s;
end Carriage;
"""
#: Parameters of ctsmTMB's two-state example by their names there.
THERE = {
    "theta": "logtheta", "alpha": "logalpha", "process.y1": "logsigma_x1", "process.y2": "logsigma_x2",
    "noise.y2.sd_white": "logsigma_y2", "mu": "mu",
}  # fmt: skip


@cache
def built(source: str) -> Model:
    """The FMU of a Modelica text."""
    name = source.split()[1]
    path = Path(tempfile.mkdtemp()) / f"{name}.mo"
    path.write_text(source, encoding="utf-8")
    return aero_bayes.load_model(path)


def fitted(model: Model, recording: Recording, noise: NoiseModel, parameters: Any, **calibration: Any) -> Fit:
    settings = aero_bayes.FitSettings(
        method="local", noise=noise, calibration=CalibrationSettings(start="reading", **calibration)
    )
    return aero_bayes.fit(recording, model, parameters=parameters, settings=settings, workers=0)


def drawn(seed: int, truth: tuple[float, float, float, float], count: int, interval: float) -> Recording:
    """An Ornstein-Uhlenbeck process, from the exact distribution of one sample given the one before."""
    theta, mu, sigma, sd = truth
    rng, t = np.random.default_rng([11, seed]), np.arange(count) * interval
    u, x, factor = np.floor(t) % 2, np.zeros(count), math.exp(-theta * interval)
    width = sigma * math.sqrt((1.0 - factor**2) / (2.0 * theta))
    for k in range(1, count):
        x[k] = factor * x[k - 1] + (1.0 - factor) * (mu + u[k - 1]) + width * rng.standard_normal()
    return Recording("run", t, {"u": u}, {"x": x + sd * rng.standard_normal(count)})


def held(seed: int, truth: tuple[float, float, float, float]) -> dict[str, bool]:
    """Which 90 % intervals of one recording hold the truth."""
    noise = NoiseModel(process={"x": "estimated"})
    bounds = {"theta": (0.1, 100.0), "mu": (0.01, 50.0)}
    fit = fitted(built(DRIFT), drawn(seed, truth, 400, 0.02), noise, bounds, resting=())
    names = ("theta", "mu", "process.x", "noise.x.sd_white")
    return {n: bool(fit[n].q05 <= value <= fit[n].q95) for n, value in zip(names, truth, strict=True)}


def coverage(count: int) -> dict[str, Any]:
    """Share of 90 % intervals that hold the truth."""
    truth = (10.0, 1.0, 1.0, 0.1)
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(partial(held, truth=truth), range(count)))
    return {"recordings": count, "90": {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}}


def seconds(problem: Problem) -> float:
    """Computing time of one likelihood, the least of five."""
    with open_simulator(problem, workers=0) as simulator:
        simulator.log_likelihood(np.empty((1, 0)), np.array([1.0, 0.0, 0.0]))
        spent = []
        for _ in range(5):
            began = time.process_time()
            simulator.log_likelihood(np.empty((5, 0)), np.array([1.0, 0.0, 0.0]))
            spent.append((time.process_time() - began) / 5.0)
    return min(spent)


def cost() -> dict[str, Any]:
    """Likelihoods with process noise over plain ones, where the input changes at every reading and at every 20th."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 20.0, 0.01)
    readings, u, found = rng.normal(3.0, 1.0, (t.size, 2)), np.cumsum(rng.normal(0.0, 0.1, t.size)), {}
    process = ProcessNoise({"y1": 1.0, "y2": 0.5}, {"y1": 1.0, "y2": 1.0})
    for every in (1, 20):
        signal = InputSignal("u", t[::every], u[::every])
        experiment = Experiment(t, ("y1", "y2"), (signal,), measured=readings)
        plain = Problem(built(TWO), (experiment,), ((),), settings=SolverSettings(time_limit=100.0))
        found[f"input every {every}"] = seconds(replace(plain, process=process)) / seconds(plain)
    return found


def ctsm(folder: Path) -> dict[str, Any]:
    """Estimates from the two-state example over those that ctsmTMB keeps of its exact (linear) filter."""
    import rdata

    def read(name: str) -> Any:
        return rdata.conversion.convert(rdata.parser.parse_file(folder / "data" / f"{name}.rda"))[name]

    data = read("Ornstein2D")[:50]
    reference = read("EstimateReferenceData")["lkf"]["par.fixed"]
    there = dict(zip(reference.coords["dim_0"].values.tolist(), reference.values.tolist(), strict=True))
    t, u, y1, y2 = (data[name].to_numpy(dtype=float) for name in ("t", "u", "y1", "y2"))
    noise = NoiseModel(process={"y1": "estimated", "y2": "estimated"}, initial_sd={"y1": 0.1**0.5, "y2": 0.1**0.5})
    parameters = {
        "theta": Override(5.0, 1e-5, 50.0, LogUniform(1e-5, 50.0)),
        "mu": Override(3.0, -10.0, 10.0, Uniform(-10.0, 10.0), "linear"),
        "alpha": Override(2.0, 1e-5, 50.0, LogUniform(1e-5, 50.0)),
    }
    fit = fitted(built(TWO), Recording("run", t, {"u": u}, {"y1": y1, "y2": y2}), noise, parameters)
    return {
        name: fit.value(name) / (there[known] if name == "mu" else math.exp(there[known]))
        for name, known in THERE.items()
    }


def emps(folder: Path) -> dict[str, Any]:
    """A carriage with dry friction, with and without process noise of its velocity."""
    layout, bounds = (
        Layout.of(["u"], ["q"]),
        {"M": (20.0, 500.0), "F_v": (20.0, 2e3), "F_c": (0.5, 200.0), "o": (-30.0, 30.0)},
    )
    train, test = (aero_bayes.read_recording(folder / f"{name}.csv", layout=layout) for name in ("train", "test"))
    found = {}
    for kind, noise in (("white", NoiseModel("white")), ("process", NoiseModel(process={"v": "estimated"}))):
        fit = fitted(built(CARRIAGE), train, noise, bounds)
        e = fit.optimum.whitened.residual
        errors = {r.name: fit.simulate(r).outputs["q"] - r.outputs["q"] for r in (train, test)}
        found[kind] = {
            "values": fit.named, "lag_one": float(np.corrcoef(e[1:], e[:-1])[0, 1]), "rms_fitted": fit.rms["q"],
            "rms_simulated": {name: float(np.sqrt(np.mean(error**2))) for name, error in errors.items()},
        }  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="+", choices=("coverage", "cost", "ctsm", "emps"))
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--ctsm", type=Path)
    parser.add_argument("--emps", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "reports")
    options = parser.parse_args()
    path = options.out / "process_noise.json"
    summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    needs: Mapping[str, Callable[[], dict[str, Any]]] = {
        "coverage": lambda: coverage(options.recordings),
        "cost": cost,
        "ctsm": lambda: ctsm(given(options.ctsm, "--ctsm")),
        "emps": lambda: emps(given(options.emps, "--emps")),
    }
    for part in options.parts:
        summary[part] = needs[part]()
        write_summary(summary, path)
        print(part, json.dumps(summary[part]))


def given(folder: Path | None, option: str) -> Path:
    if folder is None or not folder.is_dir():
        raise InputError(f"{option}: give the folder of the data, got {folder}")
    return folder


if __name__ == "__main__":
    main()
