"""Ports that are found in rigs of every kind, and what a term there does to the equations."""

from __future__ import annotations

import pytest
from small_rigs import RIGS, Numbers, explicit, rig, somewhere
from written_laws import written_flat

from aero_bayes.laws.balance import DIFFERENCE, port_table, signal_expression
from aero_bayes.laws.candidates import Candidate, find_candidates, place_law, ports_with_laws
from aero_bayes.laws.probes import with_drive
from aero_bayes.modelica.compose import add_input, add_output
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Name
from aero_bayes.modelica.units import dimension_of_unit, unit_text

pytestmark = pytest.mark.fast

FOUND = {
    "Cart": {"F": "input input N", "q": "output output m", "v": "motion equation N"},
    "Pendulum": {"u": "input input N.m", "angle": "output output rad", "w": "motion equation N.m"},
    "TankPair": {
        "u": "input input V", "y": "output output V", "h1": "storage equation V/s", "h2": "storage equation V/s",
    },
    "Rlc": {
        "u": "input input V", "u_C": "output output V", "i": "electrical equation V", "v_C": "storage equation A",
    },
    "Motor": {
        "V": "input input V", "speed": "output output rad/s", "current": "output output A",
        "i": "electrical equation V", "w": "motion equation N.m",
    },
    "Shaft.Motor": {
        "V": "input input V", "speed": "output output rad/s", "current": "output output A",
        "inductor.p": "electrical series V", "rotor.a": "motion node N.m", "load.a": "motion node N.m",
        "rotor.a-load.a": "motion node N.m",
    },
    "Bodies.Pair": {
        "P": "input input W", "T_1": "output output K", "T_2": "output output K", "one.port": "storage node W",
        "two.port": "storage node W",
    },
}  # fmt: skip


@pytest.mark.parametrize("model", FOUND)
def test_ports_are_found(model, laws):
    ports = ports_with_laws(rig(model), laws)
    assert {p.id: f"{p.kind} {p.attachment} {p.unit}" for p in ports} == FOUND[model]
    for p in ports:
        assert p.laws
        assert p.place is not None
        assert p.place.file == f"{model.partition('.')[0]}.mo"


def test_laws_fit_by_what_they_need(laws):
    cart = {p.id: p for p in ports_with_laws(rig("Cart"), laws)}
    assert {"coulomb_friction", "cubic_stiffness", "end_stop"} <= set(cart["v"].laws)
    motor = {p.id: p for p in ports_with_laws(rig("Motor"), laws)}
    assert "cubic_stiffness" not in motor["w"].laws  # no angle there
    assert set(motor["i"].laws) == {
        "series_resistance", "contact_drop", "heating", "polarisation", "polarisation_of_two_pairs", "curve",
    }  # fmt: skip
    assert "position_curve" in cart["v"].laws
    assert "position_curve" not in motor["w"].laws
    tanks = {p.id: p for p in ports_with_laws(rig("TankPair"), laws)}
    assert "radiation" not in tanks["h1"].laws
    assert {"overflow", "exchange", "root_loss"} <= set(tanks["h1"].laws)
    assert tanks["h1"].neighbours == ("h2",)
    bodies = {p.id: p for p in ports_with_laws(rig("Bodies.Pair"), laws)}
    assert "radiation" in bodies["one.port"].laws
    assert not {"overflow", "root_loss"} & set(bodies["one.port"].laws)  # a temperature does not spill


def test_laws_of_a_temperature_count_from_its_level(laws, tmp_path, rng):
    flat = rig("Bodies.Pair")
    port = next(p for p in ports_with_laws(flat, laws) if p.id == "one.port")
    taken = [v.name for v in flat.variables]
    for id_, c, flow in (("radiation", 2e-9, 2e-9 * (310.0**4 - 295.0**4)), ("square_loss", 0.3, 0.3 * 15.0**2)):
        law = next(law for law in laws if law.id == id_)
        placed = place_law(
            Candidate(law, port), taken, nominals={"h_n": 15.0, "h_0": 295.0, "h_z": 0.0}, values={"c": c}
        )
        wide = Numbers(explicit(written_flat("Bodies.Pair", [RIGS / "Bodies.mo"], [placed], tmp_path)))
        base = Numbers(explicit(flat))
        point = {**somewhere(base.names(), rng), "one.T": 310.0, "two.T": 300.0}
        change = wide(point)["der(one.T)"] - base(point)["der(one.T)"]
        assert change == pytest.approx(-flow / 20, rel=1e-9)


def test_exchange_counts_once(laws):
    found = [c.id for c in find_candidates(ports_with_laws(rig("TankPair"), laws), laws)]
    assert len(found) == len(set(found))
    assert [i for i in found if i.startswith("exchange")] == ["exchange@h1"]


def test_the_table_names_file_and_line(laws):
    rows = {r["id"]: r for r in port_table(ports_with_laws(rig("Cart"), laws))}
    assert (rows["v"]["file"], rows["v"]["line"], rows["v"]["unit"]) == ("Cart.mo", 12, "N")
    assert rows["v"]["states"] == ["v", "x"]


FORMS = [
    ("", "M * der(v) = F - d * v;", "1 / M"),
    ("", "M * der(v) + d * v = F;", "1 / M"),
    ("", "0 = F - d * v - M * der(v);", "1 / M"),
    ("", "der(v) = (F - d * v) / M;", "1 / M"),
    ("", "der(v) = 1 / M * (F - d * v);", "1 / M"),
    ("", "der(v) = -(d * v - F) / M;", "1 / M"),
    ("", "F = d * v + M * der(v);", "1 / M"),
    ("", "-M * der(v) = d * v - F;", "1 / M"),
    ("Real a;", "a = der(v);\n  M * a = F - d * v;", "1 / M"),
    ("Real a;", "der(v) = a;\n  a = (F - d * v) / M;", "1 / M"),
    ("Real a = (F - d * v) / M;", "der(v) = a;", "1 / M"),
    ("Real f;", "f = F - d * v;\n  M * der(v) = f;", "1 / M"),
    ("", "der(v) = F / M - d / M * v;", "1"),
    ("", "n * der(v) = n / M * F - n * d / M * v;", "-1 / n"),
]


@pytest.mark.parametrize(("declared", "balance", "gain"), FORMS)
def test_friction_brakes_however_the_balance_is_written(declared, balance, gain, laws, modelica, tmp_path, rng):
    """The acceleration changes by minus the force over the mass, or by minus an acceleration; never by plus."""
    path = modelica(f"""model Form
  parameter Real M(unit = "kg") = 2.5;
  parameter Real d(unit = "N.s/m") = 0.7;
  parameter Real n = -3;
  input Real F(unit = "N");
  output Real q(unit = "m", start = 0.2, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  {declared}
equation
  der(q) = v;
  {balance}
end Form;
""")
    flat = rig("Form", str(path))
    (port,) = (p for p in ports_with_laws(flat, laws) if p.kind == "motion")
    assert port.id == "v"
    assert port.signals.items() >= {"v": "v", "x": "q"}.items()
    law = next(law for law in laws if law.id == "viscous_friction")
    taken = [v.name for v in flat.variables]
    placed = place_law(Candidate(law, port), taken, values={"d": 0.9})
    assert placed.names == {"d": "d_v"}
    shown = Numbers(explicit(add_output(flat, "load", signal_expression(port.signals["load"]))))
    wide = Numbers(explicit(written_flat("Form", [path], [placed], tmp_path / "written")))
    base = Numbers(explicit(flat))
    point = somewhere(base.names(), rng)
    change = wide(point)["der(v)"] - base(point)["der(v)"]
    factor = {"1 / M": 1 / 2.5, "1": 1.0, "-1 / n": 1 / 3.0}[gain]
    assert change == pytest.approx(-factor * 0.9 * point["v"], rel=1e-12)
    # the load is what accelerates the body
    assert factor * shown(point)["load"] == pytest.approx(base(point)["der(v)"], rel=1e-12)


def test_coupled_masses_have_a_balance_each(laws, modelica):
    """A pendulum on a cart: both equations contain both accelerations. A screw turns an angle into a displacement."""
    path = modelica("""model Crane
  parameter Real M = 2;
  parameter Real m = 0.3;
  parameter Real l = 0.4;
  input Real F(unit = "N");
  output Real y(unit = "m") = x;
  output Real a(unit = "rad") = phi;
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real z(unit = "m", start = 0, fixed = true) "Nut of a screw";
equation
  der(x) = v;
  der(phi) = w;
  m * l * cos(phi) * der(v) + m * l ^ 2 * der(w) = -m * 9.81 * l * sin(phi);
  (M + m) * der(v) + m * l * cos(phi) * der(w) = F + m * l * w ^ 2 * sin(phi);
  der(z) = 0.01 * w;
end Crane;
""")
    ports = {p.id: p for p in ports_with_laws(rig("Crane", str(path)), laws) if p.kind not in ("input", "output")}
    lines = {i: p.place.line if p.place else 0 for i, p in ports.items()}
    assert lines == {"v": 17, "w": 16}
    assert all(p.kind == "motion" for p in ports.values())
    assert ports["w"].signals == {"v": "w", "x": "phi"}


def test_states_in_an_array_are_states(laws, modelica, tmp_path, rng):
    path = modelica("""model Chain
  parameter Real k[2] = {3, 5};
  input Real u;
  output Real y = x[1];
  Real x[2](each start = 0, each fixed = true);
equation
  der(x[1]) = x[2];
  der(x[2]) = (u - k[1] * x[1] - 0.1 * x[2]) / k[2];
end Chain;
""")
    flat = rig("Chain", str(path))
    (port,) = (p for p in ports_with_laws(flat, laws) if p.kind not in ("input", "output"))
    assert (port.id, port.kind, dict(port.signals)) == (
        "x[2]", "motion", {"v": "x[2]", "x": "x[1]", "load": "u - k[1] * x[1] - 0.1 * x[2]"},
    )  # fmt: skip
    law = next(law for law in laws if law.id == "viscous_friction")
    placed = place_law(Candidate(law, port), [v.name for v in flat.variables], values={"d": 0.9})
    base, wide = Numbers(explicit(flat)), Numbers(explicit(written_flat("Chain", [path], [placed], tmp_path / "out")))
    point = somewhere(base.names(), rng)
    change = wide(point)["der(x[2])"] - base(point)["der(x[2])"]
    assert change == pytest.approx(-0.9 * point["x[2]"] / 5)


@pytest.mark.parametrize("model", FOUND)
def test_a_probe_drives_at_every_port(model, laws, rng):
    flat = rig(model)
    ports = [p for p in ports_with_laws(flat, laws) if p.attachment != "output"]
    base = Numbers(explicit(flat))
    point = somewhere(base.names(), rng)
    expected = base(point)
    for port in ports:
        neighbour = next((p for p in ports if p.id in port.neighbours[:1]), None)
        wide = Numbers(explicit(with_drive(add_input(flat, "probe"), port, Name("probe"), neighbour)))
        assert wide({**point, "probe": 0.0}) == pytest.approx(expected, rel=1e-12)
        felt = wide({**point, "probe": 0.1})
        changed = {k for k in expected if abs(felt[k] - expected[k]) > 1e-9}
        assert changed, port.id
        if port.kind in ("motion", "storage"):
            first, *other = next(s for s in (port.signals.get("v"), port.signals.get("h")) if s).split(DIFFERENCE)
            faster = {k: felt[f"der({k})"] - expected[f"der({k})"] for k in (first, *other)}
            assert faster[first] > 0, port.id
            assert all(faster[k] < 0 for k in other), port.id


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
