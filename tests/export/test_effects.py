"""Every effect: nothing where it is switched off, and the formula of its description where it is on."""

from __future__ import annotations

from math import cos, sqrt, tanh

import fmpy
import numpy as np
import pytest
from export_driver import driven
from fmpy.validation import validate_fmu
from hand_written_aero import NOMINAL, SCALES, STATES

from aero_bayes.modelica.library import declaration_of
from aero_bayes.structure.law_places import LawPlaces

#: A magnitude for each switching parameter, and the second parameters.
ON = {
    "R_s": 1.3, "V_b": 0.7, "r_h": 25.0, "V_dz": 0.6, "s_sat": 0.08, "tau_r": 8e-4, "d_r": 3e-6, "k_v": 2e-4,
    "T_f": 0.12, "a_f": -0.2, "tau_c": 1.1e-3, "c_b": 4e-3, "tau_g": -9e-4, "k_3": 6e-3, "b_i": 0.02, "T_w": 0.04,
    "T_d": 0.03, "b_th": -0.015, "tau_p": 9e-4,
}  # fmt: skip

#: What the catalogue promises where nothing is switched on: zero for each of ON, a bound for the shapes.
EFFECTS = [c for c in LawPlaces("Aero.Systems.OneDof").candidates if c.alias]
STARTS = {id_: effect.starts for id_, effect in declaration_of("Aero.Systems.OneDof").effects.items()}
DEFAULTS = {p.name: p.value("default", {}) for effect in EFFECTS for p in effect.law.parameters}

EXTRA = (
    "thruster_1.electricalEffect.winding_heating.h", "thruster_1.thrustEffect.thrust_lag.f", "speedSensor.q",
    "pitchSensor.pitch_delay.q", "pitchSensor.pitch_delay.dq", "thruster_2.electricalEffect.winding_heating.h",
    "thruster_2.thrustEffect.thrust_lag.f", "bodyEffect.pivot_presliding_friction.z",
)  # fmt: skip
PATHS = {
    "i_m": "thruster_1.motor.inductor.i", "omega_m": "thruster_1.motor.rotor.w", "theta": "body.theta",
}  # fmt: skip


def draw(rng: np.random.Generator, names: list[str]) -> dict[str, float]:
    scale = dict(zip(STATES, SCALES, strict=True))
    scale |= {path: scale[short] for short, path in PATHS.items()}
    scale |= dict(zip(EXTRA, (1.0, 0.1, 100.0, 1.0, 10.0, 1.0, 0.1, 0.5), strict=True))
    return {n: float(rng.normal() * scale[n]) for n in names}


def with_effects(x: dict[str, float], v: float, on: dict[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Rates and outputs of OneDof with the effects of ``on``, by hand and in the smooth forms that are documented."""
    e = DEFAULTS | on
    p = NOMINAL
    rate, theta = x["body.omega"], x["body.theta"]
    rates: dict[str, float] = {}
    torque = 0.0
    for k, side in ((1, 1.0), (2, -1.0)):
        i, w = x[f"thruster_{k}.motor.inductor.i"], x[f"thruster_{k}.motor.rotor.w"]
        heat = x[f"thruster_{k}.electricalEffect.winding_heating.h"]
        f_late = x[f"thruster_{k}.thrustEffect.thrust_lag.f"]
        u = side * v
        d, eps = e["V_dz"], 0.01
        u += 0.5 * (sqrt((u - d) ** 2 + eps**2) - sqrt((u + d) ** 2 + eps**2))
        s, knee = e["s_sat"], 1e-3
        u *= 2 * sqrt(1 + knee**2) / (sqrt((1 + s * u) ** 2 + knee**2) + sqrt((1 - s * u) ** 2 + knee**2))
        u -= e["R_s"] * i + e["V_b"] * tanh(i / 1e-5) + e["r_h"] * heat * i
        rates[f"thruster_{k}.electricalEffect.winding_heating.h"] = (i * i - heat) / e["T_h"]
        rates[f"thruster_{k}.motor.inductor.i"] = (u - p["R_a"] * i - p["c_m"] * w) / p["L_a"]
        brake = p["k_d"] * w * abs(w) + e["tau_r"] * tanh(w / 0.05) + e["d_r"] * w
        rates[f"thruster_{k}.motor.rotor.w"] = (p["c_m"] * i - brake) / (p["J_r"] + p["J_s"])
        f = p["k_t"] * w * abs(w) - e["k_v"] * abs(w) * side * p["D_t"] * rate
        t = max(e["T_f"], 1e-3)
        rates[f"thruster_{k}.thrustEffect.thrust_lag.f"] = (f - f_late) / t
        f -= e["T_f"] / t * (f - f_late)
        f *= 1 + e["a_f"] * tanh(side * f / 1e-4)
        torque += side * p["D_t"] * f
    torque += e["tau_g"] * cos(theta) - e["tau_c"] * tanh(rate / 2e-5)
    bend = x["bodyEffect.pivot_presliding_friction.z"]
    torque -= e["tau_p"] * bend
    rates["bodyEffect.pivot_presliding_friction.z"] = (rate - sqrt(rate**2 + e["w_p"] ** 2) * bend) / e["theta_p"]
    torque -= e["c_b"] * rate * abs(rate) + e["k_3"] * theta**3
    rates["body.theta"] = rate
    rates["body.omega"] = (torque - p["D_p"] * rate - p["K_sp"] * theta) / p["J_p"]
    t = max(e["T_w"], 1e-3)
    rates["speedSensor.q"] = (rates["thruster_1.motor.rotor.w"] - x["speedSensor.q"]) / t
    t = max(e["T_d"], 2e-3)
    q, dq = x["pitchSensor.pitch_delay.q"], x["pitchSensor.pitch_delay.dq"]
    rates["pitchSensor.pitch_delay.q"] = dq
    rates["pitchSensor.pitch_delay.dq"] = (12 * (rate - q) - 6 * t * dq) / t**2
    outputs = {
        "i_m": x["thruster_1.motor.inductor.i"] + e["b_i"],
        "omega_m": x["thruster_1.motor.rotor.w"] - e["T_w"] * x["speedSensor.q"],
        "theta": theta - e["T_d"] * q + e["b_th"],
    }
    return rates, outputs


def test_the_screening_model_is_a_valid_fmu(screening_fmu):
    assert validate_fmu(str(screening_fmu)) == []


def test_every_effect_has_its_parameters_at_the_top_level(screening_fmu):
    with driven(screening_fmu) as fmu:
        for effect in EFFECTS:
            assert fmu.starts[effect.law.magnitude.name] == 0.0
            for p in effect.law.parameters:
                low, high = (p.value(k, {}) if k in p.terms else e for k, e in (("min", -np.inf), ("max", np.inf)))
                default = p.value("default", {})
                assert p.name in fmu.parameters
                assert low <= default <= high
                assert all(low <= s <= high for s in STARTS[effect.id].get(p.name, ()))
        assert set(ON) == {e.law.magnitude.name for e in EFFECTS}


def test_switched_off_all_together_they_change_nothing(screening_fmu, aero_fmu):
    rng = np.random.default_rng(3)
    with driven(screening_fmu) as fmu, driven(aero_fmu("OneDof")) as base:
        fmu.begin()
        base.begin()
        for _ in range(20):
            x = draw(rng, fmu.states)
            inner = {s: x[PATHS.get(s, s)] for s in base.states}
            for f in (fmu, base):
                f.set(V_m=13.7)
            rates = dict(zip(fmu.states, fmu.rhs(np.array([x[s] for s in fmu.states])), strict=True))
            expected = base.rhs(np.array([inner[s] for s in base.states]))
            found = np.array([rates[PATHS.get(s, s)] for s in base.states])
            # equal but for the order in which terms are added
            np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-15 * np.abs(expected).max())
            assert np.array_equal(fmu.get("i_m", "omega_m", "theta"), [inner[s] for s in ("i_m", "omega_m", "theta")])


CASES = [{n: v} for n, v in ON.items()] + [
    {"tau_p": 2e-3, "theta_p": 1e-3, "w_p": 1e-4},
    ON,
    {"T_w": 4e-4, "T_f": 3e-4, "T_d": 1e-3},
]


@pytest.mark.parametrize("on", CASES, ids=lambda c: "_".join(c) if len(c) < 4 else "all")
def test_an_effect_follows_its_formula(screening_fmu, on):
    rng = np.random.default_rng(4)
    with driven(screening_fmu) as fmu:
        fmu.begin()
        fmu.set_all(on)
        changed = False
        for _ in range(8):
            x = draw(rng, fmu.states)
            v = float(rng.uniform(-24, 24))
            fmu.set(V_m=v)
            expected, outputs = with_effects(x, v, on)
            without = with_effects(x, v, {})
            changed = changed or expected != without[0] or outputs != without[1]
            rates = fmu.rhs(np.array([x[s] for s in fmu.states]))
            wanted = np.array([expected[s] for s in fmu.states])
            np.testing.assert_allclose(rates, wanted, rtol=1e-11, atol=1e-12 * np.abs(wanted).max())
            np.testing.assert_allclose(fmu.get(*outputs), list(outputs.values()), rtol=1e-13, atol=1e-15)
        assert changed


def test_derivatives_by_the_effects_parameters(screening_fmu):
    rng = np.random.default_rng(5)
    with driven(screening_fmu) as fmu:
        fmu.begin()
        fmu.set_all(ON | {"V_m": 9.0})
        x = np.array(list(draw(rng, fmu.states).values()))
        unknown = [*fmu.rates, "i_m", "omega_m", "theta"]
        for name, value in ON.items():
            h = 1e-6 * abs(value)
            values = []
            for sign in (1, -1):
                fmu.set_all({name: value + sign * h})
                values.append(np.concatenate([fmu.rhs(x), fmu.get("i_m", "omega_m", "theta")]))
            fmu.set_all({name: value})
            fmu.move(x)
            expected = (values[0] - values[1]) / (2 * h)
            tolerance = 1e-8 * np.abs(values[0]).max() / abs(value) + 1e-9 * np.abs(expected).max()
            np.testing.assert_allclose(fmu.slope(unknown, name), expected, rtol=1e-5, atol=tolerance)


def test_a_delay_delays_and_a_lag_lags(screening_fmu):
    # a slow sine of the voltage: the readings with and without, shifted by hand
    time = np.arange(0, 12.0, 0.01)
    signal = np.zeros(len(time), dtype=[("time", "f8"), ("V_m", "f8")])
    signal["time"], signal["V_m"] = time, 8.0 * np.sin(1.5 * time) ** 2
    runs = [
        fmpy.simulate_fmu(
            str(screening_fmu), input=signal, start_values=start, stop_time=12.0, output_interval=0.01,
            relative_tolerance=1e-8, output=["theta", "omega_m"], fmi_type="CoSimulation",
        )
        for start in ({}, {"T_d": 0.05, "T_w": 0.05})
    ]  # fmt: skip
    t = runs[0]["time"]
    late = t > 1.0
    shifted = np.interp(t - 0.05, t, runs[0]["theta"])
    np.testing.assert_allclose(runs[1]["theta"][late], shifted[late], atol=2e-5)
    lagged = np.zeros(len(t))
    decay = np.exp(-0.01 / 0.05)
    for k in range(1, len(t)):
        middle = 0.5 * (runs[0]["omega_m"][k] + runs[0]["omega_m"][k - 1])
        lagged[k] = decay * lagged[k - 1] + (1 - decay) * middle
    np.testing.assert_allclose(runs[1]["omega_m"][late], lagged[late], atol=0.02 * np.abs(lagged).max())
