"""The model that the search fits is the model that is written: on the first models of real rigs, law by law."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.laws.candidates import place_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool

RIGS = Path(__file__).parents[2] / "studies" / "real_rigs"
QUICK = ("coil", "tank2006", "cartpendulum")
NAMES = sorted(path.parent.name for path in RIGS.glob("*/Rig.mo"))
TIME = np.linspace(0.0, 2.0, 101)
#: Of these the trajectory hangs on the last bit: a stick or a kink is met at another step.
KINKS = ("friction", "backlash", "hyster", "end_stop", "rate_limit", "play")


@pytest.fixture(scope="module")
def here() -> Iterator[WorkerPool]:
    with WorkerPool(0) as pool:
        yield pool


def outputs(model: Model, given: dict[str, float], pool: WorkerPool) -> np.ndarray:
    inputs = tuple(
        InputSignal(v.name, TIME[::20], (v.start or 0.0) + 1.0 + 0.4 * np.sin(7.0 * TIME[::20] + k))
        for k, v in enumerate(model.inputs)
    )
    experiment = Experiment(TIME, tuple(v.name for v in model.outputs), inputs)
    targets = tuple(map(ParameterTarget, given))
    # as written: rounded
    model = replace(model, relay=None, operators=() if any(o.memory for o in model.operators) else model.operators)
    problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-11, 1e-11, 200_000, 60.0))
    with open_simulator(problem, pool=pool) as simulator:
        found = simulator.simulate(np.array([[*given.values()]]))
    assert found.outcomes[0, 0] == Outcome.OK
    return found.outputs[0][0]


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.long) for n in NAMES]
)  # fmt: skip
def test_the_attached_model_is_the_written_one(name, here, tmp_path):
    found = ModelicaFamily(LawPlaces("Rig", (RIGS / name / "Rig.mo",)), tmp_path / "built")
    candidates = found.places.candidates_for(None)
    for placed in place_laws(candidates, found.places.taken_names(), {}):
        found.placed[placed.id] = placed
    every: dict[str, list[str]] = {}
    for id_, placed in found.placed.items():
        if not placed.law.curve_input and not any(word in id_ for word in KINKS):
            every.setdefault(placed.port.id, []).append(id_)
    # From rig to rig another law at each port, so that all have their turn.
    by_port = {port: laws[(k + NAMES.index(name)) % len(laws)] for k, (port, laws) in enumerate(every.items())}
    # The text adds a force to an output behind a law of its reading, the attached model before it.
    ids = [id_ for port, id_ in by_port.items() if port.removeprefix("output_") == port or port[7:] not in by_port]
    values = {
        placed.names[p.name]: 0.3 * placed.limits(p)["nominal"] if k == 0 else placed.value(p)
        for placed in (found.placed[id_] for id_ in ids)
        for k, p in enumerate(placed.parameters())
    }
    attached = found.with_candidates(ids).model
    written = found.extend(ids, values, tmp_path / "out")
    there = {new: values[old] for pairs in written.names.values() for old, new in pairs if old in values}
    one, other = outputs(attached, values, here), outputs(written.model, there, here)
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())
