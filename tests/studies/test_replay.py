"""The replay of the paper against closed forms, and the table and the figure that it writes."""

from __future__ import annotations

import numpy as np
import pytest
from aero_closed_form import linear_run

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool
from replay import (
    BOX,
    JOINT,
    NAMES,
    PAPER,
    RERUN,
    SHEET,
    STAGES,
    TABLE_1,
    TRANSFER_GAIN,
    Evaluator,
    coarse_search,
    figure_6,
    in_stages,
    paper_recording,
    replay_paper,
    swarm,
    table_lines,
)

pytestmark = pytest.mark.long

RECORDING = paper_recording(4)
POINT = np.array(list(SHEET.values()))


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return replay_paper(RECORDING, seed=4, workers=1, out=tmp_path_factory.mktemp("paper"))


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    folder, names = tmp_path_factory.mktemp("models"), ("OneDofLinear", "TransferFunction")
    linear, transfer = (Model.load(export_fmu(f"Aero.Systems.{name}", folder / f"{name}.fmu")) for name in names)
    with WorkerPool(1) as pool:
        yield Evaluator(RECORDING, linear, NAMES, pool), Evaluator(RECORDING, transfer, ("K_pp",), pool)


def test_the_recording_is_the_papers_experiment() -> None:
    assert (RECORDING.rows, RECORDING.duration) == (2001, 40.0)
    np.testing.assert_array_equal(RECORDING.inputs["V_m"], np.where(RECORDING.time < 20.0, 24.0, 0.0))
    assert paper_recording(4).sha256 == RECORDING.sha256 != paper_recording(1).sha256
    assert 0.4 < np.nanmax(RECORDING.outputs["theta"]) < 1.5


def test_every_model_of_the_paper_is_there_and_the_joint_fit_ranks_first(rows) -> None:
    assert [one.fitness for one in TABLE_1.values()] == [29.3903, 498.7173, 28.2230, 0.2280, 42.7060]
    paper = {row.model: row.paper_fitness for row in rows if row.variant == PAPER}
    assert paper == {label: one.fitness for label, one in TABLE_1.items()}
    assert {row.model for row in rows if row.variant == RERUN} == {"PSO Model 1", "PSO + data sheet", "fmincon"}
    best = min(row.fitness for row in rows if row.variant == JOINT)
    assert all(best <= row.fitness for row in rows)


def test_fitness_is_eq6_of_the_pitch(rows) -> None:
    """Every row under the linear law without nuisances, by an independent solution and a plain sum."""
    checked = [row for row in rows if row.variant != JOINT and set(row.values) == set(NAMES)]
    assert len(checked) == 7
    for row in checked:
        pitch = linear_run(row.values, RECORDING.time)[:, 2]
        total = sum((y - x) ** 2 for y, x in zip(RECORDING.outputs["theta"], pitch, strict=True))
        assert row.fitness == pytest.approx(total, rel=2e-4)
        assert all(0.0 <= row.values[name] <= BOX[name] for name in NAMES)


def test_data_choose_the_law_they_were_made_with(rows) -> None:
    linear, quadratic = (row for row in rows if row.variant == JOINT)
    assert quadratic.fitness < linear.fitness
    assert quadratic.values["k_d"] == pytest.approx(2.4e-8 * 1.08, rel=0.02)
    assert quadratic.values["R_a"] == pytest.approx(8.4 * 1.07, rel=0.02)


def test_table_and_figure_show_every_row_and_model(rows, tmp_path) -> None:
    text = "\n".join(table_lines(rows))
    assert all(f"| {row.model}: {row.variant} |" in text for row in rows)
    picture = figure_6(RECORDING, rows)
    assert len(picture.panels[0].layers) == len(TABLE_1) + 2
    assert all(f"━</tspan> {label}<" in picture.svg for label in ("measured", *TABLE_1, "Joint fit"))


def test_same_seed_same_numbers(models) -> None:
    def found(seed: int) -> dict[str, float]:
        rng = np.random.default_rng(seed)
        return in_stages(models[0], lambda cost, start, top: swarm(cost, start, top, rng))

    assert found(8) == found(8) != found(9)


def test_transfer_function_is_a_second_order_step_response(models) -> None:
    inertia, damping, stiffness = 0.0219, 0.0071, 0.0375
    omega, sigma = np.sqrt(stiffness / inertia), damping / (2.0 * inertia)
    ringing = np.sqrt(omega**2 - sigma**2)

    def step(t):
        t = np.maximum(t, 0.0)
        return 1.0 - np.exp(-sigma * t) * (np.cos(ringing * t) + sigma / ringing * np.sin(ringing * t))

    expected = 24.0 * TRANSFER_GAIN / stiffness * (step(RECORDING.time) - step(RECORDING.time - 20.0))
    np.testing.assert_allclose(models[1].simulate(np.array([TRANSFER_GAIN]))[0, :, 0], expected, atol=2e-5)


def test_stator_and_rotor_inertia_act_as_a_sum_and_without_any_nothing_runs(models) -> None:
    inertias = [(4e-6, 4e-6), (1e-9, 8e-6 - 1e-9), (7.999e-6, 1e-9), (0.0, 0.0)]
    points = np.tile(POINT, (4, 1))
    points[:, 2:4] = inertias
    runs = models[0].simulate(points[:3])
    scaled = runs / np.abs(runs[0]).max(axis=0)
    np.testing.assert_allclose(scaled[1:], np.broadcast_to(scaled[0], scaled[1:].shape), atol=1e-5)
    cost = models[0].cost(points, "omega_m")
    assert np.isfinite(cost[:3]).all()
    assert np.isinf(cost[3])


def test_coarse_steps_do_not_find_the_inertia(models) -> None:
    """A step of 0.1 kg m^2 from 4e-6 sees a cost that rises, where the exact slope falls."""
    names, output = STAGES[1]

    def cost(points):
        batch = np.tile(POINT, (len(points), 1))
        batch[:, 2:4] = points
        return models[0].cost(batch, output)

    end = coarse_search(cost, POINT[2:4], np.array([BOX[name] for name in names]))
    near = np.geomspace(1e-6, 3e-5, 40)
    assert cost(end[None])[0] <= cost(POINT[None, 2:4])[0]
    assert cost(np.column_stack([near, near])).min() < 0.9 * cost(end[None])[0]
