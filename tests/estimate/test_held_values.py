"""Values that stand for a sum with one that is held, and starts of states that the model fixes wrongly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import aero_bayes
from aero_bayes import CalibrationSettings, FitSettings, Recording
from aero_bayes.estimate.held_starts import held_starts
from aero_bayes.estimate.held_values import searched_too
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.initial_states import state_sizes

ROTOR = """
model Rotor "A rotor and what turns with it"
  parameter Real J_r(unit = "kg.m2") = 3e-6 "Rotor";
  parameter Real J_s(unit = "kg.m2") = 4e-6 "What turns with it";
  parameter Real d(unit = "N.m.s/rad") = 2e-5 "Friction";
  parameter Real k(unit = "1") = 1.0 "Gain of the drive";
  input Real M(unit = "N.m");
  output Real speed(unit = "rad/s");
  Real w(unit = "rad/s", start = 0, fixed = true);
equation
  (J_r + J_s) * der(w) = k * M - d * w;
  speed = w;
end Rotor;
"""
ROOM = """
model Walls "Air and walls of a room; the air is read"
  parameter Real C_a(unit = "J/K") = 1e6;
  parameter Real C_w(unit = "J/K") = 1.5e7;
  parameter Real R_aw(unit = "K/W") = 0.004;
  parameter Real R_wo(unit = "K/W") = 0.01;
  input Real Q(unit = "W");
  input Real T_out(unit = "K");
  output Real T(unit = "K");
  Real T_a(unit = "K", start = 293.15, fixed = true);
  Real T_w(unit = "K", start = 290.15, fixed = true);
equation
  C_a * der(T_a) = Q - (T_a - T_w) / R_aw;
  C_w * der(T_w) = (T_a - T_w) / R_aw - (T_w - T_out) / R_wo;
  T = T_a;
end Walls;
"""
LOCAL = FitSettings(method="local")
TOGETHER, FRICTION = 7.5e-6, 2.2e-5


@pytest.fixture(scope="module")
def spun() -> Recording:
    """The closed form of the rotor's speed under a torque that is held between samples."""
    time = np.arange(500) * 0.01
    torque = 1e-4 * np.sign(np.sin(3.0 * time))
    speed, kept = np.zeros(time.size), np.exp(-FRICTION / TOGETHER * 0.01)
    for k in range(1, time.size):
        speed[k] = kept * speed[k - 1] + (1.0 - kept) * torque[k - 1] / FRICTION
    noise = 0.02 * np.random.default_rng(4).standard_normal(time.size)
    return Recording("spun", time, {"M": torque}, {"speed": speed + noise})


def test_a_value_that_stands_for_a_sum_is_not_identified(exported, spun):
    """Only the sum is seen: the free one takes up what is wrong with the held one, and says so at its row."""
    fit = aero_bayes.fit(spun, exported(ROTOR), parameters=["J_r", "d"], settings=LOCAL, workers=0)
    assert fit["J_r"].value + 4e-6 == pytest.approx(TOGETHER, rel=0.02)
    assert fit["J_r"].status is Status.WEAK
    assert "J_s held at 4e-06 kg.m2" in fit["J_r"].note
    assert fit["J_r"].q05 < TOGETHER - 4e-6 < fit["J_r"].q95  # its interval is that for the held value
    assert fit["d"].status is Status.IDENTIFIED
    assert fit["d"].note == ""
    assert any("J_s" in sentence for sentence in fit.identifiability.sentences())
    assert "J_s held" in fit.summary()
    again = aero_bayes.fit(
        spun, exported(ROTOR), parameters=["J_r", "d"], settings=FitSettings("local", fixed={"J_s": 2e-6}), workers=0
    )
    assert again["J_r"].value - fit["J_r"].value == pytest.approx(2e-6, rel=1e-3)  # as the sentence has it


def test_a_held_value_that_the_data_tell_apart_is_not_named(exported, spun):
    """With J_s as good as nothing, or a gain that changes all outputs alike, each free value is its own."""
    settings = FitSettings("local", fixed={"J_s": 1e-10})
    fit = aero_bayes.fit(spun, exported(ROTOR), parameters=["J_r", "d"], settings=settings, workers=0)
    assert fit["J_r"].status is Status.IDENTIFIED
    assert fit.identifiability.with_held == {}


def test_a_posterior_keeps_what_a_value_is_known_with(exported, spun):
    fit = aero_bayes.fit(spun, exported(ROTOR), parameters=["J_r", "d"], settings=LOCAL, workers=0)
    short = aero_bayes.SampleSettings(max_steps=20, max_rounds=1)
    posterior = aero_bayes.sample(fit, settings=short, workers=0)
    assert posterior["J_r"].status is Status.WEAK
    assert "J_s held" in posterior["J_r"].note


def test_a_value_a_thousand_times_off_its_start_is_asked_about(exported, spun):
    """A torque in mN.m for N.m: moments of inertia and friction a thousand times as large do as well."""
    milli = Recording("milli", spun.time, {"M": 1e3 * spun.inputs["M"]}, spun.outputs)
    wide = {"J_r": (1e-7, 1.0), "d": (1e-7, 1.0)}
    asked = aero_bayes.fit(milli, exported(ROTOR), parameters=wide, settings=LOCAL, workers=0)
    assert asked["d"].value == pytest.approx(1e3 * FRICTION, rel=0.05)
    assert [w.split(" = ")[0] for w in asked.warnings if "another unit" in w] == ["d"]
    fit = aero_bayes.fit(spun, exported(ROTOR), parameters=wide, settings=LOCAL, workers=0)
    assert not [w for w in fit.warnings if "another unit" in w]


@pytest.fixture(scope="module")
def warm(exported) -> Recording:
    """The room from other values, with walls that are 1.2 K warmer at the beginning than the model says."""
    model = exported(ROOM)
    time = np.arange(1440) * 60.0
    inputs = {"Q": 2000.0 * (time // 7200 % 2), "T_out": 276.0 + 4.0 * np.sin(2 * np.pi * time / 86400)}
    flat = Recording("flat", time, inputs, {"T": 293.15 + 0.01 * np.sin(time)})
    first = aero_bayes.fit(flat, model, parameters=["C_a"], settings=LOCAL, workers=0)
    truth = {"C_a": 1.5e6, "C_w": 2e7, "R_aw": 0.003, "R_wo": 0.012}
    run = first.simulate({"time": time, **inputs}, parameters=truth, start={"T": 293.15, "T_w": 291.35})
    noise = 0.03 * np.random.default_rng(1).standard_normal(time.size)
    return Recording("warm", time, inputs, {"T": run.outputs["T"] + noise})


def test_a_start_that_the_recording_contradicts_is_told(exported, warm):
    names = ["C_a", "C_w", "R_aw", "R_wo"]
    fit = aero_bayes.fit(warm, exported(ROOM), parameters=names, settings=LOCAL, workers=0)
    found = [f for f in fit.calibration.data.recordings[0].findings if f.signal == "T_w"]
    assert [f.kind for f in found] == ["value"]
    assert "T_w starts at 290.15 K" in found[0].what
    assert fit.diagnosis["data"].found
    assert "T_w" in fit.verdict
    freed = FitSettings("local", calibration=CalibrationSettings(initial_states="estimated"))
    again = aero_bayes.fit(warm, exported(ROOM), parameters=names, settings=freed, workers=0)
    assert again["T_w_start"].value == pytest.approx(291.35, abs=0.2)
    assert "the model starts at 290.15" in again["T_w_start"].note
    assert again["T_start"].note == ""  # which was read
    assert not [f for f in again.calibration.data.recordings[0].findings if f.signal == "T_w"]


def test_the_starts_that_a_model_fixes_can_be_estimated(exported, warm):
    """One a recording, of the states that no output reads and those whose first reading agrees; none twice."""
    made = aero_bayes.fit(warm, exported(ROOM), parameters=["C_a"], settings=LOCAL, workers=0).calibration
    e = made.data.experiments[0]
    uneven = replace(e, spread=np.full((e.time.size, 1), 2.0))  # of noise that differs by reading
    assert min(state_sizes(made.model, uneven, list(made.model.states)).values()) > 1.0  # K
    held = held_starts(made)
    assert {state: [p.name for p in own] for state, own in held.items()} == {s: [f"{s}_start"] for s in ("T", "T_w")}
    wider = searched_too(made, [*held["T"], *held["T_w"]])
    assert wider.parameters.names == (*made.parameters.names, "T_start", "T_w_start")
    assert held_starts(wider) == {}
