"""``aero-bayes ports`` on a small model: what is listed, and which ports a recording can see."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_rigs import RIGS

from aero_bayes.cli import main

RIG = """model Pair "A vessel that is read, and one downstream that nothing reads"
  parameter Real k(unit = "1/s", min = 0.01, max = 10) = 0.5 "Outflow";
  input Real u(unit = "kg/s");
  output Real level(unit = "kg") = a;
  Real a(unit = "kg", start = 0, fixed = true);
  Real b(unit = "kg", start = 0, fixed = true);
equation
  der(a) = u - k * a;
  der(b) = k * a - 0.3 * b;
end Pair;
"""
SD = 0.01


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """The folder of a model, its configuration and a recording of it, solved by hand from step to step."""
    (tmp_path / "Pair.mo").write_text(RIG)
    (tmp_path / "rig.toml").write_text(
        '[model]\nsources = ["Pair.mo"]\nname = "Pair"\n[parameters]\nk = {free = true}\n'
    )
    rng = np.random.default_rng(4)
    time = np.arange(400) * 0.1
    u = np.repeat(rng.uniform(0.0, 2.0, 20), 20)
    a = np.zeros(400)
    for k in range(399):
        a[k + 1] = u[k] / 0.5 + (a[k] - u[k] / 0.5) * np.exp(-0.05)
    rows = np.column_stack([time, u, a + SD * rng.normal(size=400)])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="time,u,level", comments="")
    return tmp_path


def ports(*arguments: str | Path) -> str:
    result = CliRunner().invoke(main, ["ports", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_every_port_is_listed_with_its_place_states_and_laws(rig):
    rows = {row["id"]: row for row in json.loads(ports("--config", rig / "rig.toml", "--json"))}
    assert {name: row["kind"] for name, row in rows.items()} == {
        "u": "input", "level": "output", "a": "storage", "b": "storage",
    }  # fmt: skip
    assert (rows["a"]["line"], rows["b"]["line"], rows["u"]["unit"]) == (8, 9, "kg/s")
    assert rows["a"]["states"] == ["a"]
    assert "square_law" in rows["u"]["laws"]
    assert "linear_loss" in rows["a"]["laws"]
    assert "visible" not in rows["a"]


def test_a_recording_sees_what_its_outputs_answer_to(rig):
    rows = json.loads(ports("--config", rig / "rig.toml", "--data", rig / "run.csv", "--json"))
    assert {row["id"]: row["visible"] for row in rows} == {"u": "yes", "level": "yes", "a": "yes", "b": "no"}


def test_the_table_says_what_a_response_is(rig):
    lines = ports("--config", rig / "rig.toml", "--data", rig / "run.csv").splitlines()
    assert {"response", "visible"} <= set(lines[0].split())
    assert [line.split()[0] for line in lines if not line.startswith(" ")][1:6] == ["u", "level", "a", "b", "response:"]
    assert max(map(len, lines)) <= 80
    assert "response" not in ports("--config", rig / "rig.toml")


def test_the_response_is_that_of_the_probe_that_is_imitated_least(rig):
    """Of offset, gain and lag of the reading, less what the outflow's slope imitates; the first level is fixed."""
    found = {r["id"]: r for r in json.loads(ports("--config", rig / "rig.toml", "--data", rig / "run.csv", "--json"))}
    _, u, _ = np.loadtxt(rig / "run.csv", delimiter=",", skiprows=1).T
    decay, level, slope = np.exp(-0.05), np.zeros(400), np.zeros(400)
    for n in range(399):
        # a(h) = u / k + (a - u / k) exp(-k h), and its derivative by k
        level[n + 1] = 2.0 * u[n] + (level[n] - 2.0 * u[n]) * decay
        slope[n + 1] = -4.0 * u[n] * (1.0 - decay) + decay * (slope[n] - 0.1 * (level[n] - 2.0 * u[n]))
    imitated = slope[:, np.newaxis]
    size = np.quantile(np.abs(level), 0.995)
    rate = u - 0.5 * level
    probes = np.column_stack([np.full(400, size), level, size / np.quantile(np.abs(rate), 0.995) * rate])
    left = probes - imitated @ np.linalg.lstsq(imitated, probes, rcond=None)[0]
    assert found["level"]["response"] == pytest.approx(np.linalg.norm(left, axis=0).max() / SD, rel=0.15)


SCALED = """model Scaled "A vessel whose gauge is not calibrated"
  parameter Real gain(unit = "V/kg", min = 0.1, max = 10) = 1 "Of the gauge";
  parameter Real zero(unit = "V", min = -10, max = 10) = 0 "Of the gauge";
  input Real u(unit = "kg/s");
  output Real gauge(unit = "V") = gain * a + zero;
  Real a(unit = "kg", start = 0, fixed = true);
equation
  der(a) = u - 0.5 * a;
end Scaled;
"""


def test_a_lag_of_a_reading_is_seen_beside_free_offset_and_gain(rig):
    """The least that a lag by T moves it is T times its rate, less what gain and zero imitate of that."""
    (rig / "Scaled.mo").write_text(SCALED)
    (rig / "scaled.toml").write_text(
        '[model]\nsources = ["Scaled.mo"]\nname = "Scaled"\n[parameters]\ngain = {free = true}\nzero = {free = true}\n'
        '[fit]\ninitial_states = "reading"\n'
    )
    time, u, level = np.loadtxt(rig / "run.csv", delimiter=",", skiprows=1).T
    np.savetxt(rig / "gauge.csv", np.column_stack([time, u, level]), delimiter=",", header="time,u,gauge", comments="")
    options = ("--config", rig / "scaled.toml", "--data", rig / "gauge.csv", "--json")
    (found,) = (row for row in json.loads(ports(*options)) if row["id"] == "gauge")
    truth = np.zeros(400)
    for n in range(399):
        truth[n + 1] = 2.0 * u[n] + (truth[n] - 2.0 * u[n]) * np.exp(-0.05)
    rate = u - 0.5 * truth
    rate = np.quantile(np.abs(truth), 0.995) / np.quantile(np.abs(rate), 0.995) * rate
    imitated = np.column_stack([truth, np.ones(400)])
    left = rate - imitated @ np.linalg.lstsq(imitated, rate, rcond=None)[0]
    assert found["response"] == pytest.approx(np.linalg.norm(left) / SD, rel=0.15)
    assert found["visible"] == "yes"
    assert found["imitated"] == {"a constant": "zero", "proportional to gauge": "gain"}


STILL = """model Still "A weight on a string that is cut by nobody: gravity is all that acts"
  parameter Real m(unit = "kg") = 2;
  parameter Real a(unit = "m/s2", min = -20, max = 20) = 1 "Slope of the track, times gravity";
  input Real F(unit = "N");
  output Real y(unit = "m") = x;
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  m * der(v) = F - m * a;
end Still;
"""


def test_a_force_that_follows_the_motion_is_seen_a_constant_one_not(tmp_path):
    """The slope of the track does what a constant force does, but not what friction does."""
    (tmp_path / "Still.mo").write_text(STILL)
    (tmp_path / "rig.toml").write_text(
        '[model]\nsources = ["Still.mo"]\nname = "Still"\n[parameters]\na = {free = true}\n'
    )
    time = np.arange(300) * 0.02
    force = np.repeat(np.tile([4.0, -1.0, 2.0], 2), 50)
    x, v = np.zeros(300), 0.0
    for n in range(299):
        slope = force[n] / 2.0 - 1.0
        x[n + 1], v = x[n] + 0.02 * v + 0.5 * slope * 0.02**2, v + 0.02 * slope
    x += 1e-3 * np.random.default_rng(2).normal(size=300)
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, force, x]), delimiter=",", header="time,F,y", comments="")
    rows = json.loads(ports("--config", tmp_path / "rig.toml", "--data", tmp_path / "run.csv", "--json"))
    assert {row["id"]: row["visible"] for row in rows}["v"] == "yes"


def test_a_fit_without_the_effect_is_not_the_yardstick_of_its_visibility(tmp_path):
    """A ball that the air slows down: what free fall leaves is metres, what the sensor adds centimetres."""
    (tmp_path / "rig.toml").write_text(
        f'[model]\nsources = ["{RIGS / "Falling.mo"}"]\nname = "Falling"\n[data]\ninputs = []\noutputs = ["height"]\n'
        '[fit]\ninitial_states = "estimated"\n[parameters]\ng = {free = true}\n'
    )
    time = np.arange(60) / 15.0
    height = 50.0 - 20.0 * (time - 2.0 * (1.0 - np.exp(-0.5 * time)))
    height += 0.02 * np.random.default_rng(4).normal(size=60)
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, height]), delimiter=",", header="time,height", comments="")
    rows = json.loads(ports("--config", tmp_path / "rig.toml", "--data", tmp_path / "run.csv", "--json"))
    assert {row["id"]: row["visible"] for row in rows}["v"] == "yes"
    shares = {law: share for row in rows for law, share in row["explains"].items()}
    assert shares["viscous_friction@v"] > 0.5
    said = ports("--config", tmp_path / "rig.toml", "--data", tmp_path / "run.csv")
    listed = set(re.findall(r'"(\S+@\S+)"', said.partition("effects = ")[2]))
    assert listed == {law for law, share in shares.items() if share > 0.1}


def test_of_a_model_that_explains_its_recording_no_law_is_listed(rig):
    rows = json.loads(ports("--config", rig / "rig.toml", "--data", rig / "run.csv", "--json"))
    shares = [share for row in rows for share in row["explains"].values()]
    assert len(shares) > 10
    assert max(shares) < 0.1


def test_the_table_is_aligned_and_names_file_and_line(rig):
    header, *lines = ports("--config", rig / "rig.toml").splitlines()
    assert header.split() == ["id", "kind", "unit", "file", "states"]
    lines = [line for line in lines if not line.startswith(" ")]
    at = header.index("file")
    assert [line[at:].split()[0] for line in lines] == ["Pair.mo:3", "Pair.mo:4", "Pair.mo:8", "Pair.mo:9"]


def test_the_aero_has_the_ports_of_its_effects():
    rows = json.loads(ports("--model", "Aero.Systems.OneDof", "--json"))
    expected = {
        "electrical": "supply_resistance brush_drop winding_heating amplifier_deadzone amplifier_saturation",
        "rotor": "rotor_coulomb_friction rotor_viscous_friction",
        "thrust": "thrust_inflow_loss thrust_lag thrust_asymmetry",
        "body": "pivot_coulomb_friction pivot_presliding_friction body_quadratic_drag gravity_offset cubic_stiffness",
        "sensor": "current_offset speed_lag pitch_delay pitch_offset",
    }
    named = {row["id"]: row["port"] for row in rows if "@" not in row["id"]}
    assert named == {n: port for port, ids in expected.items() for n in ids.split()}
    curves = [row["id"].partition("@")[2] for row in rows if "@" in row["id"]]
    assert curves == ["electrical", "rotor", "thrust", "body", "body"]
