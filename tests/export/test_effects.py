"""Every effect of the AERO: nothing where it is off, and the formula of its law at its place where it is on."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sqrt, tanh

import numpy as np
import pytest
from export_driver import driven
from fmpy.validation import validate_fmu
from hand_written_aero import NOMINAL, SCALES
from written_effects import placed_effects, write_effects

from aero_bayes.errors import InputError
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.library import declaration_of

EFFECTS = declaration_of("Aero.Systems.OneDof").effects
#: A magnitude for the first parameter of each effect that is no curve; at sizes of one.
ON = {
    "supply_resistance": 1.3, "brush_drop": 0.7, "winding_heating": 25.0, "amplifier_deadzone": 0.6,
    "amplifier_saturation": 0.08, "rotor_coulomb_friction": 8e-4, "rotor_viscous_friction": 3e-6,
    "thrust_inflow_loss": 2e-4, "thrust_lag": 0.12, "thrust_asymmetry": -0.2, "pivot_coulomb_friction": 1.1e-3,
    "body_quadratic_drag": 4e-3, "gravity_offset": -9e-4, "cubic_stiffness": 6e-3, "current_offset": 0.02,
    "speed_lag": 0.04, "pitch_delay": 0.03, "pitch_offset": -0.015, "pivot_presliding_friction": 9e-4,
}  # fmt: skip
OF = {p.id: p for p in placed_effects("Aero.Systems.OneDof", EFFECTS)}
PATHS = {"i_m": "thruster_1.motor.inductor.i", "omega_m": "thruster_1.motor.rotor.w", "theta": "body.theta"}


def own(id_: str, state: str, motor: int = 1) -> str:
    """The name of a law's own state."""
    return f"{OF[id_].parts[motor - 1].instance}.{state}"


EXTRA = {
    own("winding_heating", "s"): 1.0, own("winding_heating", "s", 2): 1.0, own("thrust_lag", "z"): 0.1,
    own("thrust_lag", "z", 2): 0.1, own("pivot_presliding_friction", "z"): 0.5, own("speed_lag", "q"): 100.0,
} | {own("pitch_delay", state): 1.0 for state in "qprs"}  # fmt: skip


def draw(rng: np.random.Generator, names: list[str]) -> dict[str, float]:
    scale = SCALES | {path: SCALES[short] for short, path in PATHS.items()} | EXTRA
    return {n: float(rng.normal() * scale[n]) for n in names}


def state_of(x: dict[str, float], path: str) -> float:
    """A state under its own name or that of the output that it was."""
    return next(x[n] for n in (path, *(short for short, p in PATHS.items() if p == path)) if n in x)


def time_in_use(given: float, least: float) -> float:
    return (given**4 + least**4) ** 0.25 if given > 0.0 else 1e6


def with_effects(x: dict[str, float], v: float, on: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Rates and outputs of OneDof with the effects of ``on``, by hand and in the smooth forms that are documented."""
    e = dict.fromkeys(ON, 0.0) | on

    p = NOMINAL
    rate, theta = x["body.omega"], state_of(x, "body.theta")
    rates: dict[str, float] = {}
    torque = 0.0
    for k, side in ((1, 1.0), (2, -1.0)):
        i, w = state_of(x, f"thruster_{k}.motor.inductor.i"), state_of(x, f"thruster_{k}.motor.rotor.w")
        heat, late = x[own("winding_heating", "s", k)], x[own("thrust_lag", "z", k)]
        u = side * v
        d, eps = e["amplifier_deadzone"], 1e-3
        u += 0.5 * (sqrt((u - d) ** 2 + eps**2) - sqrt((u + d) ** 2 + eps**2))
        s, knee = e["amplifier_saturation"], 1e-3
        u *= 2 * sqrt(1 + knee**2) / (sqrt((1 + s * u) ** 2 + knee**2) + sqrt((1 - s * u) ** 2 + knee**2))
        u -= e["supply_resistance"] * i + e["brush_drop"] * tanh(i / 2e-5) + e["winding_heating"] * heat * i
        rates[own("winding_heating", "s", k)] = (i * i - heat) / 10.0
        rates[f"thruster_{k}.motor.inductor.i"] = (u - p["R_a"] * i - p["c_m"] * w) / p["L_a"]
        brake = p["k_d"] * w * abs(w) + e["rotor_coulomb_friction"] * tanh(w / 2e-5) + e["rotor_viscous_friction"] * w
        rates[f"thruster_{k}.motor.rotor.w"] = (p["c_m"] * i - brake) / (p["J_r"] + p["J_s"])
        f = side * p["k_t"] * w * abs(w)
        f -= e["thrust_inflow_loss"] * abs(w) * p["D_t"] * rate
        t = time_in_use(e["thrust_lag"], 1e-3)
        rates[own("thrust_lag", "z", k)] = (f - late) / t
        f -= e["thrust_lag"] / t * (f - late)
        f *= 1 + e["thrust_asymmetry"] * tanh(f / 1e-3)
        torque += p["D_t"] * f
    torque += e["gravity_offset"] * cos(theta) - e["pivot_coulomb_friction"] * tanh(rate / 2e-5)
    bend = x[own("pivot_presliding_friction", "z")]
    torque -= e["pivot_presliding_friction"] * bend
    rates[own("pivot_presliding_friction", "z")] = (rate - sqrt(rate**2 + 5e-5**2) * bend) / 6e-4
    torque -= e["body_quadratic_drag"] * rate * abs(rate) + e["cubic_stiffness"] * theta**3
    rates["body.theta"] = rate
    rates["body.omega"] = (torque - p["D_p"] * rate - p["K_sp"] * theta) / p["J_p"]
    t, q = time_in_use(e["speed_lag"], 1e-3), x[own("speed_lag", "q")]
    rates[own("speed_lag", "q")] = ((t * rates["thruster_1.motor.rotor.w"] if e["speed_lag"] > 0.0 else 0.0) - q) / t
    omega = state_of(x, "thruster_1.motor.rotor.w") - e["speed_lag"] / t * q
    t = time_in_use(e["pitch_delay"], 2e-3)
    q, p_, r, s = (x[own("pitch_delay", name)] for name in "qprs")
    moved = t * rate if e["pitch_delay"] > 0.0 else 0.0
    rates |= {own("pitch_delay", n): value / t for n, value in zip("qpr", (p_, r, s), strict=True)}
    rates[own("pitch_delay", "s")] = (1680 * (moved - q) - 840 * p_ - 180 * r - 20 * s) / t
    outputs = {
        "i_m": state_of(x, "thruster_1.motor.inductor.i") + e["current_offset"], "omega_m": omega,
        "theta": theta - e["pitch_delay"] / t * (q + r / 42) + e["pitch_offset"],
    }  # fmt: skip
    return rates, outputs


def test_each_effect_is_a_law_of_the_library_or_one_of_three_of_its_own():
    own_laws = {c.law.model for c in OF.values() if c.law.model.startswith("Aero.")}
    assert own_laws == {"Aero.Effects.ThrustAsymmetry", "Aero.Effects.ThrustInflowLoss", "Aero.Effects.GravityOffset"}
    assert set(ON) == {id_ for id_, p in OF.items() if not p.law.curve_input}
    assert {c.id for c in LawPlaces("Aero.Systems.HalfQuad").candidates} == set(OF)


def test_the_screening_model_is_a_valid_fmu(screening_fmu):
    assert validate_fmu(str(screening_fmu)) == []
    with driven(screening_fmu) as fmu:
        assert all(fmu.starts[p.names[p.law.magnitude.name]] == 0.0 for p in OF.values())


@pytest.mark.parametrize(
    "on", [{}, *({n: v} for n, v in ON.items()), ON], ids=lambda on: "all" if on is ON else "_".join(on)
)
def test_an_effect_follows_its_formula(screening_fmu, on):
    rng = np.random.default_rng(4)
    with driven(screening_fmu) as fmu:
        fmu.begin()
        fmu.set_all({OF[id_].names[OF[id_].law.parameters[0].name]: value for id_, value in on.items()})
        changed = not on
        for _ in range(8):
            x = draw(rng, fmu.states)
            v = float(rng.uniform(-24, 24))
            fmu.set(V_m=v)
            expected, outputs = with_effects(x, v, on)
            without = with_effects(x, v, {})
            changed = changed or expected != without[0] or outputs != without[1]
            rates = fmu.rhs(np.array([x[s] for s in fmu.states]))
            wanted = np.array([state_of(expected, PATHS.get(s, s)) for s in fmu.states])
            np.testing.assert_allclose(rates, wanted, rtol=1e-11, atol=1e-12 * np.abs(wanted).max())
            np.testing.assert_allclose(fmu.get(*outputs), list(outputs.values()), rtol=1e-13, atol=1e-15)
        assert changed


def test_base_with_one_motor(tmp_path):
    written = write_effects("Aero.Systems.HalfQuadLinear", {"supply_resistance": {}}, tmp_path)
    assert "thruster_2" not in written.text
    assert len(explicit_model(written.name, [written.path]).states) == 4


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
