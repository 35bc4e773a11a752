"""What acts between a state and what is fed in: a moving ambient temperature, a shaken base."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from closed_form import runge_kutta
from test_relative_motions import CAR, found
from written_laws import agree, uses_at

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.modelica.rumoca_front import load_flat

OVEN = """model Oven "An oven in a hall whose temperature is recorded"
  parameter Real C(unit = "J/K", min = 0) = 350;
  parameter Real G(unit = "W/K", min = 0) = 0.8;
  input Real P(unit = "W");
  input Real T_hall(unit = "degC");
  input Real T_set(unit = "K");
  output Real T(unit = "degC", start = 20, fixed = true);
  Real T_wall(unit = "degC", start = 20, fixed = true);
equation
  C*der(T) = P - 2*(T - T_wall);
  4*C*der(T_wall) = 2*(T - T_wall) - G*(T_wall - T_hall);
end Oven;
"""
PLAIN = """model Plain "A vessel with no units, stirred into a stream"
  parameter Real k = 0.5;
  input Real u;
  input Real w;
  output Real y(start = 0, fixed = true);
equation
  der(y) = k*(u - y) + w;
end Plain;
"""
SERVO = """model Servo "An axis that follows a set point"
  parameter Real k = 4;
  input Real phi_set(unit = "rad");
  output Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real e(unit = "rad");
equation
  e = phi_set - phi;
  der(phi) = w;
  0.1*der(w) = k*e - 0.3*w;
end Servo;
"""


ARM = """model Arm "An arm that a controller drives to a goal by a voltage"
  parameter Real k(unit = "V/rad") = 4;
  parameter Real k_m(unit = "N.m/V") = 0.5;
  parameter Real J(unit = "kg.m2") = 0.1;
  parameter Real d(unit = "N.m.s/rad") = 0.3;
  parameter Real c(unit = "N.m/rad") = 0.2;
  input Real goal(unit = "rad");
  output Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real u(unit = "V");
equation
  u = k*(goal - phi);
  der(phi) = w;
  J*der(w) = k_m*u - d*w;
end Arm;
"""


def test_what_a_controller_forms_is_no_place_in_the_mechanics(tmp_path):
    assert not [p for p in found(tmp_path, ARM) if "-" in p]
    sprung = ARM.replace("- d*w", "- d*w - c*(phi - goal)")
    assert "w-goal" in found(tmp_path, sprung)


def test_a_temperature_stands_against_every_one_that_is_fed_in(tmp_path):
    ports = found(tmp_path, OVEN)
    assert {p for p in ports if "-" in p} == {"T-T_hall", "T_wall-T_hall"}
    assert ports["T-T_hall"].signals == {"h": "T", "h_s": "T_hall"}
    assert ports["T-T_hall"].laws == ("linear_loss", "square_loss", "radiation")


def test_without_units_only_a_difference_in_the_model_is_a_place(tmp_path):
    assert {p for p in found(tmp_path, PLAIN) if "-" in p} == {"y-u"}
    assert {p for p in found(tmp_path, CAR) if "-" in p} == {"v_b-v_w", "v_w-road"}
    assert not [p for p in found(tmp_path, SERVO) if "-" in p]


def test_what_one_storage_stands_against_is_there_for_all_of_its_kind(tmp_path):
    two = PLAIN.replace("  input Real u;", "  Real z(start = 0, fixed = true);\n  input Real u;")
    ports = found(tmp_path, two.replace("+ w;", "+ w;\n  der(z) = w - 2*z;"))
    assert {p for p in ports if "-" in p} == {"y-u", "z-u"}
    assert ports["z-u"].laws == ("linear_loss", "root_loss", "square_loss")


def test_a_tyre_on_the_road_has_laws_of_its_deflection_only(tmp_path):
    tyre = found(tmp_path, CAR)["v_w-road"]
    assert tyre.signals == {"x": "wheel - road"}
    assert {"cubic_stiffness", "end_stop"} <= set(tyre.laws)
    assert not {"offset", "viscous_friction", "coulomb_friction"} & set(tyre.laws)


@pytest.mark.parametrize(
    ("source", "ids"),
    [
        (OVEN, ("lag@output_T", "radiation@T_wall-T_hall", "offset@T_hall")),
        (OVEN, ("offset@T_hall", "linear_loss@T-T_hall")),
        (PLAIN, ("square_loss@y-u", "gain@u")),
        (CAR, ("cubic_stiffness@v_w-road",)),
    ],
)
def test_what_is_written_moves_like_what_was_judged(source, ids, laws, blocks, tmp_path, rng):
    name = source.split()[1]
    (tmp_path / f"{name}.mo").write_text(source, encoding="utf-8")
    flat = load_flat(name, [tmp_path / f"{name}.mo"])
    agree(name, [tmp_path / f"{name}.mo"], uses_at(flat, laws, *ids), blocks, tmp_path, rng)


C, G, LOSS, STEP = 300.0, 1.0, 0.02, 10.0


def bake(name: str, seed: int) -> Recording:
    """An oven that loses by the square of what it is warmer than the hall: fourth-order Runge-Kutta; power in steps."""
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0.0, 120.0, 30), 20)
    hall = 20.0 + np.convolve(np.cumsum(rng.normal(0.0, 0.8, 600)), np.ones(25) / 25.0, "same")
    hall += 20.0 - hall[0]

    def slope(x, u):
        above = x[0] - u[1]
        flow = 2.0 * (x[0] - x[1])
        lost = G * (x[1] - u[1])
        return np.array([(u[0] - flow - LOSS * above * abs(above)) / C, (flow - lost) / (4.0 * C)])

    x, read, steps = np.full(2, 20.0), [np.full(2, 20.0)], 5
    for held, (begin, end) in zip(power, itertools.pairwise(hall), strict=False):
        for k in range(steps):
            at = tuple((held, begin + (end - begin) * (k + part) / steps) for part in (0.0, 0.5, 1.0))
            x = runge_kutta(slope, x, at, STEP / steps)
        read.append(x)
    seen = np.array(read)[:, 0] + rng.normal(0.0, 0.05, 600)
    inputs = {"P": power, "T_hall": hall, "T_set": np.full(600, 300.0)}
    return Recording(name, STEP * np.arange(600), inputs, {"T": seen})


@pytest.mark.long
def test_a_loss_to_a_hall_is_found_against_its_recorded_temperature(tmp_path):
    (tmp_path / "Oven.mo").write_text(OVEN, encoding="utf-8")
    settings = LoopSettings(
        max_effects=2, parameters=("C", "G"),
        laws=("linear_loss", "square_loss", "radiation", "offset", "gain"), cache=tmp_path / "fmu",
        fit=FitSettings(method="local", calibration=CalibrationSettings(interpolation={"T_hall": "linear"})),
    )  # fmt: skip
    result = close_loop([bake("a", 71)], [bake("b", 72)], model=tmp_path / "Oven.mo", settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["square_loss@T-T_hall"]
    loss, capacity = result.effects[0].parameters[0], result.parameters["C"]
    assert loss.value == pytest.approx(LOSS, abs=4 * loss.sd)
    assert capacity.value == pytest.approx(C, abs=4 * capacity.sd)
    assert (
        result.predicted_after.pooled("test")["T"]
        < 1.1 * 0.05
        < 3.0 * 0.05
        < result.predicted_before.pooled("test")["T"]
    )
    assert "(T - T_hall) * abs(T - T_hall)" in result.modelica


def test_a_unit_that_is_declared_for_one_of_a_sum_holds_for_all_of_it(tmp_path):
    bare = OVEN.replace('Real T_wall(unit = "degC", ', "Real T_wall(").replace('T(unit = "degC", ', "T(")
    ports = found(tmp_path, bare)
    assert {p for p in ports if "-" in p} == {"T-T_hall", "T_wall-T_hall"}
    assert {ports[p].units["h"] for p in ("T", "T_wall", "T-T_hall")} == {"degC"}
    assert "radiation" in ports["T"].laws
    mixed = bare.replace("T_hall);", "T_hall) + 0*(T_hall - T_set);")
    assert found(tmp_path, mixed)["T"].units["h"] == ""
