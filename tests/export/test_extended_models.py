"""The Modelica files that extend a base system: what they say, and what they compute."""

from __future__ import annotations

from math import tanh
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.errors import InputError
from aero_bayes.export import EffectUse, FreeForm, declaration_of, export_fmu, write_extension
from aero_bayes.export.causalise import ExplicitModel
from aero_bayes.export.embedded import explicit_model
from aero_bayes.export.expression import evaluate

DECLARED = declaration_of("Aero.Systems.OneDof")
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
    numbers = evaluate([*model.rates, *outputs], known)
    return dict(zip([*model.states, "i_m", "omega_m", "theta"], numbers, strict=True))


@pytest.fixture(scope="module")
def base() -> dict[str, float]:
    return rates_at(explicit_model("Aero.Systems.OneDof"), {})


@pytest.mark.parametrize("effect", DECLARED.catalogue, ids=str)
def test_one_effect_in_a_model_of_its_own(effect: str, base: dict[str, float], tmp_path: Path) -> None:
    entry = DECLARED.effect(effect)
    written = write_extension("Aero.Systems.OneDof", [EffectUse(effect)], tmp_path)
    assert written.name == f"OneDof_{effect}"
    assert f"redeclare model {DECLARED.slot_of(entry)} = Aero.{entry.model}" in written.text
    assert written.path.read_text(encoding="utf-8") == written.text
    model = explicit_model(written.name, [written.path])
    off = rates_at(model, {})
    assert {n: off[n] for n in base} == base
    # what a parameter moves must be reached from the top level
    extra = {s: 0.5 for s in model.states if s not in POINT}
    on = rates_at(model, extra | {entry.magnitude.name: entry.magnitude.starts[0]})
    assert on != rates_at(model, extra)


def test_effects_in_one_slot_act_together(base: dict[str, float], tmp_path: Path) -> None:
    uses = [
        EffectUse("cubic_stiffness", {"k_3": 0.01}),
        EffectUse("pivot_coulomb_friction", {"tau_c": 1e-3}, {"w_smooth": 0.3}),
        EffectUse("supply_resistance", {"R_s": 2.0}),
        EffectUse("brush_drop", {"V_b": 0.5}),
    ]
    written = write_extension("Aero.Systems.OneDof", uses, tmp_path, name="Together")
    found = rates_at(explicit_model("Together", [written.path]), {})
    torque = -0.01 * 0.33**3 - 1e-3 * tanh(0.41 / 0.3)
    assert found["body.omega"] == pytest.approx(base["body.omega"] + torque / 0.0219, rel=1e-12)
    drop = 2.0 * 0.21 + 0.5 * tanh(0.21 / 1e-5)
    state = "thruster_1.motor.inductor.i"
    assert found[state] == pytest.approx(base[state] - drop / 1.16e-3, rel=1e-12)


def test_base_with_one_motor(tmp_path: Path) -> None:
    written = write_extension("Aero.Systems.HalfQuadLinear", [EffectUse("supply_resistance")], tmp_path)
    assert "thruster_2" not in written.text
    assert len(explicit_model(written.name, [written.path]).states) == 4


def keys_curve(x: float, low: float, high: float, values: list[float]) -> float:
    """Cubic convolution (Keys 1981) of values that go on as straight lines, by its definition as a sum of kernels."""
    position = (x - low) / (high - low) * (len(values) - 1)
    beyond = int(abs(position)) + len(values)
    first, last = values[1] - values[0], values[-1] - values[-2]
    before = [values[0] - first * k for k in range(beyond, 0, -1)]
    padded = np.array([*before, *values, *(values[-1] + last * (k + 1) for k in range(beyond))])
    total = 0.0
    for k, value in enumerate(padded):
        s = abs(position - (k - beyond))
        if s < 1:
            total += value * (1.5 * s**3 - 2.5 * s**2 + 1)
        elif s < 2:
            total += value * (-0.5 * s**3 + 2.5 * s**2 - 4 * s + 2)
    return total


CURVES = [(c.port, c.over) for c in DECLARED.curves]


@pytest.mark.parametrize(("port", "over"), CURVES)
def test_a_learned_curve_acts_at_its_port(port: str, over: str, base: dict[str, float], tmp_path: Path) -> None:
    at = {"i": 0.21, "w": 310.0, "theta": 0.33, "theta_dot": 0.41}[over]
    mirrored = {"i": -0.17, "w": -290.0}.get(over, at)
    size = {"electrical": 1.0, "rotor": 1e-3, "thrust": 0.02, "body": 1e-3}[port]
    values = [size * v for v in (0.3, -0.7, 1.0, 0.2, -0.5, 0.9)]
    low, high = -1.4 * at, 1.7 * at
    written = write_extension("Aero.Systems.OneDof", [FreeForm(port, over, low, high, tuple(values))], tmp_path)  # type: ignore[arg-type]
    assert [p.name for p in written.parameters] == [f"c_{k}" for k in range(1, 7)]
    found = rates_at(explicit_model(written.name, [written.path]), {})
    one, two = (keys_curve(x, low, high, values) for x in (at, mirrored))
    expected = dict(base)
    inertia = 8e-6
    if port == "electrical":
        expected["thruster_1.motor.inductor.i"] -= one / 1.16e-3
        expected["thruster_2.motor.inductor.i"] -= two / 1.16e-3
    elif port == "rotor":
        expected["thruster_1.motor.rotor.w"] -= one / inertia
        expected["thruster_2.motor.rotor.w"] -= two / inertia
    elif port == "thrust":
        if over == "w":
            expected["body.omega"] -= 0.158 * (one - two) / 0.0219
        else:
            expected["body.omega"] -= 0.158 * one * 2.9e-7 * (310.0**2 + 290.0**2) / 0.0219
    else:
        expected["body.omega"] -= one / 0.0219
    for state, value in expected.items():
        assert found[state] == pytest.approx(value, rel=1e-11), state


@pytest.mark.parametrize("x", [-2.0, -1.0, -0.6, -0.2, 0.1, 0.85, 1.0, 3.0])
def test_curve_passes_through_its_values_and_goes_on_straight(x: float) -> None:
    values = [0.3, -0.7, 1.0, 0.2, -0.5, 0.9]
    assert keys_curve(-5.0, -1.0, 1.0, values) == pytest.approx(0.3 + 10.0)
    for k, value in enumerate(values):
        assert keys_curve(-1.0 + 0.4 * k, -1.0, 1.0, values) == pytest.approx(value)
    constant = keys_curve(x, -1.0, 1.0, [0.7] * 6)
    assert constant == pytest.approx(0.7)


def test_a_curve_and_an_effect_share_the_thrust_slot(tmp_path: Path) -> None:
    uses = [EffectUse("thrust_lag", {"T_f": 0.1}), FreeForm("thrust", "theta", -1.0, 1.0, (0.1, 0.1, 0.1))]
    written = write_extension("Aero.Systems.HalfQuad", uses, tmp_path, name="Shared")
    found = rates_at(explicit_model("Shared", [written.path]), {"thruster_1.thrustEffect.thrust_lag.f": 0.05})
    torque = 0.158 * 0.05 * (1.0 - 0.1) - 0.0071 * 0.41 - 0.0375 * 0.33
    assert found["body.omega"] == pytest.approx(torque / 0.0219, rel=1e-12)


def test_the_exported_parameters_reach_the_effect(tmp_path: Path) -> None:
    from export_driver import driven

    written = write_extension("Aero.Systems.OneDof", [EffectUse("pivot_coulomb_friction", {"tau_c": 7e-4})], tmp_path)
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


@pytest.mark.parametrize(
    ("base_name", "uses", "message"),
    [
        ("Aero.Systems.TransferFunction", [EffectUse("brush_drop")], "no slots"),
        ("Aero.Systems.OneDof", [EffectUse("gremlins")], "unknown effect 'gremlins'"),
        ("Aero.Systems.OneDof", [EffectUse("brush_drop", {"V_x": 1.0})], "'V_x'"),
        ("Aero.Systems.OneDof", [EffectUse("brush_drop", {}, {"w_smooth": 1.0})], "'w_smooth'"),
        ("Aero.Systems.OneDof", [EffectUse("brush_drop"), EffectUse("brush_drop")], "given twice"),
        ("Aero.Systems.OneDof", [FreeForm("body", "i", 0, 1, (0.0, 0.0))], "no learned curve at body over i"),
        ("Aero.Systems.OneDof", [FreeForm("body", "theta", 1, 1, (0.0, 0.0))], "x_min < x_max"),
        ("Aero Systems", [], "not a Modelica model name"),
    ],
)
def test_wrong_requests_are_named(base_name: str, uses: list[EffectUse], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        write_extension(base_name, uses, tmp_path)
    assert list(tmp_path.iterdir()) == []
