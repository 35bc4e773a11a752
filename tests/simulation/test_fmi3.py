"""FMI 3.0 Model Exchange: the same numbers as FMI 2.0."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from runs import ran
from test_model_load import replaced, rewrite

from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import (
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model

pytestmark = pytest.mark.fast

TIGHT = SolverSettings(1e-8, 1e-8)
Drive = Callable[[np.ndarray], tuple[InputSignal, ...]]
CASES: list[tuple[str, tuple[str, ...], tuple[ProblemTarget, ...], list[float]]] = [
    ("VanDerPol", ("x0", "x1"), (ParameterTarget("mu"), StartTarget("x1")), [2.0, 0.3]),
    ("BouncingBall", ("h", "v"), (ParameterTarget("e"),), [0.6]),
    ("Stair", ("counter", "x"), (ParameterTarget("kick"),), [0.4]),
    ("Circuit", ("i0", "v2", "power"), (ParameterTarget("R"), ParameterTarget("C")), [8.0, 2e-3]),
    ("Feedthrough", ("y",), (ParameterTarget("gain"),), [3.0]),
    ("Stepping", ("x",), (ParameterTarget("b"),), [0.5]),
    ("Copies", ("h", "clipped"), (ParameterTarget("w"), StartTarget("h")), [1.5, 0.4]),
    ("Loop", ("z",), (ParameterTarget("a"),), [0.4]),
]


def problem(model: Model, outputs: tuple[str, ...], targets: tuple[ProblemTarget, ...], drive: Drive) -> Problem:
    time = np.linspace(0.0, 2.0, 57) + 1e-4
    inputs = drive(time) if model.inputs else ()
    return Problem(model, (Experiment(time, outputs, inputs),), (targets,), settings=TIGHT)


@pytest.mark.parametrize(("name", "outputs", "targets", "values"), CASES, ids=[case[0] for case in CASES])
@pytest.mark.parametrize("directional", [True, False])
def test_the_same_numbers_as_fmi_2(test_fmu, here, drive, name, outputs, targets, values, directional):
    found = []
    for defines in ((), ("FMI3",)):
        model = test_fmu(name, directional=directional, defines=defines)
        found.append(ran(problem(model, outputs, targets, drive), here, [values], active=range(len(values))))
        assert model.fmi_version == (3 if defines else 2)
    two, three = found
    assert three.outcomes[0, 0] == Outcome.OK
    np.testing.assert_array_equal(two.outputs[0], three.outputs[0])
    np.testing.assert_array_equal(two.sensitivities[0], three.sensitivities[0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"<ModelVariables>", b'<ModelVariables><Clock name="tick" valueReference="90" causality="input"/>', "clock"),
        (
            b'variability="continuous" initial="exact" start="1.0"/>',
            b'start="1 1"><Dimension start="2"/></Float64>',
            "array",
        ),
        (b'<ContinuousStateDerivative valueReference="1"', b'<ContinuousStateDerivative valueReference="77"', "contra"),
        (b"ModelExchange", b"ScheduledExecution", "neither"),
    ],
)
def test_what_is_refused(test_fmu, tmp_path, old, new, message):
    path = rewrite(test_fmu("Dahlquist", defines=("FMI3",)).path, tmp_path / "bad.fmu", replaced(old, new))
    with pytest.raises(InputError, match=message):
        Model.load(path)
