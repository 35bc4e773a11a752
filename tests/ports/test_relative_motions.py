"""What acts between two motions: where it may be missing, and what is written into both balances."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from closed_form import runge_kutta
from small_rigs import Numbers, explicit
from written_laws import agree, uses_at, written_flat

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.laws.balance import Port
from aero_bayes.laws.candidates import find_candidates, ports_with_laws
from aero_bayes.laws.law import shipped_laws
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.modelica.rumoca_front import load_flat

CAR = """model Car "A quarter of a car"
  parameter Real m_b(unit = "kg", min = 0) = 250;
  parameter Real m_w(unit = "kg", min = 0) = 40;
  parameter Real k_s(unit = "N/m", min = 0) = 20000;
  parameter Real c_s(unit = "N.s/m", min = 0) = 1000;
  parameter Real k_t(unit = "N/m", min = 0) = 160000;
  input Real road(unit = "m");
  output Real body(unit = "m", start = 0, fixed = true);
  output Real wheel(unit = "m", start = 0, fixed = true);
protected
  Real v_b(unit = "m/s", start = 0, fixed = true);
  Real v_w(unit = "m/s", start = 0, fixed = true);
  Real f(unit = "N") "Force of the suspension";
equation
  f = k_s*(body - wheel) + c_s*(v_b - v_w);
  der(body) = v_b;
  der(wheel) = v_w;
  m_b*der(v_b) = -f;
  m_w*der(v_w) = f - k_t*(wheel - road);
end Car;
"""
SHAFT = """model Shaft "Three inertias, the last one on its own"
  parameter Real J(unit = "kg.m2") = 1;
  input Real tau(unit = "N.m");
  output Real w_1(unit = "rad/s", start = 0, fixed = true);
  Real w_2(unit = "rad/s", start = 0, fixed = true);
  Real w_3(unit = "rad/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0, fixed = true);
equation
  der(phi) = w_2 - w_1;
  J*der(w_1) = tau + 30*phi;
  J*der(w_2) = -30*phi - 0.1*w_2;
  J*der(w_3) = tau - 0.2*w_3;
end Shaft;
"""
DRIVE = """model Drive "Two inertias, a shaft between them that is a component of its own, and a brake"
  connector Flange
    Real phi(unit = "rad");
    flow Real tau(unit = "N.m");
  end Flange;
  model Rotor
    parameter Real J(unit = "kg.m2", min = 0) = 0.01;
    Flange fl;
    Real w(unit = "rad/s", start = 0, fixed = true);
    input Real tau(unit = "N.m");
  equation
    w = der(fl.phi);
    J*der(w) = tau + fl.tau;
  end Rotor;
  model Shaft
    parameter Real c(unit = "N.m/rad", min = 0) = 40;
    Flange a;
    Flange b;
  equation
    a.tau = c*(a.phi - b.phi) + 0.1*(der(a.phi) - der(b.phi));
    a.tau + b.tau = 0;
  end Shaft;
  input Real u(unit = "N.m");
  output Real n(unit = "rad/s");
  Rotor motor(fl(phi(start = 0, fixed = true)), tau = u);
  Rotor load(J = 0.03, fl(phi(start = 0, fixed = true)), tau = -0.02*load.w);
  Rotor far(J = 0.05, fl(phi(start = 0, fixed = true)), tau = -0.02*far.w);
  Shaft shaft;
  Shaft second(c = 20);
equation
  connect(motor.fl, shaft.a);
  connect(shaft.b, load.fl);
  connect(load.fl, second.a);
  connect(second.b, far.fl);
  n = load.w;
end Drive;
"""


def found(tmp_path: Path, source: str) -> dict[str, Port]:
    name = source.split()[1]
    (tmp_path / f"{name}.mo").write_text(source, encoding="utf-8")
    return {p.id: p for p in ports_with_laws(load_flat(name, [tmp_path / f"{name}.mo"]), shipped_laws())}


def test_two_masses_that_a_force_couples_have_a_place_between_them(tmp_path):
    ports = found(tmp_path, CAR)
    between = ports["v_b-v_w"]
    assert between.signals == {"v": "v_b - v_w", "x": "body - wheel"}
    assert (between.unit, between.neighbours) == ("N", ("v_w",))
    assert set(between.laws) == set(ports["v_b"].laws) - {"attached_mass", "load_friction"}
    (damper,) = (c for c in find_candidates(tuple(ports.values()), shipped_laws()) if c.id == "quadratic_drag@v_b-v_w")
    assert damper.neighbour is not None
    assert damper.neighbour.id == "v_w"


def test_a_twist_that_is_a_state_is_the_displacement_between_two_bodies(tmp_path):
    ports = found(tmp_path, SHAFT)
    assert [id_ for id_ in ports if "-" in id_] == ["w_2-w_1"]
    assert ports["w_2-w_1"].signals == {"v": "w_2 - w_1", "x": "phi"}
    assert ports["w_2-w_1"].units["x"] == "rad"


def test_only_what_a_component_joins_has_a_place_beside_it(tmp_path):
    ports = found(tmp_path, DRIVE)
    assert [id_ for id_ in ports if "-" in id_] == ["motor.fl-load.fl", "load.fl-far.fl"]
    twist = ports["motor.fl-load.fl"]
    assert twist.signals == {"v": "motor.w - load.w", "x": "motor.fl.phi - load.fl.phi"}
    assert (twist.attachment, twist.unit, twist.neighbours) == ("node", "N.m", ("load.fl",))
    assert set(twist.laws) == set(ports["motor.fl"].laws) - {"attached_mass"}


def test_what_acts_at_one_end_of_a_component_reacts_at_the_other(laws, tmp_path):
    (tmp_path / "Drive.mo").write_text(DRIVE, encoding="utf-8")
    flat = load_flat("Drive", [tmp_path / "Drive.mo"])
    (placed,) = uses_at(flat, laws, "quadratic_drag@motor.fl-load.fl")
    with_it = Numbers(explicit(written_flat("Drive", [tmp_path / "Drive.mo"], [placed], tmp_path)))
    without = Numbers(explicit(flat))
    point = {**dict.fromkeys(without.names(), 0.0), "motor.w": 3.0, "load.w": 5.0}
    one, two = with_it(point), without(point)
    change = [one[f"der({rotor}.w)"] - two[f"der({rotor}.w)"] for rotor in ("motor", "load", "far")]
    torque = placed.value(placed.law.parameters[0]) * 2.0**2
    assert change == pytest.approx([torque / 0.01, -torque / 0.03, 0.0], abs=1e-12)


M_B, M_W, K_S, C_S, K_T, K_3 = 250.0, 40.0, 16000.0, 1500.0, 160000.0, 8e6


@pytest.mark.parametrize(
    ("source", "ids"),
    [
        (CAR, ("quadratic_drag@v_b-v_w", "presliding_friction@v_b-v_w")),
        (SHAFT, ("backlash@w_2-w_1",)),
        (DRIVE, ("backlash@motor.fl-load.fl", "quadratic_drag@load.fl-far.fl", "coulomb_friction@load.fl")),
    ],
)
def test_a_written_law_between_two_motions_moves_them_as_judged(source, ids, laws, blocks, tmp_path, rng):
    name = source.split()[1]
    (tmp_path / f"{name}.mo").write_text(source, encoding="utf-8")
    flat = load_flat(name, [tmp_path / f"{name}.mo"])
    agree(name, [tmp_path / f"{name}.mo"], uses_at(flat, laws, *ids), blocks, tmp_path, rng)


def drive(name: str, seed: int) -> Recording:
    """A suspension whose spring stiffens: fourth-order Runge-Kutta, the road in straight lines."""
    rng = np.random.default_rng(seed)
    road = 1.5 * np.convolve(np.cumsum(rng.normal(0.0, 0.004, 700)), np.ones(10) / 10.0, "same")
    steps = 20

    def slope(x, height):
        apart = x[0] - x[2]
        force = K_S * apart + C_S * (x[1] - x[3]) + K_3 * apart**3
        return np.array([x[1], -force / M_B, x[3], (force - K_T * (x[2] - height)) / M_W])

    x, h, read = np.zeros(4), 0.01 / steps, [np.zeros(4)]
    for begin, end in itertools.pairwise(road):
        for k in range(steps):
            at = tuple(begin + (end - begin) * (k + part) / steps for part in (0.0, 0.5, 1.0))
            x = runge_kutta(slope, x, at, h)
        read.append(x)
    seen = np.array(read)[:, [0, 2]] + rng.normal(0.0, 2e-4, (700, 2))
    return Recording(name, 0.01 * np.arange(700), {"road": road}, {"body": seen[:, 0], "wheel": seen[:, 1]})


@pytest.mark.long
def test_a_stiffening_spring_is_found_and_written_into_both_balances(tmp_path):
    (tmp_path / "Car.mo").write_text(CAR, encoding="utf-8")
    settings = LoopSettings(
        max_effects=2, parameters=("k_s", "c_s"),
        laws=("cubic_stiffness", "coulomb_friction", "quadratic_drag"), cache=tmp_path / "fmu",
        fit=FitSettings(method="local", calibration=CalibrationSettings(interpolation="linear")),
    )  # fmt: skip
    result = close_loop([drive("a", 51)], [drive("b", 52)], model=tmp_path / "Car.mo", settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["cubic_stiffness@v_b-v_w"]
    assert result.effects[0].parameters[0].value == pytest.approx(K_3, rel=0.02)
    assert result.parameters["k_s"].value == pytest.approx(K_S, rel=0.02)
    assert all(rms < 1.1 * 2e-4 for rms in result.predicted_after.pooled("test").values())
    assert result.predicted_before.pooled("test")["body"] > 3.0 * 2e-4
    assert result.modelica.count("k_3 * (body - wheel) ^ 3") == 2


def test_a_deflection_whose_rate_is_taken_is_no_storage(tmp_path):
    strut = CAR.replace("f = k_s*(body - wheel) + c_s*(v_b - v_w);", "x = body - wheel;\n  f = k_s*x + c_s*der(x);")
    ports = found(tmp_path, strut.replace("protected", 'protected\n  Real x(unit = "m");'))
    assert {p.id for p in ports.values() if p.attachment == "equation"} == {"v_b", "v_w", "v_b-v_w", "v_w-road"}
    assert ports["v_b-v_w"].signals == {"v": "v_b - v_w", "x": "body - wheel"}
