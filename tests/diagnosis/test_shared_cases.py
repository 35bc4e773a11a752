"""Situations from public bug reports whose equations are right: right values, the cause named, the model not blamed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from aero_bayes.cli import main

CASES_AT = Path(os.environ.get("AERO_BAYES_CASES", Path(__file__).parents[2].parent / "shared" / "cases"))
pytestmark = [pytest.mark.skipif(not CASES_AT.is_dir(), reason=f"no cases at {CASES_AT}"), pytest.mark.fast]


def fitted(folder: str, config: str, data: list[str], out: Path, text: str = "") -> dict[str, Any]:
    """The result of ``fit`` to one or more files; ``text`` is put in place of the empty table of columns."""
    given = (CASES_AT / folder / config).read_text()
    given = given.replace("[data.columns]", f"[data.columns]\n{text}", 1)
    for line in [line for line in given.splitlines() if line.startswith("sources")]:
        name = Path(json.loads(line.partition("=")[2])[0])
        given = given.replace(line, f'sources = ["{(CASES_AT / folder / name).resolve()}"]')
    for line in [line for line in given.splitlines() if line.startswith("fmu")]:
        given = given.replace(line, f'fmu = "{(CASES_AT / folder / json.loads(line.partition("=")[2])).resolve()}"')
    (out / "rig.toml").write_text(given)
    arguments: list[object] = ["--config", out / "rig.toml", "--out", out / "out"]
    for name in data:
        arguments += ["--data", CASES_AT / folder / name]
    done = CliRunner().invoke(main, ["fit", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert "Checks:" in done.output
    result: dict[str, Any] = json.loads((out / "out" / "result.json").read_text())
    assert [row["cause"] for row in result["diagnosis"]] == ["data", "solver", "search", "noise", "model"]
    return result


@dataclass(frozen=True)
class Case:
    """A situation: its files, the values with their largest relative error, and what is told where no value is right.

    ``numbers`` are told after these words, with their largest relative error."""

    config: str
    data: list[str]
    values: Mapping[str, float] = field(default_factory=dict)
    share: float = 0.01
    told: tuple[str, ...] = ()
    numbers: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    columns: str = ""


WALLS = {"C": 6e5, "Cw": 4e6, "G": 110.0, "Gw": 180.0}
BLOCK = {"plant/Gain.k(1)": 2.6, "plant/Time constant [s]": 1.4}
CASES = {
    "18_wrapped_angle": [
        Case("wrapped.toml", ["run.csv"], told=("whole turn", "unwrap")),
        Case("wrapped.toml", ["run.csv"], {"J": 0.03, "d": 0.05}, 0.03, columns="phi = {unwrap = true}"),
    ],
    "46_block_fmu": [
        Case("pump.toml", ["run.csv"], BLOCK, 2e-3),
        Case("silent.toml", ["slow.csv"], BLOCK, 2e-3),
        Case("latin1.toml", ["odd.csv"], BLOCK, 2e-3),
    ],
    "49_table_values": [Case("later.toml", ["run.csv"], told=("e[1], e[2], e[3], e[4], e[5] and e[6] are held",))],
    "56_own_outputs": [
        Case("rig.toml", data, WALLS, 0.02)
        for data in (["room.csv", "wall.csv"], ["room2.csv", "wall2.csv"], ["lateout.csv"])
    ],
    "62_gauge_and_celsius": [
        Case("receiver.toml", ["gauge.csv"], numbers={"with ": (101325.0, 0.005), "k = ": (1e-8, 0.005)})
    ],
}


@pytest.mark.parametrize(
    ("folder", "case"),
    [
        pytest.param(f, c, id=f"{f}-{k}", marks=[pytest.mark.long] if f == "46_block_fmu" else [])
        for f, own in CASES.items()
        for k, c in enumerate(own)
    ],
)
def test_the_cause_is_named_and_the_values_are_right(folder: str, case: Case, tmp_path: Path) -> None:
    result = fitted(folder, case.config, case.data, tmp_path, case.columns)
    for name, value in case.values.items():
        assert result["parameters"][name]["value"] == pytest.approx(value, rel=case.share), name
    found = [row for row in result["diagnosis"] if row["found"]]
    assert not (case.values and found)
    for words in case.told:
        assert words in " ".join(found[0][key] for key in ("what", "where", "done"))
    for words, (number, share) in case.numbers.items():
        assert float(found[0]["what"].split(words)[1].split(" ")[0]) == pytest.approx(number, rel=share)


#: A folder, its configuration, a recording, and words of the verdict of its loop, which adds no effect.
LOOPS = [
    ("18_wrapped_angle", "wrapped.toml", "run.csv", "unexplained", "whole turn"),
    ("25_outlier_tail", "rig.toml", "run.csv", "adequate", ""),
    ("32_relative_noise", "rig.toml", "run.csv", "adequate", ""),
    ("56_own_outputs", "rig.toml", "lateout.csv", "adequate", ""),
]


@pytest.mark.long
@pytest.mark.parametrize(("folder", "config", "data", "outcome", "words"), LOOPS)
def test_the_loop_adds_no_effect_to_a_right_model(
    folder: str, config: str, data: str, outcome: str, words: str, tmp_path: Path
) -> None:
    arguments = ["--config", CASES_AT / folder / config, "--train", CASES_AT / folder / data, "--out", tmp_path]
    done = CliRunner().invoke(main, ["close-loop", "--workers", "1", "--quiet", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["loop"]["outcome"], result["loop"]["effects"]) == (outcome, [])
    assert words in result["verdict"]["text"]
    if outcome == "adequate":
        assert {error["verdict"] for error in result["loop"]["errors"]} == {"noise"}


def test_81_a_thermostat_shows_ratios_only(tmp_path: Path) -> None:
    result = fitted("81_switch_output", "T.toml", ["run.csv"], tmp_path)
    assert any("common change" in sentence for sentence in result["identifiability"]["flat"])
    for name, true in (("C", 3e4), ("G", 2.2), ("P", 130.0)):
        own = result["parameters"][name]
        assert own["status"] != "identified"
        assert own["q05"] < true < own["q95"]
