"""Arrays of inputs and outputs: each element is a port of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from numpy.typing import NDArray
from written_laws import attached_to, written_flat

from aero_bayes.laws.candidates import PlacedLaw, find_candidates, place_law, ports_with_laws
from aero_bayes.laws.law import Law
from aero_bayes.modelica.compose import add_output
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Name, Number

FORMS = {
    "matrices": """model Rig
  parameter Real A[2, 2] = {{-1, 0.4}, {0.2, -3}};
  input Real u[2](each unit = "V");
  output Real y[2](each unit = "m");
  Real x[2](each start = 0, each fixed = true);
equation
  der(x) = A * x + u;
  y = {x[1] + 0.1 * u[2], x[2]};
end Rig;
""",
    "a loop, bound where it is declared": """model Rig
  input Real u[2](each unit = "V");
  Real x[2](each start = 0, each fixed = true);
  output Real y[2](each unit = "m") = {x[1] + 0.1 * u[2], x[2]} "Readings";
protected
  Real pushed[2];
equation
  for i in 1:2 loop
    pushed[i] = u[i];
  end for;
  der(x[1]) = -x[1] + 0.4 * x[2] + pushed[1];
  der(x[2]) = 0.2 * x[1] - 3 * x[2] + pushed[2];
end Rig;
""",
    "connectors, and states that are read": """package Rims
  connector In = input Real;
  connector Out = output Real;
  model Plant
    In u[2];
    Out y[2](each start = 0, each fixed = true);
  equation
    der(y[1]) = -y[1] + 0.4 * y[2] + u[1];
    der(y[2]) = 0.2 * y[1] - 3 * y[2] + u[2];
  end Plant;
  model Rig
    In u[2](each unit = "V");
    Out y[2](each unit = "m");
    Plant plant;
  equation
    connect(u, plant.u);
    connect(plant.y[1], y[1]);
    connect(plant.y[2], y[2]);
  end Rig;
end Rims;
""",
    "states that are outputs": """model Rig
  input Real u[2](each unit = "V");
  output Real y[2](each unit = "m", each start = 0, each fixed = true);
equation
  der(y) = {-y[1] + 0.4 * y[2] + u[1], 0.2 * y[1] - 3 * y[2] + u[2]};
end Rig;
""",
}
#: What is switched on, by law and port.
VALUES = {"gain@u[2]": 0.5, "offset@u[1]": 0.3, "offset@y[1]": 0.2, "gain@y[2]": 0.25}


def uses_at(flat: FlatModel, laws: tuple[Law, ...], values: Mapping[str, float]) -> list[PlacedLaw]:
    by_id = {c.id: c for c in find_candidates(ports_with_laws(flat, laws), laws)}
    taken = {v.name for v in flat.variables}
    placed_laws = []
    for id_, value in values.items():
        c = by_id.get(id_.replace("@", "@output_")) or by_id[id_]
        placed = place_law(c, taken, nominals={"u_n": 1.0}, values={c.law.magnitude.name: value})
        taken |= {placed.instance, *placed.names.values()}
        placed_laws.append(placed)
    return placed_laws


def moved(fmu: Path, inputs: Mapping[str, float]) -> NDArray[np.float64]:
    found = simulate_fmu(
        str(fmu), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, stop_time=3.0,
        output_interval=0.25, start_values=dict(inputs), output=["y[1]", "y[2]"],
    )  # fmt: skip
    return np.stack([found["y[1]"], found["y[2]"]])


@pytest.mark.parametrize("form", FORMS)
def test_laws_at_elements(form, laws, blocks, modelica, tmp_path):
    """A gain and an offset of inputs are other inputs; those of readings are done to the readings."""
    path = modelica(FORMS[form])
    name = "Rims.Rig" if "Rims" in FORMS[form] else "Rig"
    flat = load_flat(name, [path])
    ids = {p.id.removeprefix("output_") for p in ports_with_laws(flat, laws)}
    assert ids >= {"u[1]", "u[2]", "y[1]", "y[2]"}
    placed_laws = uses_at(flat, laws, VALUES)
    given = {"u[1]": 1.0, "u[2]": 2.0}
    gains = 1.0 + VALUES["gain@u[2]"], 1.0 + VALUES["gain@y[2]"]
    other = {"u[1]": 1.0 + VALUES["offset@u[1]"], "u[2]": 2.0 * gains[0]}
    plain = moved(export_flat(flat, tmp_path / "plain.fmu"), other)
    expected = np.stack([plain[0] + VALUES["offset@y[1]"], plain[1] * gains[1]])
    made = attached_to(flat, placed_laws, blocks, tmp_path / "attached")
    assert np.abs(moved(made.path, given) - expected).max() < 1e-6
    again = written_flat(name, [path], placed_laws, tmp_path / "out")
    assert {n for placed in placed_laws for n in placed.names.values()} <= {v.name for v in again.variables}
    assert {v.name for v in again.variables if v.causality in ("input", "output") and "." not in v.name} >= {"u", "y"}
    assert np.abs(moved(export_flat(again, tmp_path / "written.fmu"), given) - expected).max() < 1e-6


def test_two_laws_at_one_element(laws, blocks, modelica, tmp_path):
    """The last one is the outermost: an offset before a gain is multiplied."""
    path = modelica(FORMS["matrices"])
    flat = load_flat("Rig", [path])
    given = {"u[1]": 1.0, "u[2]": 2.0}
    placed_laws = uses_at(flat, laws, {"gain@u[2]": 0.5, "offset@u[2]": 0.3})
    plain = moved(export_flat(flat, tmp_path / "plain.fmu"), given | {"u[2]": 1.5 * (2.0 + 0.3)})
    files = (
        attached_to(flat, placed_laws, blocks, tmp_path / "attached").path,
        export_flat(written_flat("Rig", [path], placed_laws, tmp_path / "out"), tmp_path / "written.fmu"),
    )
    for file in files:
        assert np.abs(moved(file, given) - plain)[1].max() < 1e-6


@pytest.mark.parametrize("form", ["matrices", "states that are outputs"])
def test_what_a_term_stands_beside_is_a_number(form, laws, modelica, tmp_path):
    """Also where one side is a vector and the other is written element by element."""
    path = modelica(FORMS[form])
    flat = load_flat("Rig", [path])
    terms = [t for p in ports_with_laws(flat, laws) if p.balance is not None for t in p.balance.beside]
    assert len(terms) >= 6
    for n, term in enumerate(terms):
        wider = add_output(flat, "watched", Call("+", (term, Call("*", (Number(1e-300), Name("time"))))))
        export_flat(wider, tmp_path / f"{n}.fmu")
