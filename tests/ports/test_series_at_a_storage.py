"""A drop of potential in a branch of a circuit, also where more than two connectors meet: a capacitor's resistance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from small_rigs import RIGS
from written_laws import written_flat

from aero_bayes.laws.attach import AlgebraicLoopError
from aero_bayes.laws.candidates import find_candidates, place_law, ports_with_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.write_model import write_laws
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.rumoca_front import load_flat

FILTER = """within ;
model Filter "Source, resistor, capacitor, and a probe at their node"
  model Capacitor
    extends Shaft.TwoPin(v(start = 0, fixed = true));
    parameter Real C(unit = "F") = 1e-3;
  equation
    C * der(v) = i;
  end Capacitor;
  input Real u(unit = "V");
  output Real y(unit = "V") = leak.p.v;
  Shaft.Source source(u = u);
  Shaft.Resistor resistor(R = 100);
  Shaft.Resistor leak(R = 1e9);
  Capacitor capacitor;
  Shaft.Ground ground;
equation
  connect(source.p, resistor.p);
  connect(resistor.n, capacitor.p) annotation (Line(points = {{0,0},{1,1}}));
  connect(leak.p, capacitor.p);
  connect(capacitor.n, ground.p);
  connect(source.n, ground.p);
  connect(leak.n, ground.p);
end Filter;
"""


def answer(fmu: Path) -> np.ndarray:
    """The output every 10 ms after a step to 3 V."""
    found = simulate_fmu(
        str(fmu), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, stop_time=0.5,
        output_interval=0.01, start_values={"u": 3.0}, output=["y"],
    )  # fmt: skip
    return found["y"]


def test_the_series_resistance_of_a_capacitor(laws, modelica, tmp_path):
    """The response to a step begins at once, and then has a longer time constant."""
    path = modelica(FILTER)
    sources = [RIGS / "Shaft.mo", path]
    flat = load_flat("Filter", sources)
    ports = {p.id: p for p in ports_with_laws(flat, laws)}
    assert ports["capacitor.v"].kind == "storage"
    assert (ports["capacitor.p"].kind, ports["capacitor.p"].attachment) == ("electrical", "series")
    series = 25.0
    (c,) = (c for c in find_candidates([ports["capacitor.p"]], laws) if c.law.id == "series_resistance")
    placed = place_law(c, (), nominals={"v_n": 1.0, "i_n": 0.01}, values={"R_s": series})
    written = write_laws(sources, "Filter", flat, [placed], tmp_path / "out")
    lines = [line.strip() for line in written.text.splitlines()]
    assert "connect(leak.p, series_resistance.p);" in lines
    assert lines.count("connect(series_resistance.n, capacitor.p);") == 1
    t = np.linspace(0.0, 0.5, 51)
    expected = 3.0 * (1.0 - 100.0 / (100.0 + series) * np.exp(-t / ((100.0 + series) * 1e-3)))
    y = answer(export_flat(load_flat(written.name, [*sources, written.path]), tmp_path / "written.fmu"))
    assert np.abs(y - expected).max() < 1e-5


def test_two_drops_in_a_branch_without_a_state(laws, modelica, tmp_path):
    """A resistance and a contact before a resistor: they follow each other, at the one place that a branch has."""
    path = modelica(FILTER)
    sources = [RIGS / "Shaft.mo", path]
    flat = load_flat("Filter", sources)
    port = next(p for p in ports_with_laws(flat, laws) if p.id == "resistor.p")
    assert (port.kind, port.attachment, port.states) == ("electrical", "series", ())
    values = {"series_resistance": {"R_s": 25.0}, "contact_drop": {"V_c": 0.4}}
    placed_laws = [
        place_law(c, (), nominals={"v_n": 1.0, "i_n": 0.01}, values=values[c.law.id])
        for c in find_candidates([port], laws) if c.law.id in values
    ]  # fmt: skip
    written = write_laws(sources, "Filter", flat, placed_laws, tmp_path / "out")
    lines = [line.strip() for line in written.text.splitlines()]
    assert len(placed_laws) == 2
    assert sum(line.endswith("resistor.p);") for line in lines) == 1
    t = np.linspace(0.0, 0.5, 51)
    expected = 2.6 * (1.0 - np.exp(-t / 0.125))
    y = answer(export_flat(load_flat(written.name, [*sources, written.path]), tmp_path / "written.fmu"))
    assert np.abs(y - expected).max() < 1e-4
    # the drops depend on the current that they change: the search, too, solves them together with the model
    family = ModelicaFamily(LawPlaces("Filter", tuple(sources)), tmp_path / "fmus")
    family.placed.update({placed.id: placed for placed in placed_laws})
    with pytest.raises(AlgebraicLoopError):
        family._attached(placed_laws)
    assert np.abs(answer(family.with_candidates([*family.placed]).model.path) - expected).max() < 1e-4


def test_a_branch_has_one_place(laws, modelica):
    text = FILTER.replace(
        "  connect(source.p, resistor.p);", "  connect(source.p, one.p);\n  connect(one.n, resistor.p);"
    )
    path = modelica(text.replace("  Shaft.Ground", "  Shaft.Resistor one(R = 7);\n  Shaft.Ground"))
    flat = load_flat("Filter", [RIGS / "Shaft.mo", path])
    found = [p.id for p in ports_with_laws(flat, laws) if p.kind == "electrical"]
    # the third is that of the two resistors, which share a current
    assert len(found) == 3
    assert {"capacitor.p", "leak.p"} < set(found)


GROUNDED = """within ;
model Grounded "A chain whose capacitors have one pin"
  model Capacitor
    Shaft.Pin p;
    Real v(unit = "V", start = 0, fixed = true) = p.v;
    parameter Real C(unit = "F") = 1e-3;
  equation
    C * der(v) = p.i;
  end Capacitor;
  input Real u(unit = "V");
  output Real y(unit = "V") = one.v;
  Shaft.Source source(u = u);
  Shaft.Resistor resistor(R = 100);
  Capacitor one;
  Shaft.Ground ground;
equation
  connect(source.p, resistor.p);
  connect(resistor.n, one.p);
  connect(source.n, ground.p);
end Grounded;
"""


def test_a_pin_that_is_a_node_is_a_place_for_a_flow_and_for_a_drop(laws, modelica, tmp_path):
    path = modelica(GROUNDED)
    flat = load_flat("Grounded", [RIGS / "Shaft.mo", path])
    ports = {p.id: p for p in ports_with_laws(flat, laws)}
    assert (ports["one.p"].kind, ports["series_one.p"].kind) == ("storage", "electrical")
    drop = next(c for c in find_candidates(tuple(ports.values()), laws) if c.id == "series_resistance@series_one.p")
    placed = place_law(drop, [v.name for v in flat.variables], values={"R_s": 50.0})
    again = written_flat("Grounded", [RIGS / "Shaft.mo", path], [placed], tmp_path / "written")
    t, tau = 0.01 * np.arange(51), 150.0 * 1e-3
    y = answer(export_flat(again, tmp_path / "written.fmu"))
    assert np.abs(y - 3.0 * (1.0 - np.exp(-t / tau))).max() < 1e-4
