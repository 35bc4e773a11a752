"""ODEBench: tasks are what they say, what shows is known once, and verdicts tell the deleted term from others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sympy", reason="the extra odebench is not installed")

import odebench
from odebench_tasks import Task, can_be_simulated, read_systems, tasks_of, times, trajectory, verdict, visibility

pytestmark = pytest.mark.long

#: A file in the form of the benchmark's: logistic growth, a swinging pendulum, and one that does not reach the end.
SOURCE = """
equations = [
    {"id": 1, "eq": "c_0*x_0 - c_1*x_0**2", "consts": [[1.5, 0.5]], "init": [[0.1], [0.4]]},
    {"id": 2, "eq": "x_1 | -c_0*sin(x_0) - c_1*x_1", "consts": [[2.0, 1/10]], "init": [[1.0, 0.0], [-0.5, 0.2]]},
    {"id": 3, "eq": "c_0 + x_0**2", "consts": [[1.0]], "init": [[0.0], [1.0]]},
]
"""


@pytest.fixture
def systems(tmp_path: Path) -> list[odebench.System]:
    path = tmp_path / "systems.py"
    path.write_text(SOURCE, encoding="utf-8")
    return read_systems(path)


def test_a_trajectory_is_the_closed_form_and_one_that_explodes_is_none(systems: list[odebench.System]) -> None:
    logistic, _, explodes = systems
    found, grown = trajectory(logistic, (0.1,)), 0.1 * np.exp(1.5 * times())
    assert found is not None
    np.testing.assert_allclose(found[:, 0], grown / (1.0 + (grown - 0.1) / 3.0), rtol=1e-6)
    assert can_be_simulated(logistic)
    assert not can_be_simulated(explodes)


def test_a_term_shows_as_far_as_it_is_over_the_noise_and_is_computed_once(
    systems: list[odebench.System], tmp_path: Path
) -> None:
    saturation = tasks_of(systems[0], 0.02)["all_states"][1]
    damping = tasks_of(systems[1], 0.02)["all_states"][1]
    # without its square the growth has no bound: no other growth rate does what a saturation does
    assert visibility(saturation) > odebench.VISIBLE
    finer, coarse = (visibility(Task(damping.system, damping.term, None, noise)) for noise in (0.02, 0.04))
    assert finer == pytest.approx(2.0 * coarse, rel=1e-3)
    path = tmp_path / "visible.json"
    assert odebench.Visibilities(path).visible(saturation)
    path.write_text(f'{{"{saturation.key}": 0.0}}', encoding="utf-8")
    assert not odebench.Visibilities(path).visible(saturation)


def test_drawn_tasks_show_and_their_kinds_take_turns(systems: list[odebench.System], tmp_path: Path) -> None:
    counts = {"all_states": 2, "one_hidden": 1, "nothing_deleted": 1}
    drawn = odebench.draw(systems[:2], 0.02, counts, 1, lambda task: task.system.number == 1 or task.hidden is not None)
    kinds = [kind for kind, _ in drawn]
    assert {kind: kinds.count(kind) for kind in counts} == counts
    assert all(task.system.number == 1 for kind, task in drawn if kind == "all_states")
    assert all(task.term is None for kind, task in drawn if kind == "nothing_deleted")


@pytest.mark.parametrize(("added", "expected"), [("- 0.2*x_0^2", "right"), ("- 0.2*x_0", "false"), ("", "silent")])
def test_the_verdict_is_on_the_form_and_not_on_the_coefficient(
    added: str, expected: str, systems: list[odebench.System]
) -> None:
    task = tasks_of(systems[0], 0.02)["all_states"][1]
    text = task.first_model.modelica((0.1,), None).replace(";\nend", f" {added};\nend")
    effects = [{"id": "formula@x_0", "parameters": {}}] if added else []
    assert verdict(task, {"effects": effects}, text) == expected
