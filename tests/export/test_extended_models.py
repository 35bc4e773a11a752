"""The Modelica files that extend a base system: what they say, and what they compute."""

from __future__ import annotations

from math import exp, tanh

import numpy as np
import pytest
from written_effects import write_effects

from aero_bayes.errors import InputError
from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.structure.law_places import LawPlaces
from aero_bayes.structure.modelica_family import ModelicaFamily

EVERY = LawPlaces("Aero.Systems.OneDof").candidates
POINT = {
    "thruster_1.motor.inductor.i": 0.21, "thruster_1.motor.rotor.w": 310.0, "thruster_2.motor.inductor.i": -0.17,
    "thruster_2.motor.rotor.w": -290.0, "body.theta": 0.33, "body.omega": 0.41,
}  # fmt: skip


def rates_at(model: ExplicitModel, values: dict[str, float]) -> dict[str, float]:
    """Rates and outputs at a point; parameters at their defaults where not given, other states at zero."""
    b = model.system.builder
    known = {
        b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"
    }
    known |= {b.symbol(v.name): 0.0 for v in model.system.inputs}
    known |= {b.symbol(s): 0.0 for s in model.states}
    known |= {b.symbol(n): v for n, v in (POINT | {"V_m": 11.0} | values).items()}
    outputs = [model.solved.get(o, b.symbol(o)) for o in ("i_m", "omega_m", "theta")]
    numbers = evaluate_nodes([*model.rates, *outputs], known)
    return dict(zip([*model.states, "i_m", "omega_m", "theta"], numbers, strict=True))


@pytest.fixture(scope="module")
def base() -> dict[str, float]:
    return rates_at(explicit_model("Aero.Systems.OneDof"), {})


@pytest.mark.parametrize("effect", [c for c in EVERY if c.alias], ids=lambda c: c.id)
def test_one_effect_in_a_model_of_its_own(effect, base, tmp_path):
    written = write_effects("Aero.Systems.OneDof", {effect.id: {}}, tmp_path)
    assert written.name == f"OneDof_{effect.id}"
    assert effect.port.replaceable is not None
    assert f"redeclare model {effect.port.replaceable.name} = {effect.law.model}" in written.text
    assert written.path.read_text(encoding="utf-8") == written.text
    model = explicit_model(written.name, [written.path])
    off = rates_at(model, {})
    assert {n: off[n] for n in base} == base
    # what a parameter moves must be reached from the top level
    extra = {s: 0.5 for s in model.states if s not in POINT}
    on = rates_at(model, extra | {effect.law.magnitude.name: effect.law.magnitude.value("nominal", {})})
    assert on != rates_at(model, extra)


def test_effects_at_one_place_act_together(base, tmp_path):
    effects = {
        "cubic_stiffness": {"k_3": 0.01}, "pivot_coulomb_friction": {"tau_c": 1e-3},
        "supply_resistance": {"R_s": 2.0}, "brush_drop": {"V_b": 0.5},
    }  # fmt: skip
    written = write_effects("Aero.Systems.OneDof", effects, tmp_path, "Together")
    found = rates_at(explicit_model("Together", [written.path]), {})
    torque = -0.01 * 0.33**3 - 1e-3 * tanh(0.41 / 2e-5)
    assert found["body.omega"] == pytest.approx(base["body.omega"] + torque / 0.0219, rel=1e-12)
    drop = 2.0 * 0.21 + 0.5 * tanh(0.21 / 1e-5)
    state = "thruster_1.motor.inductor.i"
    assert found[state] == pytest.approx(base[state] - drop / 1.16e-3, rel=1e-12)


def test_base_with_one_motor(tmp_path):
    written = write_effects("Aero.Systems.HalfQuadLinear", {"supply_resistance": {}}, tmp_path)
    assert "thruster_2" not in written.text
    assert len(explicit_model(written.name, [written.path]).states) == 4


CURVES = [c for c in EVERY if c.law.curve_input]
#: What each is over at the point, for each motor.
OVER = {
    "electrical_curve": (0.21, -0.17), "electrical_speed_curve": (310.0, -290.0), "rotor_curve": (310.0, -290.0),
    "rotor_current_curve": (0.21, -0.17), "thrust_curve": (310.0, -290.0), "thrust_angle_curve": (0.33, 0.33),
    "thrust_rate_curve": (0.158 * 0.41, -0.158 * 0.41), "body_angle_curve": (0.33, 0.33),
    "body_rate_curve": (0.41, 0.41),
}  # fmt: skip


def bumps(x: float, heights: list[float]) -> float:
    """Gaussian bumps a quarter wide at nine places from -1 to 1."""
    return sum(
        c * exp(-0.5 * ((x - place) / 0.25) ** 2) for c, place in zip(heights, np.linspace(-1, 1, 9), strict=True)
    )


@pytest.mark.parametrize("curve", CURVES, ids=lambda c: c.id)
def test_a_learned_curve_acts_at_its_port(curve, base, tmp_path):
    law, port = curve.law.id, curve.port.id
    size = {"electrical": 1.0, "rotor": 1e-3, "thrust": 0.02, "body": 1e-3}[port]
    heights = [size * v for v in (0.3, -0.7, 1.0, 0.2, -0.5, 0.9, 0.1, 0.6, -0.4)]
    values = {f"c_{k}": height for k, height in enumerate(heights, 1)}
    written = write_effects("Aero.Systems.OneDof", {curve.id: values}, tmp_path)
    found = rates_at(explicit_model(written.name, [written.path]), {})
    one, two = (bumps(x, heights) for x in OVER[law])  # over a largest value of one, as long as none is set
    expected = dict(base)
    inertia = 8e-6
    if port == "electrical":
        expected["thruster_1.motor.inductor.i"] -= one / 1.16e-3
        expected["thruster_2.motor.inductor.i"] -= two / 1.16e-3
    elif port == "rotor":
        expected["thruster_1.motor.rotor.w"] -= one / inertia
        expected["thruster_2.motor.rotor.w"] -= two / inertia
    elif law == "thrust_curve":
        expected["body.omega"] -= 0.158 * (one - two) / 0.0219
    elif port == "thrust":
        expected["body.omega"] -= 0.158 * 2.9e-7 * (one * 310.0**2 + two * 290.0**2) / 0.0219
    else:
        expected["body.omega"] -= one / 0.0219
    for state, value in expected.items():
        assert found[state] == pytest.approx(value, rel=1e-11), state


def test_a_curve_and_an_effect_act_at_the_same_place(tmp_path):
    level = {f"c_{k}": 0.1 for k in range(1, 10)}
    effects = {"thrust_lag": {"T_f": 0.1}, "thrust_angle_curve@thrust": level}
    written = write_effects("Aero.Systems.HalfQuad", effects, tmp_path, "Shared")
    found = rates_at(explicit_model("Shared", [written.path]), {"thruster_1.thrustEffect.thrust_lag.f": 0.05})
    torque = 0.158 * 0.05 * (1.0 - bumps(0.33, [0.1] * 9)) - 0.0071 * 0.41 - 0.0375 * 0.33
    assert found["body.omega"] == pytest.approx(torque / 0.0219, rel=1e-12)


def test_the_exported_parameters_reach_the_effect(tmp_path):
    from export_driver import driven

    written = write_effects("Aero.Systems.OneDof", {"pivot_coulomb_friction": {"tau_c": 7e-4}}, tmp_path)
    path = export_fmu(written.name, tmp_path / "x.fmu", compiler="embedded", sources=[written.path])
    with driven(path) as fmu:
        fmu.begin()
        assert fmu.starts["tau_c"] == 7e-4
        x = np.zeros(6)
        x[fmu.states.index("body.omega")] = 0.1
        rate = fmu.states.index("body.omega")
        assert fmu.rhs(x)[rate] == pytest.approx(-(7e-4 + 0.0071 * 0.1) / 0.0219, rel=1e-12)
        fmu.set(tau_c=0.0)
        assert fmu.rhs(x)[rate] == pytest.approx(-0.0071 * 0.1 / 0.0219, rel=1e-12)
        fmu.set_all({"tau_c": 7e-4, "bodyEffect.w_smooth": 0.1})
        assert fmu.rhs(x)[rate] == pytest.approx(-(7e-4 * tanh(1.0) + 0.0071 * 0.1) / 0.0219, rel=1e-12)


def test_effects_that_a_package_names_must_be_there(tmp_path):
    package = tmp_path / "Bench"
    package.mkdir()
    (package / "package.mo").write_text(
        "package Bench\n  model Rig\n    extends Aero.Systems.HalfQuad;\n  end Rig;\nend Bench;\n", encoding="utf-8"
    )
    law = 'systems = ["Rig"]\n[effects.rubbing]\nlaw = "pivot_coulomb_frictoin@body_effect"\n'
    (package / "package.toml").write_text(law, encoding="utf-8")
    family = ModelicaFamily(LawPlaces("Bench.Rig", (package,)), tmp_path)
    with pytest.raises(InputError, match=r"Bench: effects.rubbing.law: .*did you mean 'pivot_coulomb_friction@body_ef"):
        family.places.check()
    (package / "package.toml").write_text(law.replace("toi", "tio"), encoding="utf-8")
    assert [c.id for c in LawPlaces("Bench.Rig", (package,)).candidates if not c.law.curve_input] == ["rubbing"]
