"""Each physical place is one port: ends of one mass, sensors, sources and parallel elements add none."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_rigs import Numbers, explicit, rig, somewhere
from written_laws import written_flat

from aero_bayes.laws.candidates import Candidate, place_law, ports_with_laws

pytestmark = pytest.mark.fast

LIBRARY = """package Lib
  package Units
    type Place = Real(unit = "m");
    type Speed = Real(unit = "m/s");
  end Units;
  package Parts
    import U = Lib.Units;
    connector Flange
      U.Place s;
      flow Real f(unit = "N");
    end Flange;
    model Mass "has a length"
      parameter Real m(unit = "kg") = 2, L(unit = "m") = 0.3;
      Flange a, b;
      U.Place s(start = 0, fixed = true);
      U.Speed v(start = 0, fixed = true);
      Real acc(unit = "m/s2");
    equation
      a.s = s - L / 2;
      b.s = s + L / 2;
      v = der(s);
      acc = der(v);
      m * acc = a.f + b.f;
    end Mass;
    model Strut
      parameter Real c(unit = "N/m") = 50, d(unit = "N.s/m") = 3;
      Flange a, b;
      U.Place s_rel;
      U.Speed v_rel;
      Real acc_rel(unit = "m/s2");
      Real f(unit = "N");
    equation
      s_rel = b.s - a.s;
      v_rel = der(s_rel);
      acc_rel = der(v_rel);
      f = c * s_rel + d * v_rel;
      b.f = f;
      a.f = -f;
    end Strut;
    model Shaker "moves its flange as it is told, a filter in between"
      input Real target(unit = "m");
      Flange a;
      U.Place s(start = 0, fixed = true);
      U.Speed v(start = 0, fixed = true);
    equation
      a.s = s;
      v = der(s);
      der(v) = ((target - s) * 300 - v) * 300;
    end Shaker;
    model Accelerometer
      Flange a;
      U.Speed v;
      Real acc(unit = "m/s2");
    equation
      v = der(a.s);
      acc = der(v);
      a.f = 0;
    end Accelerometer;
    model Wall
      Flange a;
    equation
      a.s = 0;
    end Wall;
  end Parts;
end Lib;
"""
RIG = """model Car
  import Lib.Parts.*;
  input Real road(unit = "m");
  output Real y(unit = "m/s2") = sensor.acc;
  Mass body, wheel(m = 0.5);
  Strut strut(c = 20), tyre(c = 300), twin(c = 1), brake;
  Shaker shaker(target = road);
  Accelerometer sensor;
  Wall wall;
equation
  connect(shaker.a, tyre.a);
  connect(tyre.b, wheel.a);
  connect(wheel.b, strut.a);
  connect(wheel.b, twin.a);
  connect(strut.b, body.a);
  connect(twin.b, body.a);
  connect(body.b, brake.a);
  connect(brake.b, wall.a);
  connect(sensor.a, body.a);
end Car;
"""


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    (tmp_path / "Lib.mo").write_text(LIBRARY, encoding="utf-8")
    (tmp_path / "Car.mo").write_text(RIG, encoding="utf-8")
    return [tmp_path / "Car.mo", tmp_path / "Lib.mo"]


def test_each_place_is_listed_once(sources, laws):
    """No shaker, no accelerometer; the brake is where the body moves, the twin where the strut is."""
    found = {p.id: (p.kind, p.unit) for p in ports_with_laws(rig("Car", *map(str, sources)), laws)}
    assert found == {
        "road": ("input", "m"), "y": ("output", "m/s2"), "body.a": ("motion", "N"), "wheel.a": ("motion", "N"),
        "strut.s_rel": ("motion", "N"), "tyre.s_rel": ("motion", "N"),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("port", "change"),
    [
        ("body.a", lambda at: {"body": -0.7 * at["body.v"]}),
        ("strut.s_rel", lambda at: {"body": 0.7 * (at["wheel.v"] - at["body.v"])}),
        ("tyre.s_rel", lambda at: {"wheel": 0.7 * (at["shaker.v"] - at["wheel.v"])}),
    ],
)
def test_friction_there_pulls_at_both_ends(port, change, sources, laws, tmp_path, rng):
    flat = rig("Car", *map(str, sources))
    place = next(p for p in ports_with_laws(flat, laws) if p.id == port)
    law = next(law for law in laws if law.id == "viscous_friction")
    placed = place_law(Candidate(law, place), {v.name for v in flat.variables}, values={"d": 0.7})
    again = Numbers(explicit(written_flat("Car", sources, [placed], tmp_path / "out")))
    base = Numbers(explicit(flat))
    at = somewhere(base.names(), rng)
    at = {n: at[n] for n in base.names()}
    before, after = base(at), again(at)
    pulled = {k: after[k] - before[k] for k in before}
    forces = {"body": 2.0, "wheel": 0.5}
    known = {k.removeprefix("der(").removesuffix(".v)"): v for k, v in pulled.items() if k.endswith(".v)")}
    for part, force in change(at).items():
        assert known[part] * forces[part] == pytest.approx(force, rel=1e-9)
    if port == "strut.s_rel":
        assert known["wheel"] * 0.5 == pytest.approx(-known["body"] * 2.0, rel=1e-9)
