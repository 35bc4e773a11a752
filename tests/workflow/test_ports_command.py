"""``aero-bayes ports`` on a small model: what is listed, and which ports a recording can see."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vessel
from click.testing import CliRunner
from small_rigs import RIGS

import aero_bayes
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


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """The folder of a model, its configuration and a recording of it, solved by hand from step to step."""
    (tmp_path / "Pair.mo").write_text(RIG)
    (tmp_path / "rig.toml").write_text(
        '[model]\nsources = ["Pair.mo"]\nname = "Pair"\n[parameters]\nk = {free = true}\n'
    )
    vessel.record(tmp_path / "run.csv")
    return tmp_path


def ports(*arguments: str | Path) -> str:
    result = CliRunner().invoke(main, ["ports", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


def listed(folder: Path, *more: str | Path) -> dict[str, dict[str, Any]]:
    """Rows of the ports of a folder's rig by their names."""
    return {row["id"]: row for row in json.loads(ports("--config", folder / "rig.toml", "--json", *more))}


def seen(folder: Path) -> dict[str, dict[str, Any]]:
    """The same, with what the recording sees of each."""
    return listed(folder, "--data", folder / "run.csv")


def test_every_port_is_listed_with_its_place_states_and_laws(rig):
    rows = listed(rig)
    assert {name: row["kind"] for name, row in rows.items()} == {
        "u": "input", "level": "output", "a": "storage", "b": "storage",
    }  # fmt: skip
    assert (rows["a"]["line"], rows["b"]["line"], rows["u"]["unit"]) == (8, 9, "kg/s")
    assert rows["a"]["states"] == ["a"]
    assert "square_law" in rows["u"]["laws"]
    assert "linear_loss" in rows["a"]["laws"]
    assert "visible" not in rows["a"]


def test_the_table_is_aligned_and_says_what_a_response_is(rig):
    header, *lines = ports("--config", rig / "rig.toml").splitlines()
    assert header.split() == ["id", "kind", "unit", "file", "states"]
    at = header.index("file")
    assert [line[at:].split()[0] for line in lines if not line.startswith(" ")] == [
        f"Pair.mo:{k}" for k in (3, 4, 8, 9)
    ]
    lines = ports("--config", rig / "rig.toml", "--data", rig / "run.csv").splitlines()
    assert {"response", "visible"} <= set(lines[0].split())
    assert [line.split()[0] for line in lines if not line.startswith(" ")][1:6] == ["u", "level", "a", "b", "response:"]
    assert max(map(len, lines)) <= 80


def test_a_recording_sees_what_its_outputs_answer_to_and_no_law_where_the_model_explains_it(rig):
    """The response of the output is about that of an error as large as the reading, less what the slope imitates."""
    found = seen(rig)
    assert [name for name, row in found.items() if row["visible"] == "yes"] == ["u", "level", "a", "b"]
    # nothing reads b: only what flows back from it to a is seen
    assert [one["law"] for one in found["b"]["limits"]] == ["overflow"]
    shares = [share for row in found.values() for share in row["explains"].values()]
    assert len(shares) > 10
    assert max(shares) < 0.1
    _, u, _ = np.loadtxt(rig / "run.csv", delimiter=",", skiprows=1).T
    level, imitated = vessel.levels(u), vessel.levels(u, k=0.5001) - vessel.levels(u, k=0.4999)
    left = level - (imitated @ level) / (imitated @ imitated) * imitated
    least = np.linalg.norm(left) / vessel.SD
    assert 0.3 * least < found["level"]["response"] < 3.0 * least


def test_a_recording_sees_the_same_around_an_fmu(rig):
    fmu = aero_bayes.load_model(rig / "Pair.mo").path
    own = seen(rig)
    (rig / "rig.toml").write_text(f'[model]\nfmu = "{fmu}"\n[parameters]\nk = {{free = true}}\n')
    found = seen(rig)
    assert list(found) == ["u", "level"]
    for port, row in found.items():
        assert row["response"] == pytest.approx(own[port]["response"], rel=0.01)


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
    (rig / "Scaled.mo").write_text(SCALED)
    (rig / "rig.toml").write_text(
        '[model]\nsources = ["Scaled.mo"]\nname = "Scaled"\n[parameters]\ngain = {free = true}\nzero = {free = true}\n'
        '[fit]\ninitial_states = "reading"\n'
    )
    vessel.record(rig / "run.csv", "time,u,gauge")
    found = seen(rig)["gauge"]
    assert found["visible"] == "yes"
    assert {"lag", "delay"} <= {one["law"] for one in found["limits"]}
    assert found["imitated"] == {"offset": "zero", "gain": "gain"}


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
    rows = seen(tmp_path)
    assert rows["v"]["visible"] == "yes"
    shares = {law: share for row in rows.values() for law, share in row["explains"].items()}
    assert shares["viscous_friction@v"] > 0.5
    said = ports("--config", tmp_path / "rig.toml", "--data", tmp_path / "run.csv")
    listed = set(re.findall(r'"(\S+@\S+)"', said.partition("effects = ")[2]))
    assert listed == {law for law, share in shares.items() if share > 0.1}
