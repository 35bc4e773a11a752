"""Modelica files that extend a base system with effects that test_effects.py does not have: curves, one motor."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest
from written_effects import write_effects

from aero_bayes.errors import InputError
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.expression import evaluate_nodes

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


def test_base_with_one_motor(tmp_path):
    written = write_effects("Aero.Systems.HalfQuadLinear", {"supply_resistance": {}}, tmp_path)
    assert "thruster_2" not in written.text
    assert len(explicit_model(written.name, [written.path]).states) == 4


def bumps(x: float, heights: list[float]) -> float:
    """Gaussian bumps at equal distances from -1 to 1, as wide as these."""
    places = np.linspace(-1, 1, len(heights))
    return sum(
        c * exp(-0.5 * ((x - x_c) / (places[1] - places[0])) ** 2) for c, x_c in zip(heights, places, strict=True)
    )


#: By curve: its size, and what it is over at the point, for each motor.
CURVES = {
    "electrical_curve@electrical": (1.0, 0.21, -0.17), "rotor_curve@rotor": (1e-3, 0.4, -0.6),
    "thrust_curve@thrust": (0.02, 0.02787, 0.02439), "body_angle_curve@body": (1e-3, 0.33, 0.33),
    "body_rate_curve@body": (1e-3, 0.41, 0.41),
}  # fmt: skip


@pytest.mark.parametrize("curve", [c for c in EVERY if c.law.curve_input], ids=lambda c: c.id)
def test_a_learned_curve_acts_at_its_port(curve, tmp_path):
    size, *over = CURVES[curve.id]
    slow = {"thruster_1.motor.rotor.w": 0.4, "thruster_2.motor.rotor.w": -0.6} if curve.id[:5] == "rotor" else {}
    expected = rates_at(explicit_model("Aero.Systems.OneDof"), slow)
    heights = [size * v for v in (0.3, -0.7, 1.0, 0.2, -0.5, 0.9, 0.1, 0.6, -0.4)[: len(curve.law.parameters)]]
    values = {f"c_{k}": height for k, height in enumerate(heights, 1)}
    written = write_effects("Aero.Systems.OneDof", {curve.id: values}, tmp_path)
    found = rates_at(explicit_model(written.name, [written.path]), slow)
    one, two = (bumps(x, heights) for x in over)  # over a largest value of one, as long as none is set
    where = curve.id.partition("@")[2]
    if where == "thrust":
        thrusts = (2.9e-7 * 310.0**2, 2.9e-7 * 290.0**2)
        expected["body.omega"] += 0.158 * sum(bumps(f, heights) for f in thrusts) / 0.0219
    elif where == "body":
        expected["body.omega"] -= one / 0.0219
    else:
        state, inertia = ("motor.inductor.i", 1.16e-3) if where == "electrical" else ("motor.rotor.w", 8e-6)
        expected[f"thruster_1.{state}"] -= one / inertia
        expected[f"thruster_2.{state}"] -= two / inertia
    for state, value in expected.items():
        assert found[state] == pytest.approx(value, rel=1e-11), state


def test_effects_that_a_package_names_must_be_there(tmp_path):
    package = tmp_path / "Bench"
    package.mkdir()
    (package / "package.mo").write_text(
        "package Bench\n  model Rig\n    extends Aero.Systems.HalfQuad;\n  end Rig;\nend Bench;\n", encoding="utf-8"
    )
    law = 'systems = ["Rig"]\n[effects.rubbing]\nlaw = "coulomb_frictoin@body.flange"\n'
    (package / "package.toml").write_text(law, encoding="utf-8")
    family = ModelicaFamily(LawPlaces("Bench.Rig", (package,)), tmp_path)
    with pytest.raises(InputError, match=r"Bench: effects.rubbing.law: .*did you mean 'coulomb_friction@body.flange"):
        family.places.check()
    (package / "package.toml").write_text(law.replace("toi", "tio"), encoding="utf-8")
    assert [c.id for c in LawPlaces("Bench.Rig", (package,)).candidates] == ["rubbing"]
