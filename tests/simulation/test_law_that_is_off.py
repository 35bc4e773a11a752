"""An FMU with a law around it that is switched off gives the same results as without it, whatever tool it is from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from runs import ran

from aero_bayes.laws.attach import LawBlocks, attached
from aero_bayes.laws.candidates import Candidate, place_law
from aero_bayes.laws.coupled_fmu import couple
from aero_bayes.laws.law import Law, shipped_laws
from aero_bayes.laws.law_models import LawModels, law_models
from aero_bayes.loop.fmu_family import FmuPlaces
from aero_bayes.simulation.interface import Experiment, Outcome, ParameterTarget, Problem, SolverSettings, StartTarget
from aero_bayes.simulation.model import Model

pytestmark = pytest.mark.fast

TIME = np.linspace(0.0, 2.0, 81)
#: Model, what it does as other tools' do, output, targets with their values.
CASES = [
    ("Dahlquist", True, (), "y", {"k": 1.3, "c": 0.5, "x": 0.8}),
    ("Dahlquist", True, ("FMI3",), "y", {"k": 1.3, "c": 0.5, "x": 0.8}),
    ("Dahlquist", False, (), "y", {"k": 1.3}),
    ("BouncingBall", True, ("SILENT",), "h", {"e": 0.6}),
    ("Loop", True, (), "z", {"c": 0.3}),
    ("Copies", True, ("FIXED",), "driven", {"w": 2.0, "_D_outputAlias_h": 0.4}),
    ("Stair", True, (), "counter", {}),
    ("Stepping", True, (), "x", {"b": 0.7}),
    ("Feedthrough", True, (), "resource", {}),
]


@pytest.fixture(scope="module")
def gain() -> tuple[Law, LawModels]:
    law = next(law for law in shipped_laws() if (law.kind, law.id) == ("output", "gain"))
    return law, law_models([law])


@pytest.mark.parametrize(("name", "directional", "defines", "output", "values"), CASES)
def test_a_law_that_is_off_changes_nothing(
    test_fmu, here, drive, gain, tmp_path: Path, name, directional, defines, output, values
) -> None:
    inner = test_fmu(name, directional=directional, defines=defines)
    places, (law, models) = FmuPlaces(name, fmu=inner.path), gain
    port = max((p for p in places.ports if p.kind == "reading"), key=lambda p: p.id == output)
    taken = {*places.names.values(), *(v.name for v in inner.parameters)}
    coupling = attached(places.opened(), [place_law(Candidate(law, port), taken)], LawBlocks(models, tmp_path))
    couple(coupling, tmp_path / "coupled.fmu")
    inputs = drive(TIME) if any(v.name == "u" for v in inner.inputs) else ()
    states = {s.name for s in inner.states}
    found = []
    for model in (inner, Model.load(tmp_path / "coupled.fmu")):
        there = {s.name for s in model.states}
        targets = tuple(
            ParameterTarget(n) if n not in states else StartTarget(n if n in there else f"{n}_unread") for n in values
        )
        experiment = Experiment(TIME, (output,), inputs)
        problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-9, 1e-9))
        found.append(ran(problem, here, [list(values.values())], active=range(len(values))))
        assert found[-1].outcomes[0, 0] == Outcome.OK
    np.testing.assert_allclose(found[1].outputs[0], found[0].outputs[0], atol=1e-8)
    np.testing.assert_allclose(found[1].sensitivities[0], found[0].sensitivities[0], atol=1e-4)
