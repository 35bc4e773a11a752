"""The pieces of the replay against closed forms and second implementations."""

from __future__ import annotations

import numpy as np
import pytest
from aero_closed_form import linear_run
from scipy.optimize import least_squares

from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.workers import WorkerPool
from paper_replay import paper_recording
from paper_replay.models import OUTPUTS, export_models, open_models
from paper_replay.published import (
    BOX,
    FMINCON,
    PAPER_STAGES,
    PSO,
    PSO_DATASHEET,
    TABLE_1,
    TABLE_PARAMETERS,
    UNOPTIMISED,
)
from paper_replay.search import coarse_stage, scaled_stage, swarm_recipe

pytestmark = pytest.mark.long

COLUMN = {name: k for k, name in enumerate(OUTPUTS)}


@pytest.fixture(scope="module")
def recording():
    return paper_recording(5)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return export_models(tmp_path_factory.mktemp("replay"))


@pytest.fixture(scope="module")
def opened(recording, models):
    """The linear model and the transfer function."""
    with WorkerPool(1) as pool:
        yield open_models(recording, models, lambda problem: open_simulator(problem, pool=pool))


@pytest.fixture(scope="module")
def linear(opened):
    return opened[0]


def eq6(recording, run, output):
    """Eq. 6 by its definition, one term at a time."""
    total = 0.0
    for measured, simulated in zip(recording.outputs[output], run[:, COLUMN[output]], strict=True):
        total += (measured - simulated) * (measured - simulated)
    return total


def test_table_is_the_papers():
    fitness = [one.fitness for one in TABLE_1]
    assert fitness == [29.3903, 498.7173, 28.2230, 0.2280, 42.7060]
    assert UNOPTIMISED.parameters["k_d"] == -1e-5
    assert UNOPTIMISED.model_values["k_d"] == 1e-5
    assert PSO.parameters["J_r"] == 84.2
    for one in (UNOPTIMISED, PSO, PSO_DATASHEET, FMINCON):
        assert all(BOX[name][0] <= one.model_values[name] <= BOX[name][1] for name in TABLE_PARAMETERS)


@pytest.mark.parametrize("published", [UNOPTIMISED, PSO, PSO_DATASHEET, FMINCON], ids=lambda one: one.label)
@pytest.mark.parametrize("output", OUTPUTS)
def test_fitness_of_the_papers_models(linear, recording, published, output):
    run = linear_run(published.model_values, recording.time)
    found = linear.cost(linear.vector(published.model_values)[None, :], output)[0]
    assert found == pytest.approx(eq6(recording, run, output), rel=2e-4)


def test_transfer_function_is_a_second_order_step_response(opened, recording):
    gain, inertia, damping, stiffness = 0.0011, 0.0219, 0.0071, 0.0375
    omega, sigma = np.sqrt(stiffness / inertia), damping / (2.0 * inertia)
    ringing = np.sqrt(omega**2 - sigma**2)

    def step(t):
        t = np.maximum(t, 0.0)
        return 1.0 - np.exp(-sigma * t) * (np.cos(ringing * t) + sigma / ringing * np.sin(ringing * t))

    expected = 24.0 * gain / stiffness * (step(recording.time) - step(recording.time - 20.0))
    found = opened[1].simulate(np.array([[gain]]))[0, :, 0]
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_stator_and_rotor_inertia_act_as_a_sum(linear):
    base = UNOPTIMISED.model_values
    runs = linear.simulate(
        np.array([linear.vector(base | {"J_r": j, "J_s": 8e-6 - j}) for j in (4e-6, 1e-9, 7.999e-6)])
    )
    scaled = runs / np.abs(runs[0]).max(axis=0)
    np.testing.assert_allclose(scaled[1:], np.broadcast_to(scaled[0], scaled[1:].shape), atol=1e-5)


def test_coarse_steps_do_not_find_the_inertia(linear):
    """A step of 0.1 kg m^2 from 4e-6 sees a cost that rises, where the exact slope falls."""
    base = UNOPTIMISED.model_values
    end = coarse_stage(linear, PAPER_STAGES[1], base)
    assert end.cost <= end.start_cost
    assert scaled_stage(linear, PAPER_STAGES[1], base).cost < 0.9 * end.cost


def test_scaled_stage_finds_the_least_squares_solution(linear, recording):
    """The electrical stage against SciPy's trust-region method on the closed form."""
    base = UNOPTIMISED.model_values
    end = scaled_stage(linear, PAPER_STAGES[0], base)

    def residual(x):
        values = base | dict(zip(("R_a", "L_a"), np.exp(x), strict=True))
        return linear_run(values, recording.time)[:, 0] - recording.outputs["i_m"]

    other = least_squares(residual, np.log([base["R_a"], base["L_a"]]), xtol=1e-10, ftol=1e-10)
    assert end.cost == pytest.approx(2.0 * other.cost, rel=1e-5)
    assert end.values["R_a"] == pytest.approx(np.exp(other.x[0]), rel=1e-2)
    assert end.values["L_a"] == pytest.approx(np.exp(other.x[1]), rel=2e-2)


def test_swarm_repeats_with_its_seed_and_fails_in_words(recording, models, linear):
    ends = swarm_recipe(linear, "linear", np.random.default_rng(8))
    with WorkerPool(0) as pool:
        again, _ = open_models(recording, models, lambda problem: open_simulator(problem, pool=pool))
        twin = swarm_recipe(again, "linear", np.random.default_rng(8))
        other = swarm_recipe(again, "linear", np.random.default_rng(9))
    assert [end.values for end in ends] == [end.values for end in twin]
    assert [end.values for end in ends] != [end.values for end in other]
    for end in ends:
        for name in end.stage.parameters:
            assert BOX[name][0] <= end.values[name] <= BOX[name][1]
        assert (
            linear.cost(linear.vector(end.values)[None, :], end.stage.outputs[0])[0]
            == pytest.approx(end.cost, rel=1e-12)
            or end is not ends[-1]
        )


def test_a_rotor_without_inertia_is_a_counted_failure(linear):
    before = linear.outcomes.copy()
    values = linear.vector(UNOPTIMISED.model_values | {"J_r": 0.0, "J_s": 0.0})
    both = np.array([values, linear.vector({})])
    cost = linear.cost(both, "omega_m")
    assert np.isinf(cost[0])
    assert np.isfinite(cost[1])
    failed = linear.outcomes - before
    assert sum(count for outcome, count in failed.items() if outcome is not Outcome.OK) == 1


def test_outcomes_add_up(linear):
    before = linear.outcomes.total()
    linear.cost(np.array([linear.vector({})] * 3), "theta")
    assert linear.outcomes.total() == before + 3
    assert linear.outcomes[Outcome.OK] > 0
