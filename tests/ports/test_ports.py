"""Ports that are found in models of every kind, and the laws that are offered there."""

from __future__ import annotations

from pathlib import Path

import pytest
from port_models import DAMPER, MODELS, OVEN, expected_ports
from small_rigs import rig

from aero_bayes.laws.balance import Port, port_table
from aero_bayes.laws.candidates import find_candidates, ports_with_laws
from aero_bayes.laws.law import Law
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.units import dimension_of_unit, unit_text

pytestmark = pytest.mark.fast


def ports_of(name: str, folder: Path, laws: tuple[Law, ...]) -> dict[str, Port]:
    model = MODELS[name]
    return {p.id: p for p in ports_with_laws(rig(model.name, *map(str, model.written_to(folder))), laws)}


@pytest.mark.parametrize("name", MODELS)
def test_ports_are_found(name, laws, tmp_path):
    """Each physical place is one port: ends of one mass, sensors, sources and parallel elements add none."""
    found = []
    for p in ports_of(name, tmp_path, laws).values():
        assert p.laws
        assert p.place is not None
        if p.attachment not in ("input", "output"):
            signals = ", ".join(f"{signal} = {given}" for signal, given in p.signals.items())
            found.append(f"{p.id}: {p.kind} {p.attachment} {p.unit or '-'}; {signals}")
    assert found == expected_ports()[name]


def test_inputs_and_outputs_are_ports(laws, tmp_path):
    """An output that is a force, or whose name a balance has, is called by what it is."""
    kinds = {
        "cart": "F input, q output", "rim of matrices": "u[1] input, u[2] input, y[1] reading, y[2] output",
        "damper with speed": "x input, v input, output_F reading", "cell": "i input, output_v reading",
        "oven": "P input, T_hall input, T_set input, output_T output", "each place once": "road input, y output",
    }  # fmt: skip
    for name, expected in kinds.items():
        ports = ports_of(name, tmp_path, laws).values()
        found = [f"{p.id} {p.kind}" for p in ports if p.attachment in ("input", "output")]
        assert ", ".join(found) == expected


@pytest.mark.parametrize(
    ("name", "port", "states"),
    [
        ("position loop", "u", "y v z"),
        ("cascade", "g", "x"),
        ("filters", "w", "x[1] x[2]"),
        ("filters and a state by another name", "w", "x[2]"),
    ],
)
def test_a_signal_has_the_states_from_which_it_is_computed(name, port, states, laws, tmp_path):
    assert set(ports_of(name, tmp_path, laws)[port].states) == set(states.split())


@pytest.mark.parametrize(
    ("name", "port", "offered", "refused"),
    [
        ("cart", "v", "coulomb_friction cubic_stiffness end_stop position_curve", ""),
        ("motor", "w", "coulomb_friction", "cubic_stiffness position_curve"),
        ("motor", "i", "series_resistance contact_drop heating polarisation curve", "coulomb_friction"),
        ("tank pair", "h1", "overflow exchange root_loss", "radiation"),
        ("bodies", "one.port", "radiation", "overflow root_loss"),
        ("oven", "T-T_hall", "linear_loss square_loss radiation", "offset curve overflow exchange"),
        ("oven with one unit of a sum", "T", "radiation", "overflow"),
        ("no units", "y-u", "linear_loss root_loss square_loss", "offset"),
        ("car", "v_b-v_w", "quadratic_drag cubic_stiffness", "attached_mass load_friction"),
        ("car", "v_w-road", "cubic_stiffness end_stop", "offset viscous_friction coulomb_friction"),
        ("shaft that is a component", "motor.fl-load.fl", "backlash", "attached_mass"),
        ("damper with speed", "F", "coulomb_friction presliding_friction rounded_friction curve cubic_stiffness", ""),
        ("cell", "v", "polarisation polarisation_of_two_pairs contact_drop", ""),
        ("cell", "z", "offset", "second_storage"),
        ("position loop", "u", "gain dead_zone saturation rate_limit lag delay hysteresis curve", ""),
    ],
)
def test_laws_fit_by_what_they_need(name, port, offered, refused, laws, tmp_path):
    found = set(ports_of(name, tmp_path, laws)[port].laws)
    assert set(offered.split()) <= found
    assert not set(refused.split()) & found


def test_a_law_between_two_places_counts_once_and_has_a_neighbour(laws, tmp_path):
    found = [c.id for c in find_candidates(ports_with_laws(rig("TankPair"), laws), laws)]
    assert len(found) == len(set(found))
    assert [i for i in found if i.startswith("exchange")] == ["exchange@h1"]
    ports = tuple(ports_of("car", tmp_path, laws).values())
    (damper,) = (c for c in find_candidates(ports, laws) if c.id == "quadratic_drag@v_b-v_w")
    assert damper.neighbour is not None
    assert damper.neighbour.id == "v_w"


def test_the_table_names_file_and_line(laws):
    rows = {r["id"]: r for r in port_table(ports_with_laws(rig("Cart"), laws))}
    assert (rows["v"]["file"], rows["v"]["line"], rows["v"]["unit"]) == ("Cart.mo", 12, "N")
    assert rows["v"]["states"] == ["v", "x"]


@pytest.mark.parametrize(
    "equation", ["F = k * x + F_0;", "F = c * der(x) + k * x;"], ids=["no speed", "the speed is no variable"]
)
def test_a_force_without_a_speed_is_a_reading_only(equation, laws, modelica):
    text = DAMPER.format(equation=equation).replace("input Real x(unit", "Real x(start = 0, fixed = true, unit")
    text = text.replace('  input Real v(unit = "m/s");\n', "")
    path = modelica(text.replace("  F = ", "  der(x) = 0.1 * (0.2 - x);\n  F = "))
    ports = {p.id: p for p in ports_with_laws(rig("Damper", str(path)), laws)}
    assert "output_F" not in ports
    assert ports["F"].kind in ("output", "reading")


@pytest.mark.parametrize(
    ("balance", "counts"),
    [
        ("C * der(T) = P - G * (T - 20);", False),
        ("C * der(T) = P - Q;\n  Q = G * D;\n  D = T - 20;", False),
        ("C * der(T) = P;", True),
        ("C * der(T) = P + Q;\n  Q = G * P;", True),
    ],
)
def test_what_a_balance_only_counts_has_no_second_storage(balance, counts, laws, modelica):
    unknowns = "".join(f"  Real {n};\n" for n in "QD" if f"  {n} = " in balance)
    path = modelica(f"""model Room
  parameter Real C(unit = "J/K") = 1000;
  parameter Real G(unit = "W/K") = 3;
  input Real P(unit = "W");
  output Real T(unit = "degC", start = 20, fixed = true);
{unknowns}equation
  {balance}
end Room;
""")
    (port,) = (p for p in ports_with_laws(rig("Room", str(path)), laws) if p.kind == "storage")
    assert port.counts is counts
    assert ("second_storage" in port.laws) is not counts


def test_units_of_a_sum_that_differ_are_unknown(laws, modelica):
    bare = OVEN.replace('Real T_wall(unit = "degC", ', "Real T_wall(").replace('T(unit = "degC", ', "T(")
    path = modelica(bare.replace("T_hall);", "T_hall) + 0*(T_hall - T_set);"))
    (port,) = (p for p in ports_with_laws(rig("Oven", str(path)), laws) if p.id == "T")
    assert port.units["h"] == ""


def test_the_unit_of_a_term_where_numbers_and_factors_have_none(modelica):
    """9.81 hides an acceleration, and what is added to 1 is a number."""
    path = modelica("""model Slope
  parameter Real m(unit = "kg") = 2;
  parameter Real kappa = 0.4;
  input Real angle(unit = "rad");
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  (1 + kappa) * m * der(v) = -m * 9.81 * sin(angle);
end Slope;
""")
    (port,) = (p for p in ports_with_laws(load_flat("Slope", [path])) if p.kind == "motion")
    assert port.unit == "N"
    assert unit_text(dimension_of_unit("J/s")) == "W"
