"""Laws attached to a model: against closed forms, and against the same laws in the model's own equations."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from export_driver import driven
from fmpy import extract
from fmpy.fmi2 import FMU2Model
from small_rigs import RIGS
from written_laws import written_flat

from aero_bayes.laws.candidates import place_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.embedded import export_embedded, export_flat
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool

TIME = np.linspace(0.0, 4.0, 201)
SIZES = {"u_n": 1.5, "f_n": 2.0, "v_n": 0.5, "x_n": 0.3, "x_w": 0.3, "q_n": 0.8, "h_n": 0.7, "i_n": 2.0, "t_n": 0.4}


@pytest.fixture(scope="module")
def here() -> Iterator[WorkerPool]:
    with WorkerPool(0) as pool:
        yield pool


def family(name: str, folder: Path, *sources: Path) -> ModelicaFamily:
    """All laws at all ports of a model, placed with the same sizes."""
    found = ModelicaFamily(LawPlaces(name, sources), folder / "built")
    sizes = {p.id: SIZES for p in found.places.ports}
    for placed in place_laws(found.places.candidates, found.places.taken_names(), sizes):
        found.placed[placed.id] = placed
    return found


def values_of(found: ModelicaFamily, ids: Sequence[str]) -> dict[str, float]:
    """Of the parameters of laws: the magnitudes at their nominal values, the others at their defaults."""
    given = {}
    for placed in (found.placed[id_] for id_ in ids):
        for k, p in enumerate(placed.parameters()):
            given[placed.names[p.name]] = placed.limits(p)["nominal"] if k == 0 else placed.value(p)
    return given


def run(model: Model, given: dict[str, float], pool: WorkerPool, level: float = 1.0):
    """Outputs, and their sensitivities to the parameters."""
    inputs = tuple(
        InputSignal(
            v.name, TIME, (v.start or 0.0) + level * (np.sign(np.sin(2.0 * TIME + k)) + 0.3 * np.sin(5.0 * TIME))
        )
        for k, v in enumerate(model.inputs)
    )
    experiment = Experiment(TIME, tuple(v.name for v in model.outputs), inputs)
    targets = tuple(map(ParameterTarget, given))
    # as written: rounded
    model = replace(model, relay=None, operators=() if any(o.memory for o in model.operators) else model.operators)
    problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-9, 1e-9, 100_000, 30.0))
    with open_simulator(problem, pool=pool) as simulator:
        found = simulator.simulate(np.array([[*given.values()]]), active=range(len(given)))
    assert found.outcomes[0, 0] == Outcome.OK
    return dict(zip(experiment.outputs, found.outputs[0][0].T, strict=True)), found.sensitivities[0][0]


def assert_equal(one, other, tolerance: float = 1e-7) -> float:
    """Compare outputs and sensitivities; the largest difference of outputs over their sizes."""
    for name, y in other[0].items():
        np.testing.assert_allclose(one[0][name], y, atol=tolerance * np.abs(y).max())
    size = np.abs(other[1]).max(axis=(0, 1))
    assert np.all(np.abs(one[1] - other[1]).max(axis=(0, 1)) <= 1e3 * tolerance * size + 1e-12)
    return max(float(np.abs(one[0][name] - y).max() / np.abs(y).max()) for name, y in other[0].items())


@pytest.mark.parametrize(
    ("rig", "ids"),
    [
        ("Cart", ["dead_zone@F", "lag@F", "gain@q", "delay@q", "presliding_friction@v"]),
        ("TankPair", ["overflow@h1", "exchange@h1", "square_loss@h2", "second_storage@h1"]),
        ("Shaft.Motor", ["heating@inductor.p"]),
    ],
)
def test_an_attached_law_is_the_law_in_the_equations(rig, ids, here, tmp_path, trust):
    source = RIGS / f"{rig.partition('.')[0]}.mo"
    found = family(rig, tmp_path, source)
    ids = [id_ for id_ in found.placed if id_ in ids]
    offer = found.with_candidates(ids)
    placed_laws = [found.placed[id_] for id_ in ids]
    assert len(offer.model.states) == len(found.base_model().states) + sum(
        len(found.blocks.model(placed).states) for placed in placed_laws
    )
    inside = written_flat(rig, [source], placed_laws, tmp_path / "written")
    given = values_of(found, ids) | {v.name: v.start or 0.0 for v in found.base_model().parameters[:3]}
    written = Model.load(export_flat(inside, tmp_path / "in.fmu"))
    trust("attached", assert_equal(run(offer.model, given, here), run(written, given, here)))


@pytest.mark.parametrize("ids", [["dead_zone@F", "rate_limit@F", "lag@F"], ["gain@q", "saturation@q", "lag@q"]])
def test_laws_at_one_signal_are_written_as_attached_in_whatever_order_they_are_named(ids, here, tmp_path):
    found = family("Cart", tmp_path, RIGS / "Cart.mo")
    given = values_of(found, ids)
    attached = run(found.with_candidates(ids).model, given, here)[0]
    for k, order in enumerate((ids, ids[::-1])):
        written = found.extend(order, given, tmp_path / f"written{k}")
        there = {new: given[old] for pairs in written.names.values() for old, new in pairs if old in given}
        for name, y in run(written.model, there, here)[0].items():
            np.testing.assert_allclose(y, attached[name], atol=1e-6 * np.abs(y).max())


def test_an_effect_of_two_like_components_is_attached_at_each(here, tmp_path):
    """Both motors have the law: one parameter, two copies of it."""
    found = family("Aero.Systems.OneDof", tmp_path)
    ids = ["amplifier_deadzone", "brush_drop", "thrust_lag", "thrust_inflow_loss", "pitch_delay", "gravity_offset"]
    given = values_of(found, ids)
    attached = found.with_candidates(ids).model
    assert len(attached.states) == 6 + 2 + 4
    assert attached.copied_state("omega_m") is not None
    written = found.extend(ids, given, tmp_path / "written")
    names = dict(pair for pairs in written.names.values() for pair in pairs)
    there = {names[old]: value for old, value in given.items()}
    assert_equal(run(attached, given, here, 8.0), run(written.model, there, here, 8.0))


SLIDE = """model Slide
  parameter Real m(unit = "kg") = 2;
  input Real F(unit = "N");
  output Real w(unit = "m/s") = v;
  Real v(unit = "m/s", start = 1, fixed = true);
equation
  m * der(v) = F;
end Slide;
"""


def test_friction_attached_to_a_mass_slows_it_as_the_closed_form_says(here, modelica, tmp_path):
    source = modelica(SLIDE)
    model = family("Slide", tmp_path, source).with_candidates(["viscous_friction@v"]).model
    assert [v.name for v in model.parameters] == ["m", "d"]
    outputs, slopes = run(model, {"d": 0.8}, here, level=0.0)
    expected = np.exp(-0.4 * TIME)
    np.testing.assert_allclose(outputs["w"], expected, rtol=1e-7)
    np.testing.assert_allclose(slopes[:, 0, 0], -0.5 * TIME * expected, atol=1e-7)


def test_friction_by_load_takes_its_share_of_the_force(here, modelica, tmp_path):
    source = modelica(SLIDE.replace("der(v) = F", "der(v) = 3 * F - 1"))
    model = family("Slide", tmp_path, source).with_candidates(["load_friction@v"]).model
    time = np.linspace(0.0, 1.0, 51)
    experiment = Experiment(time, ("w",), (InputSignal("F", time, 0.8 + 0.0 * time),))
    targets = tuple(map(ParameterTarget, ("L", "f_0")))
    problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-9, 1e-9, 100_000, 30.0))
    with open_simulator(problem, pool=here) as simulator:
        found = simulator.simulate(np.array([[0.3, 0.4]]), active=range(2))
    np.testing.assert_allclose(found.outputs[0][0][:, 0], 1.0 + (1.4 - 0.3 * (1.4 + 0.4)) / 2.0 * time, rtol=1e-7)
    np.testing.assert_allclose(found.sensitivities[0][0][:, 0, 0], -1.8 / 2.0 * time, atol=1e-6)


def test_a_load_is_the_rest_of_the_balance_and_not_of_the_own_motion_alone(modelica):
    def load(equation: str) -> str:
        source = modelica(SLIDE.replace("m * der(v) = F", equation))
        (port,) = [p for p in LawPlaces("Slide", (source,)).ports if p.id == "v"]
        return str(port.signals.get("load", ""))

    assert load("m * der(v) = F - 2 * v") == "F - 2 * v"
    assert load("der(v) = (F - (v + 1)) / m") == "F - v - 1"
    assert load("F = m * der(v) + 2 * v ^ 3") == "F - 2 * v ^ 3"
    assert load("0 = F * (v + 2) - m * der(v)") == "F * (v + 2)"
    assert load("m * der(v) = -2 * v") == ""


DEPENDENT = """model Dependent
  parameter Real k = 3;
  parameter Real twice = 2 * k;
  input Real u;
  output Real y = twice * x + u;
  Real x(start = 1, fixed = true);
equation
  der(x) = -x;
end Dependent;
"""


def test_the_derivative_of_an_output_is_its_own_where_a_parameter_depends_on_others(here, modelica, tmp_path):
    source = modelica(DEPENDENT)
    model = Model.load(export_embedded("Dependent", tmp_path / "d.fmu", [source]))
    _, slopes = run(model, {"k": 3.0}, here)
    np.testing.assert_allclose(slopes[:, 0, 0], 2.0 * np.exp(-TIME), rtol=1e-6)


def test_all_derivatives_at_once_are_those_of_one_direction_each(tmp_path):
    """Through FMPy: ``ab_columns`` of a coupled model against FMI's directional derivatives."""
    made = family("Cart", tmp_path, RIGS / "Cart.mo")
    model = made.with_candidates(["cubic_stiffness@v", "hysteretic_spring@v", "saturation@F", "lag@q"]).model
    fmu = FMU2Model(
        guid=model.guid, modelIdentifier="coupled", unzipDirectory=extract(str(model.path), str(tmp_path / "x"))
    )
    fmu.instantiate()
    fmu.setReal([p.value_reference for p in model.parameters], [0.3 + 0.1 * k for k in range(len(model.parameters))])
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.setReal([u.value_reference for u in model.inputs], [0.7] * len(model.inputs))
    fmu.exitInitializationMode()
    fmu.enterContinuousTimeMode()
    x = np.linspace(0.2, 0.5, len(model.states))
    fmu.setContinuousStates(x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), x.size)
    asked = [*model.derivatives, *(v.value_reference for v in model.outputs)]
    moved = [v.value_reference for v in (*model.states, *model.inputs, *model.parameters)]
    found = np.full((len(asked), len(moved)), np.nan)
    unknown, known = (np.array(v, dtype=np.uint32) for v in (asked, moved))
    call = [a.ctypes.data_as(ctypes.c_void_p) for a in (unknown, known, found)]
    size = ctypes.c_size_t
    assert fmu.dll.ab_columns(
        ctypes.c_void_p(fmu.component), call[0], size(len(asked)), call[1], size(len(moved)), call[2]
    ) == 0  # fmt: skip
    each = np.array([fmu.getDirectionalDerivative(asked, [k], [1.0]) for k in moved]).T
    np.testing.assert_array_equal(found, each)
    together = fmu.getDirectionalDerivative(asked, moved, np.arange(1.0, len(moved) + 1.0).tolist())
    np.testing.assert_allclose(found @ np.arange(1.0, len(moved) + 1.0), together, rtol=1e-12, atol=1e-12)
    assert np.count_nonzero(found) > len(asked)


def test_the_sharper_model_has_a_quarter_of_the_width_also_of_a_law_that_is_written_as_a_term(modelica, tmp_path):
    found = family("Slide", tmp_path, modelica(SLIDE))
    written = found.extend(["coulomb_friction@v"], {"F_c": 0.8}, tmp_path / "written")
    assert "F - F_c * tanh(v / " in written.text
    assert written.sharper is not None
    widths = []
    for model in (written.model, written.sharper):
        with driven(model.path) as fmu:
            fmu.begin()
            (rate,) = fmu.rhs(np.array([1e-6]))
            widths.append(1e-6 / np.arctanh(-2.0 * rate / 0.8))
    assert widths[1] == pytest.approx(widths[0] / 4.0, rel=1e-6)
