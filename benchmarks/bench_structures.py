"""A law at a port of a real rig: one run and one gradient of the model with it, in ms, and the run's error.

The base is at its fit, the law at its first start value. Errors are the largest of an output over its range, against a
run at a relative tolerance of 1e-9. ``python benchmarks/bench_structures.py silverbox`` prints the rows of one rig.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import Row

from aero_bayes.arrays import FloatArray
from aero_bayes.commands.commands import fit_job
from aero_bayes.commands.job import RunOptions, open_job
from aero_bayes.estimate.fit import Fit
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Outcome, Problem, SolverSettings
from study.real import cases

#: Laws by the rig whose first model they are attached to; the empty name is the model itself.
STRUCTURES: Mapping[str, Sequence[str]] = {
    "silverbox": (
        "",
        "cubic_stiffness@v",
        "dead_zone@u",
        "rate_limit@u",
        "hysteresis@u",
        "coulomb_friction@v",
        "saturation@y",
    ),
    "servo": ("", "hysteresis@command", "rate_limit@command", "delay@angle"),
}
#: Time in s that the calls of one row may take together, beside the first.
PATIENCE = 4.0


def fitted(rig: str, folder: Path) -> tuple[Fit, ModelicaFamily] | None:
    """Fit the first model of a rig and place all laws at it; None where its recordings are not on this machine."""
    case = cases()[rig]
    files = case.find()
    if not files:
        return None
    paths = [files[name] for name in case.train]
    job = open_job(paths, RunOptions(folder / "out", config=case.folder / "rig.toml", workers=0))
    found = fit_job(job, lambda *_: None, again=True)
    family = ModelicaFamily(LawPlaces(job.name, job.config.model.sources), folder / "built")
    family.prepare(found.calibration, found.optimum, lambda problem: open_simulator(problem, workers=0))
    return found, family


def structure(base: Fit, family: ModelicaFamily, law: str) -> tuple[Problem, FloatArray]:
    """Pose the base with a law, all parameters free, and the point at which it is measured."""
    calibration = base.calibration
    fit = calibration.parameters.from_search(base.optimum.coordinates)
    values = dict(zip(calibration.parameters.names, fit, strict=True))
    if law:
        built = family.with_candidates([law])
        own = built.terms[0][1]
        values |= dict(zip((p.name for p in own), family.starts(law)[0], strict=False))
        calibration = family.transfer(calibration, built.model)
        calibration = replace(calibration, parameters=ParameterSet((*calibration.parameters, *own)))
    point = [values.get(p.name, p.start) for p in calibration.parameters]
    return calibration.problem(), np.array([point], dtype=float)


def seconds(call: Callable[[], Any]) -> float:
    """Return the shortest time of a call, after one to warm up."""
    call()
    found: list[float] = []
    while len(found) < 3 or (sum(found) < PATIENCE and len(found) < 50):
        began = time.perf_counter()
        call()
        found.append(time.perf_counter() - began)
    return min(found)


def timed(key: str, problem: Problem, point: FloatArray) -> Row:
    """Time one run and one with all sensitivities; the ratio is that of the two."""
    tight = replace(problem, settings=SolverSettings(1e-9, 1e-9, 20_000_000, 600.0))
    every = range(point.shape[1])
    with open_simulator(problem, workers=0) as simulator, open_simulator(tight, workers=0) as exact:
        # two different points, so that the engine knows how the FMU is put back to its start
        found, reference = ((one.simulate(point * 1.0001), one.simulate(point))[1] for one in (simulator, exact))
        if (found.outcomes != Outcome.OK).any() or (reference.outcomes != Outcome.OK).any():
            return Row(key, key, note=f"outcomes {found.outcomes.tolist()}, exact {reference.outcomes.tolist()}")
        error = max(
            float(np.max(np.abs(a - b) / np.ptp(b, axis=1, keepdims=True)))
            for a, b in zip(found.outputs, reference.outputs, strict=True)
        )
        plain = seconds(lambda: simulator.simulate(point))
        gradient = seconds(lambda: simulator.simulate(point, active=every))
    note = f"{1e3 * plain:.4g} ms, with {len(every)} sensitivities {1e3 * gradient:.4g} ms, error {error:.1e}"
    return Row(key, "run with sensitivities / without", gradient, plain, gradient / plain, note=note)


def rows(rigs: Sequence[str], laws: Sequence[str] = ()) -> Iterator[Row]:
    """Measure the structures of some rigs, only some laws where they are named."""
    for rig in rigs:
        with tempfile.TemporaryDirectory() as name:
            made = fitted(rig, Path(name))
            for law in STRUCTURES[rig] if made else ():
                if not laws or law in laws:
                    yield timed(f"{rig}.{law or 'first'}", *structure(*made, law))


def measured(rounds: int) -> Iterator[Row]:
    """Time all structures; each row has rounds of its own."""
    return rows(tuple(STRUCTURES))


if __name__ == "__main__":
    for one in rows(sys.argv[1:2] or tuple(STRUCTURES), sys.argv[2:]):
        print(one.line(), flush=True)
