"""The measuring bench of real rigs: its references, its simulated drive, how answers are judged."""

from __future__ import annotations

import re
from pathlib import Path

import fmpy
import numpy as np
import pytest
from facts import facts

import play_drive
import real_rigs
import rig_references
from aero_bayes.config import load_config
from aero_bayes.export import export_fmu
from real_rigs_table import Expectation, judge_answer, judge_names, table

pytestmark = pytest.mark.long

STARTS = {
    "tanks": (5.0, 5.0), "tank2006": (1.0, 1.0), "tclab": (20.0, 20.0), "whiffle": (47.0, 0.0), "paramecium": (2.0,),
    "hotend": (25.0,), "coastdown": (8.0,),
}  # fmt: skip
#: How fast a rig moves, in 1/s, where a second is too long or too short for it.
RATES = {"silverbox": 400.0, "paramecium": 1e-5, "hotend": 0.01, "tclab": 0.01}
STEPS = {"play": 0.05, "aero_step": 16.5, "aero_pulse": 16.5, "aero_2dof": 10.0}


@pytest.mark.parametrize("name", rig_references.RIGS)
def test_the_equations_of_a_reference_are_those_of_the_first_model(name: str, tmp_path: Path) -> None:
    """Simulated as FMU and by hand, with an input that holds between samples."""
    rig = rig_references.RIGS[name]
    config = load_config(real_rigs.MODELS / name / "rig.toml")
    assert set(rig.start) == {n for n, p in config.parameters.items() if p.free} or name in ("aero_step", "aero_pulse")
    fmu = export_fmu(config.model.name, tmp_path / "Rig.fmu", compiler="embedded", sources=config.model.sources)
    rate = RATES.get(name, 1.0)
    time = np.arange(0.0, 4.0, 0.01) / rate
    waves = STEPS[name] + 0.0 * time if name in STEPS else 1.0 + 0.5 * np.sin(3.0 * rate * time)
    inputs = np.tile(waves[:, np.newaxis], len(rig.inputs))
    rows = np.column_stack([time, *inputs.T])
    table = np.array([*map(tuple, rows)], [(n, "f8") for n in ("time", *rig.inputs)]) if rig.inputs else None
    parameters = {n: 1.1 * value for n, value in rig.start.items()}
    # In co-simulation an output that is no state shows the input of the step before.
    kind = "CoSimulation" if rig.steps else "ModelExchange"
    found = fmpy.simulate_fmu(
        str(fmu), fmi_type=kind, stop_time=time[-1], output_interval=time[1], input=table,
        start_values=parameters, output=rig.outputs, relative_tolerance=1e-8,
    )  # fmt: skip
    start = np.array(STARTS.get(name, (0.0,) * len(rig.steps)))
    mine = rig.motion({**parameters, "delay": 0.0}, start, time, inputs, False)
    for column, output in enumerate(rig.outputs):
        wanted = np.interp(time, found["time"], found[output])
        assert mine[:, column] == pytest.approx(wanted, rel=2e-4, abs=2e-4 * np.ptp(wanted)), output


@pytest.mark.parametrize("name", ["servo", "emps", "tanks", "cartpendulum"])
def test_a_straight_input_is_one_that_holds_for_ever_shorter_times(name: str) -> None:
    rig = rig_references.RIGS[name]
    coarse, fine = np.linspace(0.0, 4.0, 201), np.linspace(0.0, 4.0, 200 * 10 + 1)
    wave = 1.0 + 0.5 * np.sin(2.0 * coarse)
    start = np.array(STARTS.get(name, (0.0,) * len(rig.steps)))
    mine = rig.motion(rig.start, start, coarse, wave[:, np.newaxis], True)
    middle = np.interp(fine + 0.5 * fine[1], coarse, wave)
    wanted = rig.motion(rig.start, start, fine, middle[:, np.newaxis], False)[::10]
    assert mine == pytest.approx(wanted, rel=1e-3, abs=1e-4)


def test_a_reference_comes_down_to_the_noise_where_nothing_is_missing(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    time = 0.02 * np.arange(400)
    command = np.repeat(rng.uniform(-1.0, 1.0, 20), 20)
    angle = np.empty(400)
    angle[0] = 0.3
    for k in range(399):
        angle[k + 1] = command[k] + (angle[k] - command[k]) * np.exp(-0.02 / 0.15)
    path = tmp_path / "train.csv"
    rows = np.column_stack([time, command, angle + 0.01 * rng.standard_normal(400)])
    np.savetxt(path, rows, delimiter=",", header="time,command,angle", comments="")
    found = rig_references.residuals_of("servo", [path], whole=True)
    assert found["free"]["parameters"]["T"] == pytest.approx(0.15, rel=0.01)
    assert found["free"]["rms"]["angle"] == pytest.approx(0.01, rel=0.1)
    assert found["free"]["rms"]["angle"] <= found["as_read"]["rms"]["angle"] < 0.0115


def test_a_reference_leaves_gaps_and_keeps_all_of_a_few_readings(tmp_path: Path) -> None:
    path = tmp_path / "train.csv"
    days = np.arange(12)
    counts = [f"{2.0 * np.exp(0.4 * day) * (1.0 + 0.01 * (-1) ** day):.6g}" if day != 3 else "" for day in days]
    lines = [f"{86400 * day},{count}" for day, count in zip(days, counts, strict=True)]
    path.write_text("\n".join(["time,count", *lines]), encoding="utf-8")
    found = rig_references.residuals_of("paramecium", [path], whole=True)["free"]
    assert found["parameters"]["r"] == pytest.approx(0.4 / 86400, rel=0.01)
    sizes = [0.01 * 2.0 * np.exp(0.4 * day) for day in days if day != 3]
    assert 0.3 * np.sqrt(np.mean(np.square(sizes))) < found["rms"]["count"] < np.sqrt(np.mean(np.square(sizes)))


def test_the_drive_is_free_within_its_play_and_rests_on_its_spring() -> None:
    a = play_drive.FRICTION / play_drive.INERTIA
    time = play_drive.INTERVAL * np.arange(30)
    slow = play_drive.angles(np.full(30, 0.01))
    speed = play_drive.GAIN * 0.01 / play_drive.FRICTION
    assert np.abs(slow).max() < play_drive.PLAY
    assert slow == pytest.approx(speed * (time - (1.0 - np.exp(-a * time)) / a), abs=1e-12)
    rest = play_drive.angles(np.full(600, 4.0))[-1]
    assert rest == pytest.approx(play_drive.PLAY + play_drive.GAIN * 4.0 / play_drive.STIFFNESS, rel=1e-6)


def test_every_case_has_its_model_and_reference() -> None:
    for case in real_rigs.cases().values():
        config = load_config(case.folder / "rig.toml")
        assert config.model.name
        assert all(source.is_file() for source in config.model.sources)
        assert case.folder.name in rig_references.RIGS


def row(*named: str, equivalent: tuple[tuple[str, ...], ...] = ()) -> dict[str, object]:
    return {
        "key": "rig", "code": "0", "seconds": 1.0, "outcome": "extended", "named": list(named),
        "equivalent": [list(ids) for ids in equivalent], "before": {"train": {"y": 0.3}, "test": {"y": 0.4}},
        "after": {"train": {"y": 0.1}, "test": {"y": 0.2}}, "parameters": {"x_b": {"value": 0.032, "sd": 0.001}},
    }  # fmt: skip


def test_names_are_right_missed_false_or_other() -> None:
    known = Expectation(
        expected=(("overflow@h1",), ("lag@u", "delay@u")), fine=("offset@*",), false=("gain@*",),
        truth={"x_b": 0.03, "gone": 1.0},
    )  # fmt: skip
    best = {start: {"rms": {"y": rms}} for start, rms in (("free", 0.2), ("as_read", 0.3))}
    answer = row("overflow@h1", "offset@h2", "gain@u", "curve@y")
    one = judge_answer(answer, best, known)
    assert (one["right"], one["missed"]) == (["overflow@h1"], ["lag@u or delay@u"])
    assert (one["false"], one["other"], one["verdict"]) == (["gain@u"], ["curve@y"], "false")
    assert one["over_reference"]["free"]["together"] == pytest.approx(1.5)
    assert one["standard_deviations_off"] == {"x_b": pytest.approx(2.0), "gone": None}
    same = judge_answer(row("gain@u", equivalent=(("gain@u", "delay@u"),)), {}, known)
    assert (same["right"], same["false"]) == (["gain@u"], [])
    alone = judge_answer(row("backlash@w", "offset@w"), {}, Expectation(expected=(("backlash@w",),), false=("*",)))
    assert (alone["right"], alone["false"]) == (["backlash@w"], ["offset@w"])
    failed = judge_answer({"key": "other", "code": "0", "seconds": 2.0, "error": "stopped"}, {}, known)
    text = table([one, failed])
    assert re.search(facts("1 of 2", "2 false", "1 of 1"), text)
    assert re.search(facts("1 false", "1 failed", "stopped"), text)


@pytest.mark.parametrize(
    ("named", "verdict"),
    [
        (["square_law@u"], "right"),
        (["square_law@u", "lag@u"], "right"),
        (["curve@u"], "place_right"),
        (["lag@u"], "missed"),
        ([], "missed"),
        (["square_law@u", "dead_zone@u"], "false"),
        (["curve@u", "offset@y"], "false"),
    ],
)
def test_the_verdict_tells_a_name_from_a_place(named: list[str], verdict: str) -> None:
    known = Expectation(expected=(("square_law@u",),), place=("curve@u",), fine=("lag@u",), false=("dead_zone@u",))
    assert judge_names(named, [], known)["verdict"] == verdict


def test_silence_is_right_where_no_law_is_missing_or_readings_are_too_few() -> None:
    few = Expectation(expected=(("square_loss@N",),), silence=True)
    none = Expectation(place=("curve@i",), fine=("dead_zone@v",))
    assert [judge_names([], [], known)["verdict"] for known in (few, none)] == ["silent", "silent"]
    # A class of which none is named, but which holds the truth.
    untold = [["lag@u", "square_loss@N"]]
    assert judge_names([], untold, Expectation(expected=few.expected))["verdict"] == "place_right"
    assert judge_names([], [["lag@u", "gain@u"]], Expectation(expected=few.expected))["verdict"] == "missed"
    assert judge_names(["curve@i"], [], none)["verdict"] == "place_right"
    assert judge_names(["dead_zone@v"], [], none)["verdict"] == "right"
    assert judge_names(["lag@i"], [], none)["verdict"] == "false"


def test_a_case_whose_recordings_are_not_there_is_left_out(tmp_path: Path) -> None:
    case = real_rigs.RigCase("rig", ("a.csv",), ("b.csv",))
    (tmp_path / "a.csv").touch()
    assert case.find([tmp_path]) is None
    (tmp_path / "b.csv").touch()
    assert case.find([tmp_path / "none", tmp_path]) == {
        "train": [(tmp_path / "a.csv").resolve()], "test": [(tmp_path / "b.csv").resolve()]
    }  # fmt: skip
