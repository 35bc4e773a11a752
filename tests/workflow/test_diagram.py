"""Diagrams: what Modelica's annotations say, and what was changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from aero_bayes.commands.context import model_diagrams
from aero_bayes.modelica.library import modelica_root
from aero_bayes.report.schema_run import ComponentJson, DiagramJson

pytestmark = pytest.mark.fast

LIBRARY = """
within ;
package Rig "A rig"
  connector Pin Real v; flow Real i; end Pin;
  partial model Slot "What may act"
    Pin p;
    annotation (Icon(graphics = {
      Rectangle(origin = {10, 0}, extent = {{-60, 40}, {60, -40}}, fillPattern = FillPattern.Solid),
      Text(extent = {{0, 0}, {1, 1}}, textString = "%name")}));
  end Slot;
  model Nothing extends Slot; equation p.i = 0; end Nothing;
  model Friction "Dry // friction; with \\"marks\\""
    extends Slot; parameter Real c = 1; equation p.i = c * tanh(p.v);
  end Friction;
  model Motor "A motor"
    replaceable model Effect = Nothing constrainedby Slot "slot" annotation (choicesAllMatching = true);
    Pin p annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
    Effect effect
      annotation (Placement(transformation(origin = {50, 0}, extent = {{-10, -10}, {10, 10}}, rotation = 90)));
    /* a comment; with a semicolon */
  equation
    connect(p, effect.p) annotation (Line(points = {{-100, 0}, {40, 0}}));
  end Motor;
  model Placed "Drawn by its authors"
    replaceable model Effect = Nothing;
    input Real u(unit = "V") "Voltage" annotation (Placement(transformation(extent = {{-120, -10}, {-100, 10}})));
    output Real y annotation (Placement(transformation(extent = {{100, -10}, {120, 10}})));
    parameter Real gain = 2 * 3 "Gain";
    Motor motor(redeclare model Effect = Effect, k = -u)
      annotation (Placement(transformation(extent = {{-10, -10}, {10, 10}})));
    Motor other annotation (Placement(transformation(extent = {{40, -10}, {60, 10}})));
  equation
    connect(motor.p, other.p) annotation (Line(points = {{10, 0}, {40, 0}}, color = {0, 0, 200}));
    if time > 1 then der(x) = 1; else der(x) = 0; end if;
    y = other.v;
  end Placed;
  model Bare
    input Real u; output Real y; Motor a(k = u); Motor b; Motor c;
  equation
    connect(a.p, b.p); connect(a.p, c.p);
    y = b.v;
  end Bare;
end Rig;
"""
EXTENDED = """
model Better "Placed with friction"
  extends Rig.Placed(redeclare model Effect = Rig.Friction, motor(effect(c = c)));
  parameter Real c = 0.5;
end Better;
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("library")
    (folder / "Rig.mo").write_text(LIBRARY, "utf-8")
    (folder / "Better.mo").write_text(EXTENDED, "utf-8")
    return [folder / "Rig.mo", folder / "Better.mo"]


def named(diagram: DiagramJson) -> dict[str, ComponentJson]:
    return {component.name: component for component in diagram.components}


def test_placements_icons_and_lines_are_those_of_the_annotations(files: list[Path]) -> None:
    (diagram,) = model_diagrams("Rig.Placed", files, ports=["u"])
    parts = named(diagram)
    assert parts["u"].marked
    assert list(parts) == ["u", "y", "motor", "other"]
    assert parts["motor"].extent == (-10, -10, 10, 10)
    assert [parts[name].terminal for name in "uy"] == ["input", "output"]
    assert parts["motor"].description == "A motor"
    lines = {(line.first, line.second): line for line in diagram.connections}
    assert lines["motor", "other"].points == [(10, 0), (40, 0)]
    assert {ends for ends, line in lines.items() if line.signal} == {("u", "motor"), ("other", "y")}


def test_an_effect_deep_within_a_component_is_marked_on_the_way_to_it(files: list[Path]) -> None:
    top, within = model_diagrams("Rig.Placed", files, extended="Better")
    assert [name for name, part in named(top).items() if part.marked] == ["motor"]
    assert within.title == "within motor"
    effect = named(within)["effect"]
    assert effect.marked
    assert effect.type == "Rig.Friction"
    assert effect.description == 'Dry // friction; with \\"marks\\"'
    assert (effect.extent, effect.rotation) == ((40, -10, 60, 10), 90)
    assert [(s.kind, s.points, s.filled) for s in effect.shapes] == [("rectangle", [(-50, 40), (70, -40)], True)]


@pytest.mark.parametrize("name", ["Rig.Placed", "Rig.Bare", "nobody.knows"])
def test_there_is_no_diagram_without_the_place_of_an_effect(files: list[Path], name: str) -> None:
    """None where none was added, and none of parts that nobody placed."""
    assert model_diagrams(name, files, ports=["u"] if name == "Rig.Bare" else []) == []


@pytest.mark.parametrize("name", ["OneDof", "HalfQuad"])
def test_the_shipped_models_are_drawn_whole(name: str) -> None:
    """Every component of every class is placed, and every line begins and ends at components that are there."""
    (diagram,) = model_diagrams(f"Aero.Systems.{name}", sorted(modelica_root().rglob("*.mo")), ports=["theta"])
    parts = named(diagram)
    assert parts["theta"].marked
    assert all(part.shapes for part in diagram.components if not part.terminal)
    assert {end for line in diagram.connections for end in (line.first, line.second)} == set(parts)
