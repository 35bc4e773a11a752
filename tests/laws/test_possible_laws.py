"""What is offered: units, the kind of the balance and the range that signals visit decide it."""

from __future__ import annotations

import numpy as np
import pytest
from small_rigs import RIGS, rig

from aero_bayes import Recording, fit, load_model
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.laws.candidates import is_possible, ports_with_laws
from aero_bayes.laws.law import Law
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.loop.nominal_values import share_visited_twice
from aero_bayes.simulation.engines import open_simulator


def of(laws: tuple[Law, ...], kind: str, id_: str) -> Law:
    return next(law for law in laws if (law.kind, law.id) == (kind, id_))


@pytest.mark.parametrize(
    ("unit", "amount"), [("deg", False), ("rpm", False), ("N", False), ("m", True), ("V", True), ("", True)]
)
def test_only_amounts_leak_and_spill(unit, amount, laws, modelica):
    path = modelica(f"""model Lag
  parameter Real T(unit = "s") = 0.1;
  input Real u(unit = "{unit}");
  output Real y(unit = "{unit}");
  Real phi(unit = "{unit}", start = 0, fixed = true);
equation
  T * der(phi) = u - phi;
  y = phi;
end Lag;
""")
    ports = {p.id: p for p in ports_with_laws(rig("Lag", str(path)), laws) if p.kind not in ("input", "output")}
    port = ports["phi"]
    losses = {"linear_loss", "root_loss", "square_loss", "overflow"}
    assert losses <= set(port.laws) if amount else not losses & set(port.laws)
    assert amount or not any(losses & set(p.laws) for p in ports.values())
    assert {"offset", "curve"} <= set(port.laws)


@pytest.mark.parametrize(("unit", "offered"), [("degC", False), ("K", True)])
def test_a_square_of_degrees_celsius_is_no_loss(unit, offered, laws, modelica):
    path = modelica(f"""model Body
  parameter Real C(unit = "J/K") = 10;
  input Real u(unit = "W");
  output Real T(unit = "{unit}", start = 25, fixed = true);
equation
  C * der(T) = u - 0.1 * (T - 25);
end Body;
""")
    (port,) = (p for p in ports_with_laws(rig("Body", str(path)), laws) if p.kind == "storage")
    assert ("square_loss" in port.laws) is offered
    assert {"linear_loss", "radiation"} <= set(port.laws)
    assert not {"overflow", "root_loss"} & set(port.laws)


def test_laws_by_side_need_both_signs_and_readings_without_a_sign_none(laws):
    directions, unsigned = of(laws, "motion", "friction_by_direction"), of(laws, "output", "unsigned")
    spilling, spring = of(laws, "overflow", "overflow"), of(laws, "motion", "cubic_stiffness")
    assert is_possible(directions, {"v_low": -2.0, "v_high": 3.0})
    assert not is_possible(directions, {"v_low": -0.01, "v_high": 3.0})
    assert not is_possible(directions, {"v_low": -3.0, "v_high": 0.0})
    assert is_possible(unsigned, {"u_low": -0.01, "u_high": 3.0})
    assert not is_possible(unsigned, {"u_low": -2.0, "u_high": 3.0})
    assert not is_possible(spilling, {"h_low": -2.0, "h_high": 3.0})
    assert all(is_possible(law, {}) for law in (directions, unsigned, spilling))
    assert is_possible(spring, {"v_low": 0.0, "v_high": 3.0})


def test_a_curve_needs_a_signal_that_comes_back(laws):
    """Over a signal that passes each value once a curve is one over time, and explains anything."""
    t = np.linspace(0.0, 1.0, 500)
    falls, noise = 2.0 - 3.0 * t, 0.01 * np.random.default_rng(1).normal(size=500)
    assert share_visited_twice([falls]) == 0.0
    assert share_visited_twice([falls + noise]) < 0.2
    assert share_visited_twice([np.full(500, 2.0)]) == 0.0
    assert share_visited_twice([np.sin(12.0 * t) + noise]) > 0.9
    assert share_visited_twice([falls, falls + noise]) > 0.9
    assert share_visited_twice([np.concatenate((falls, falls[:300:-1]))]) == pytest.approx(0.4, abs=0.05)
    curve = of(laws, "motion", "curve")
    assert is_possible(curve, {"v_twice": 0.6})
    assert not is_possible(curve, {"v_twice": 0.4})
    assert is_possible(of(laws, "motion", "position_curve"), {"v_twice": 0.4, "x_twice": 0.9})


@pytest.mark.parametrize("bounces", [False, True])
def test_a_contact_yields_only_where_the_motion_turns(bounces, tmp_path):
    """The fit of free fall to a ball that the air slows down throws it upwards first; its readings only fall."""
    path = RIGS / "Falling.mo"
    time = np.arange(60) / 15.0
    height = 50.0 - 20.0 * (time - 2.0 * (1.0 - np.exp(-0.5 * time)))
    if bounces:
        height = 50.0 + 10.0 * time - 4.905 * time**2
    height += 0.02 * np.random.default_rng(4).normal(size=60)
    settings = FitSettings(calibration=CalibrationSettings(initial_states="estimated"))
    run = Recording("run", time, {}, {"height": height})
    found = fit(run, load_model(path), parameters=["g"], settings=settings, seed=1)
    family = ModelicaFamily(LawPlaces("Falling", (path,)), tmp_path / "built")
    ids = family.prepare(found.calibration, found.optimum, open_simulator)
    assert {"viscous_friction@v", "quadratic_drag@v", "coulomb_friction@v"} <= set(ids)
    assert ("rounded_friction@v" in ids) is bounces
    assert ("presliding_friction@v" in ids) is ("friction_by_direction@v" in ids) is bounces


def test_thresholds_lie_within_what_is_visited(laws):
    sizes = dict.fromkeys(("f_n", "v_n", "x_n", "x_w", "t_n", "u_n", "w_n"), 1.0) | {"x_0": 0.0}
    for kind, id_, name in (
        ("input", "dead_zone", "u_d"), ("input", "hysteresis", "u_p"), ("motion", "end_stop", "x_s"),
        ("motion", "presliding_friction", "x_p"), ("motion", "backlash", "x_b"),
    ):  # fmt: skip
        (parameter,) = (p for p in of(laws, kind, id_).parameters if p.name == name)
        assert parameter.value("max", sizes) <= 1.0
        assert parameter.value("nominal", sizes) < parameter.value("max", sizes)
