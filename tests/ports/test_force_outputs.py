"""A force or a voltage that is an output is a balance: laws are added to it with the sign of what resists."""

from __future__ import annotations

import pytest
from small_rigs import Numbers, explicit, rig, somewhere
from written_laws import written_flat

from aero_bayes.laws.candidates import Candidate, place_law, ports_with_laws

DAMPER = """model Damper
  parameter Real c(unit = "N.s/m") = 200;
  parameter Real k(unit = "N/m") = 300;
  parameter Real F_0(unit = "N") = 50;
  input Real x(unit = "m");
  input Real v(unit = "m/s");
  output Real F(unit = "N");
equation
  {equation}
end Damper;
"""


@pytest.mark.parametrize(
    ("equation", "sign"),
    [
        ("F = c * v + k * x + F_0;", 1.0),
        ("F = -c * v - k * x + F_0;", -1.0),
        ("c * v + k * x = F;", 1.0),
        ("F = F_0 - v * c;", -1.0),
        ("F = k * x + F_0;", 1.0),
    ],
)
def test_friction_resists_however_the_force_is_counted(equation, sign, laws, modelica, tmp_path, rng):
    path = modelica(DAMPER.format(equation=equation))
    flat = rig("Damper", str(path))
    ports = {p.id: p for p in ports_with_laws(flat, laws)}
    assert (ports["F"].kind, ports["F"].unit, ports["output_F"].kind) == ("motion", "N", "reading")
    assert {"coulomb_friction", "presliding_friction", "rounded_friction", "curve"} <= set(ports["F"].laws)
    assert ports["F"].signals == {"v": "v", "x": "x"}
    assert "cubic_stiffness" in ports["F"].laws
    law = next(law for law in laws if law.id == "viscous_friction")
    placed = place_law(Candidate(law, ports["F"]), [v.name for v in flat.variables], values={"d": 0.9})
    base = Numbers(explicit(flat))
    point = somewhere(["x", "v"], rng)
    written = Numbers(explicit(written_flat("Damper", [path], [placed], tmp_path / "written")))
    assert written(point)["F"] - base(point)["F"] == pytest.approx(sign * 0.9 * point["v"], rel=1e-9)


@pytest.mark.parametrize(
    "equation", ["F = k * x + F_0;", "F = c * der(x) + k * x;"], ids=["no speed", "the speed is no variable"]
)
def test_a_force_without_a_speed_is_a_reading_only(equation, laws, tmp_path):
    path = tmp_path / "Damper.mo"
    text = DAMPER.format(equation=equation).replace("input Real x(unit", "Real x(start = 0, fixed = true, unit")
    text = text.replace('  input Real v(unit = "m/s");\n', "")
    path.write_text(text.replace("  F = ", "  der(x) = 0.1 * (0.2 - x);\n  F = "), encoding="utf-8")
    ports = {p.id: p for p in ports_with_laws(rig("Damper", str(path)), laws)}
    assert "output_F" not in ports
    assert ports["F"].kind in ("output", "reading")


def test_a_force_between_two_motions_has_the_difference_of_their_speeds(laws, modelica):
    path = modelica("""model Coupled
  parameter Real c(unit = "N.s/m") = 20;
  parameter Real k(unit = "N/m") = 300;
  input Real a(unit = "N");
  output Real F(unit = "N");
  Real x_1(unit = "m", start = 0, fixed = true);
  Real x_2(unit = "m", start = 0, fixed = true);
  Real v_1(unit = "m/s", start = 0, fixed = true);
  Real v_2(unit = "m/s", start = 0, fixed = true);
equation
  der(x_1) = v_1;
  der(x_2) = v_2;
  2 * der(v_1) = a - F;
  3 * der(v_2) = F;
  F = c * (v_1 - v_2) + k * (x_1 - x_2);
end Coupled;
""")
    port = next(p for p in ports_with_laws(rig("Coupled", str(path)), laws) if p.id == "F")
    assert port.signals == {"v": "v_1 - v_2", "x": "x_1 - x_2"}
    assert port.kind == "motion"


CELL = """model Cell
  parameter Real E_0(unit = "V") = 3.6;
  parameter Real k(unit = "V") = 0.5;
  parameter Real R(unit = "Ohm") = 0.03;
  parameter Real Q(unit = "C") = 9000;
  input Real i(unit = "A");
  output Real v(unit = "V");
  Real z(start = 0.8, fixed = true) "State of charge";
equation
  der(z) = {sign}i / Q;
  v = E_0 + k * z {sign} R * i;
end Cell;
"""


@pytest.mark.parametrize("sign", ["-", "+"])
def test_a_voltage_takes_its_resistances_laws_a_charge_no_second_storage(sign, laws, modelica, tmp_path, rng):
    path = modelica(CELL.format(sign=sign))
    flat = rig("Cell", str(path))
    ports = {p.id: p for p in ports_with_laws(flat, laws)}
    assert (ports["v"].kind, ports["v"].unit, ports["v"].signals) == ("electrical", "V", {"i": "i"})
    assert ports["output_v"].kind == "reading"
    assert {"polarisation", "polarisation_of_two_pairs", "contact_drop"} <= set(ports["v"].laws)
    assert ports["z"].counts
    assert "second_storage" not in ports["z"].laws
    law = next(law for law in laws if law.id == "polarisation")
    placed = place_law(Candidate(law, ports["v"]), [v.name for v in flat.variables], values={"R_1": 0.2})
    assert placed.unit(law.magnitude) == "V/A"
    base = Numbers(explicit(flat))
    point = {**somewhere(["z", "i"], rng), "polarisation.i_1": 1.7}
    written = Numbers(explicit(written_flat("Cell", [path], [placed], tmp_path / "written")))
    assert written(point)["v"] - base(point)["v"] == pytest.approx((1.0 if sign == "+" else -1.0) * 0.2 * 1.7, rel=1e-9)


@pytest.mark.parametrize(
    ("balance", "counts"),
    [
        ("C * der(T) = P - G * (T - 20);", False),
        ("C * der(T) = P - Q;\n  Q = G * D;\n  D = T - 20;", False),
        ("C * der(T) = P;", True),
        ("C * der(T) = P + Q;\n  Q = G * P;", True),
    ],
)
def test_what_a_balance_only_counts_has_no_second_storage(balance, counts, laws, tmp_path):
    path = tmp_path / "Room.mo"
    unknowns = "".join(f"  Real {n};\n" for n in "QD" if f"  {n} = " in balance)
    path.write_text(
        f"""model Room
  parameter Real C(unit = "J/K") = 1000;
  parameter Real G(unit = "W/K") = 3;
  input Real P(unit = "W");
  output Real T(unit = "degC", start = 20, fixed = true);
{unknowns}equation
  {balance}
end Room;
""",
        encoding="utf-8",
    )
    (port,) = (p for p in ports_with_laws(rig("Room", str(path)), laws) if p.kind == "storage")
    assert port.counts is counts
    assert ("second_storage" in port.laws) is not counts
