"""Replaceable models of a user's own package: found in the text, filled with the laws that fit, and written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from facts import facts

from aero_bayes import Fit, fit
from aero_bayes.data import Recording
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import parameters_from_model
from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import Model
from aero_bayes.structure.balance import port_table
from aero_bayes.structure.candidates import place_laws
from aero_bayes.structure.law_places import LawPlaces
from aero_bayes.structure.modelica_family import ModelicaFamily
from aero_bayes.structure.write_model import WrittenModel, reserved_names, write_laws

CIRCUIT = """package Circuit
  connector Pin
    Real v(unit = "V");
    flow Real i(unit = "A");
  end Pin;
  partial model Lead
    Pin p;
    Pin n;
  end Lead;
  model Wire
    extends Lead;
  equation
    p.v = n.v;
    p.i + n.i = 0;
  end Wire;
  model Contact "Contact with a resistance"
    extends Lead;
    parameter Real R_c(unit = "Ohm", min = 0, max = 50, nominal = 1) = 0 "Resistance";
  equation
    p.v - n.v = R_c * p.i;
    p.i + n.i = 0;
  end Contact;
  model Battery
    extends Lead;
    parameter Real V_b(unit = "V", min = -5, max = 5, nominal = 0.5) = 0;
  equation
    p.v - n.v = V_b;
    p.i + n.i = 0;
  end Battery;
  partial model Meter
    input Real u;
    output Real y;
  end Meter;
  model Exact
    extends Meter;
  equation
    y = u;
  end Exact;
  model Shifted
    extends Meter;
    parameter Real b(unit = "V", min = -1, max = 1, nominal = 0.1) = 0;
  equation
    y = u + b;
  end Shifted;
  model Scaled
    extends Meter;
    parameter Real g(unit = "1", min = -1, max = 1, nominal = 0.1) = 0;
  equation
    y = u * (1 + g);
  end Scaled;
  model Supply
    Pin p;
    input Real V(unit = "V");
  equation
    p.v = V;
  end Supply;
  model Storage
    Pin p;
    parameter Real C(unit = "F") = 1;
    parameter Real R(unit = "Ohm") = 1;
    Real x(unit = "V", start = 0, fixed = true);
  equation
    p.v - x = R * p.i;
    C * der(x) = p.i;
  end Storage;
  model Amplified "Another meter, no law: nothing switches it off"
    extends Meter;
    parameter Real k(nominal = 1, min = 0.1 * k_0) = 2;
    parameter Real k_0 = 1;
  equation
    y = k * u;
  end Amplified;
  model Rig
    extends Half;
    replaceable model Reading = Exact constrainedby Meter;
    output Real w(unit = "V");
    Reading reading(u = storage.x);
  equation
    w = reading.y;
  end Rig;
  partial model Half
    parameter Real C(unit = "F", min = 0.01, max = 10) = 0.5;
    parameter Real R(unit = "Ohm", min = 0.1, max = 100) = 2;
    replaceable model Link = Wire constrainedby Lead "To the capacitor" annotation (choicesAllMatching = true);
    input Real V(unit = "V");
    Supply supply(V = V);
    Link link;
    Storage storage(C = C, R = R);
  equation
    connect(supply.p, link.p);
    connect(link.n, storage.p);
  end Half;
end Circuit;
"""


@pytest.fixture
def source(modelica) -> Path:
    path = modelica(CIRCUIT)
    return path


def written(source: Path, values: dict[str, dict[str, float]]) -> WrittenModel:
    """The rig with laws by id, at values of their parameters."""
    places = LawPlaces("Circuit.Rig", (source,))
    chosen = [c for c in places.candidates if c.id in values]
    placed_laws = place_laws(chosen, reserved_names(places.flat, (source,)), {"V": {"u_n": 10.0}})
    placed_laws = tuple(replace(placed, values=values[placed.id]) for placed in placed_laws)
    return write_laws((source,), places.base, places.flat, placed_laws, source.parent)


def at(model: ExplicitModel, x: float, v: float) -> tuple[float, float]:
    """Rate of the capacitor's voltage, and its reading."""
    b = model.system.builder
    known = {
        b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"
    }
    known |= {b.symbol("V"): v, b.symbol(model.states[0]): x}
    rate, reading = evaluate_nodes([model.rates[0], model.solved.get("w", b.symbol("w"))], known)
    return rate, reading


def test_ports_and_laws_come_from_the_text(source):
    places = LawPlaces("Circuit.Rig", (source,))
    rows = {row["id"]: row for row in port_table(places.replaceables)}
    assert {id_: row["laws"] for id_, row in rows.items()} == {
        "reading": ["shifted", "scaled"], "link": ["contact", "battery"],
    }  # fmt: skip
    lines = CIRCUIT.splitlines()
    assert {id_: (row["file"], "model " + id_.capitalize() in lines[row["line"] - 1]) for id_, row in rows.items()} == {
        "reading": ("Circuit.mo", True), "link": ("Circuit.mo", True),
    }  # fmt: skip
    ids = {c.id for c in places.candidates}
    assert ids >= {"contact@link", "battery@link", "shifted@reading", "offset@V"}
    assert {p.id for p in places.ports} >= {"V", "w", "link", "reading"}


def test_laws_in_one_place_act_one_after_the_other(source):
    values = {"contact@link": {"R_c": 3.0}, "battery@link": {"V_b": 0.7}}
    values |= {"shifted@reading": {"b": 0.2}, "scaled@reading": {"g": 0.1}}
    found = written(source, values)
    rate, reading = at(explicit_model(found.name, [source, found.path]), 1.5, 9.0)
    assert rate == pytest.approx((9.0 - 0.7 - 1.5) / (2.0 + 3.0) / 0.5, rel=1e-12)
    assert reading == pytest.approx((1.5 + 0.2) * 1.1, rel=1e-12)


def test_laws_in_a_replaceable_model_and_at_a_port_stand_in_one_file(source):
    found = written(source, {"contact@link": {"R_c": 3.0}, "offset@V": {"b": 0.5}})
    assert found.text.count("\nend ") == 2
    rate, _ = at(explicit_model(found.name, [source, found.path]), 1.5, 9.0)
    assert rate == pytest.approx((9.5 - 1.5) / (2.0 + 3.0) / 0.5, rel=1e-12)


def fitted(family: ModelicaFamily) -> Fit:
    """A fit of the capacitance to a short recording, and the candidates prepared."""
    time = np.arange(400) * 0.02
    drive = np.repeat(np.random.default_rng(3).uniform(-10.0, 10.0, 8), 50)
    recording = Recording("run", time, {"V": drive}, {"w": np.cumsum(drive) * 0.002}, {"time": "s", "V": "V", "w": "V"})
    plain = family.base_model()
    found = fit([recording], plain, parameters=parameters_from_model(plain, free=["C"]), workers=1)
    family.prepare(found.calibration, found.optimum, open_simulator)
    return found


def test_what_is_offered_is_what_is_written(source):
    family = ModelicaFamily(LawPlaces("Circuit.Rig", (source,)), source.parent / "fmu")
    found = fitted(family)
    ids = ["contact@link", "offset@V"]
    offer = family.with_candidates(ids)
    assert {c.id for c, _ in offer.terms} == {*ids}
    off = {p.name: 0.0 for _, own in offer.terms for p in own}
    values = off | {"R_c": 3.0, family.parameters("offset@V")[0].name: 0.5}
    written = family.extend(ids, values, source.parent / "out")
    names = {old: new for pairs in written.names.values() for old, new in pairs}
    one = simulated(found, family, offer.model, values)
    two = simulated(found, family, written.model, {new: values[old] for old, new in names.items()})
    np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-8)


def simulated(found: Fit, family: ModelicaFamily, model: Model, values: dict[str, float]) -> np.ndarray:
    calibration = family.transfer(found.calibration, model)
    calibration = replace(calibration, fixed={**calibration.fixed, **values})
    with open_simulator(calibration.problem()) as simulator:
        run = simulator.simulate(found.values[None])
    values_seen: np.ndarray = run.outputs[0][0]
    return values_seen


def test_where_the_text_does_not_say_how_laws_go_together_one_fits_alone(source):
    """A neutral class that says it in another way."""
    source.write_text(CIRCUIT.replace("    y = u;\n", "    y - u = 0;\n"), encoding="utf-8")
    assert written(source, {"shifted@reading": {"b": 0.2}}).name == "Rig_shifted"
    with pytest.raises(CannotFinishError, match=facts("Exact")):
        written(source, {"shifted@reading": {}, "scaled@reading": {}})
    family = ModelicaFamily(LawPlaces("Circuit.Rig", (source,)), source.parent / "fmu")
    fitted(family)
    assert [c.id for c, _ in family.with_candidates(["scaled@reading"]).terms] == ["scaled@reading"]
