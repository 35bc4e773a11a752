"""Models that crash, hang, fail, flood or return nonsense cost one typed outcome each; the batch goes on."""

from __future__ import annotations

import os
import signal
import threading
import time as clock

import numpy as np
import pytest
from runs import ran

from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import Experiment, Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import MAX_LOST_RUNS, WorkerPool

FINE, CRASH, HANG, FAIL, REJECT, FLOOD, NOT_A_NUMBER, REFUSE_START, EVENTS_FOREVER, GONE, FATALLY, STIFFEN, BLOW_UP = (
    range(13)
)
LEAK = 13
EXPECTED = {
    FINE: {Outcome.OK},
    CRASH: {Outcome.CRASHED},
    HANG: {Outcome.TIMED_OUT},
    FAIL: {Outcome.MODEL_ERROR},
    REJECT: {Outcome.SOLVER_FAILED, Outcome.NOT_FINITE},
    FLOOD: {Outcome.OK},
    NOT_A_NUMBER: {Outcome.NOT_FINITE},
    REFUSE_START: {Outcome.MODEL_ERROR},
    EVENTS_FOREVER: {Outcome.MODEL_ERROR},
    GONE: {Outcome.CRASHED},
    FATALLY: {Outcome.MODEL_ERROR},
    STIFFEN: {Outcome.SOLVER_FAILED, Outcome.NOT_FINITE, Outcome.TIMED_OUT},
    BLOW_UP: {Outcome.SOLVER_FAILED, Outcome.NOT_FINITE},
}
TIME = np.linspace(0.0, 2.0, 41)


def trouble(test_fmu, time_limit: float = 0.15, **other: object) -> Problem:
    settings = SolverSettings(time_limit=time_limit)
    experiment = Experiment(TIME, ("x",), measured=np.zeros((41, 1)))
    return Problem(test_fmu("Trouble", **other), (experiment,), ((ParameterTarget("mode"),),), settings=settings)


def test_every_kind_of_trouble(test_fmu, pool):
    modes = [m for mode in range(13) for m in (mode, FINE)]
    with NativeSimulator(trouble(test_fmu), pool=pool) as simulator:
        found = simulator.simulate(np.array(modes, dtype=float)[:, None])
        again = simulator.simulate(np.zeros((3, 1)))
    for mode, outcome, out in zip(modes, found.outcomes[:, 0], found.outputs[0], strict=True):
        assert Outcome(outcome) in EXPECTED[mode], mode
        if outcome == Outcome.OK:
            np.testing.assert_allclose(out[:, 0], np.exp(-TIME), atol=1e-5)
        else:
            assert np.all(np.isnan(out))
    assert np.all(again.outcomes == Outcome.OK)


@pytest.mark.long
@pytest.mark.parametrize("mode", [CRASH, HANG])
def test_a_model_that_is_lost_in_every_run_is_run_no_more(test_fmu, mode):
    every = np.full((200, 1), float(mode))
    with WorkerPool(2) as workers, NativeSimulator(trouble(test_fmu, 0.02), pool=workers) as simulator:
        for _ in range(2):
            assert set(simulator.simulate(every).outcomes.ravel()) == EXPECTED[mode]
        assert workers.group.replaced <= 2 * (MAX_LOST_RUNS + 2)  # a run whose worker crashes is tried once more
    with WorkerPool(2) as workers, NativeSimulator(trouble(test_fmu), pool=workers) as simulator:
        assert np.all(simulator.simulate(np.zeros((1, 1))).outcomes == Outcome.OK)
        simulator.simulate(np.full((2 * MAX_LOST_RUNS, 1), float(CRASH)))
        assert np.all(simulator.simulate(np.zeros((1, 1))).outcomes == Outcome.OK)


def test_trouble_in_the_reduced_calls(test_fmu, pool):
    values = np.array([[FINE], [CRASH], [NOT_A_NUMBER], [FINE]], dtype=float)
    noise = np.array([0.1, 0.0, 0.0])
    with NativeSimulator(trouble(test_fmu), pool=pool) as simulator:
        likelihood = simulator.log_likelihood(values, noise)
    assert list(likelihood.outcomes[:, 0]) == [Outcome.OK, Outcome.CRASHED, Outcome.NOT_FINITE, Outcome.OK]
    assert np.array_equal(np.isneginf(likelihood.log_likelihood[:, 0]), [False, True, True, False])


def test_not_finite_values_are_not_run(test_fmu, here):
    found = ran(trouble(test_fmu), here, [[np.nan], [np.inf], [0.0]])
    assert list(found.outcomes[:, 0]) == [Outcome.NOT_FINITE, Outcome.NOT_FINITE, Outcome.OK]


def test_results_do_not_depend_on_workers(test_fmu, pool, here, drive):
    rng = np.random.default_rng(5)
    signals = drive(TIME)
    experiments = tuple(
        Experiment(TIME, ("x", "y"), signals, measured=rng.standard_normal((41, 2)), start={"x": x}) for x in (0.5, 2.0)
    )
    targets = (ParameterTarget("k"), ParameterTarget("b"))
    problem = Problem(test_fmu("Dahlquist"), experiments, (targets, targets))
    values = rng.uniform(0.5, 2.0, (60, 2))
    noise = rng.uniform(0.1, 0.2, (60, 2, 2, 3))
    found = []
    with WorkerPool(2) as two:
        for workers in (here, pool, two):
            with NativeSimulator(problem, pool=workers) as simulator:
                likelihood = simulator.log_likelihood(values, noise).log_likelihood
                one_by_one = [simulator.log_likelihood(values[i : i + 1], noise[i : i + 1]) for i in range(5)]
                run = simulator.simulate(values, active=[1, 0])
                found.append((*run.sensitivities, likelihood, run.outputs[1]))
                np.testing.assert_array_equal(likelihood[:5], np.concatenate([o.log_likelihood for o in one_by_one]))
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_killed_worker_is_replaced(test_fmu):
    problem = trouble(test_fmu)
    with WorkerPool(1) as pool, NativeSimulator(problem, pool=pool) as simulator:
        simulator.simulate(np.zeros((1, 1)))
        (worker,) = pool.processes
        os.kill(worker, signal.SIGKILL)
        os.waitid(os.P_PID, worker, os.WEXITED | os.WNOWAIT)
        assert np.all(simulator.simulate(np.zeros((2, 1))).outcomes == Outcome.OK)
        assert pool.group.replaced == 1


def test_large_results_grow_the_shared_memory(test_fmu, pool):
    time = np.linspace(0.0, 1.0, 200_001)
    problem = Problem(test_fmu("Dahlquist"), (Experiment(time, ("x", "y")),), ((ParameterTarget("k"),),))
    found = ran(problem, pool, [[1.0], [2.0], [3.0]], active=[0])
    for row, k in enumerate((1.0, 2.0, 3.0)):
        np.testing.assert_allclose(found.outputs[0][row, :, 0], np.exp(-k * time), atol=1e-5)


def test_memory_is_bounded_in_the_batch(test_fmu, pool):
    problem = Problem(
        test_fmu("Dahlquist"),
        (Experiment(TIME, ("x",), measured=np.zeros((41, 1))),),
        ((ParameterTarget("k"),),),
        settings=SolverSettings(1e-3, 1e-3),
    )
    with NativeSimulator(problem, pool=pool) as simulator:
        simulator.log_likelihood(np.full((20_000, 1), 1.5), np.array([1.0, 0.0, 0.0]))
        before = pool.group.memory.size
        result = simulator.log_likelihood(np.full((100_000, 1), 1.5), np.array([1.0, 0.0, 0.0]))
        assert pool.group.memory.size == before
    assert np.unique(result.log_likelihood).size == 1


def test_wrong_shapes_and_names_are_named(test_fmu, here):
    model = test_fmu("Dahlquist")
    good = Experiment(TIME, ("x",))
    with pytest.raises(InputError, match="nosuch"):
        NativeSimulator(Problem(model, (good,), ((ParameterTarget("nosuch"),),)), pool=here)
    with pytest.raises(InputError, match="increasing"):
        NativeSimulator(Problem(model, (Experiment(TIME[::-1], ("x",)),), ((),)), pool=here)
    with pytest.raises(InputError, match="wrong"):
        NativeSimulator(Problem(model, (Experiment(TIME, ("wrong",)),), ((),)), pool=here)
    with NativeSimulator(Problem(model, (good,), ((ParameterTarget("k"),),)), pool=here) as simulator:
        with pytest.raises(InputError, match="shape"):
            simulator.simulate(np.zeros((2, 3)))
        with pytest.raises(InputError, match="active"):
            simulator.simulate(np.zeros((2, 1)), active=[1])
        with pytest.raises(InputError, match="measurements"):
            simulator.log_likelihood(np.ones((1, 1)), np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize("workers", [0, 1])
def test_a_forked_child_runs_beside_its_parent(test_fmu, workers):
    with NativeSimulator(trouble(test_fmu), workers=workers) as simulator:
        noise = np.array([0.1, 0.0, 0.0])
        expected = simulator.log_likelihood(np.zeros((1, 1)), noise).log_likelihood
        child = os.fork()
        if child == 0:
            same = simulator.log_likelihood(np.zeros((1, 1)), noise).log_likelihood == expected
            os._exit(0 if same.all() else 1)
        again = simulator.log_likelihood(np.zeros((1, 1)), noise).log_likelihood
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        np.testing.assert_array_equal(simulator.log_likelihood(np.zeros((1, 1)), noise).log_likelihood, again)


def test_a_worker_that_leaks_is_recycled(test_fmu):
    problem = trouble(test_fmu)
    with WorkerPool(1, memory_limit=256 << 20) as pool, NativeSimulator(problem, pool=pool) as simulator:
        found = simulator.simulate(np.full((1200, 1), float(LEAK)))
        assert pool.group.recycled >= 2
        assert pool.group.replaced == 0
        again = simulator.simulate(np.full((200, 1), float(LEAK)))
    assert np.all(found.outcomes == Outcome.OK)
    assert np.all(again.outcomes == Outcome.OK)
    np.testing.assert_array_equal(np.unique(found.outputs[0], axis=0), again.outputs[0][:1])


def stopped(pool: WorkerPool, seconds: float) -> tuple[threading.Thread, list[int]]:
    """Take the processor from the worker in the middle of its next task; then the task that it was at is known."""
    task: list[int] = []

    def stop() -> None:
        (worker,) = pool.processes
        while pool.group.slots[0, 0] < 0:
            clock.sleep(0.001)
        os.kill(worker, signal.SIGSTOP)
        task.append(pool.group.slots[0, 0])
        clock.sleep(seconds)
        os.kill(worker, signal.SIGCONT)

    thread = threading.Thread(target=stop)
    thread.start()
    return thread, task


@pytest.mark.long
def test_a_run_without_a_processor_does_not_use_its_time(test_fmu):
    experiment = Experiment(np.linspace(0.0, 10_000.0, 11), ("x0",))
    settings = SolverSettings(max_steps=10**9, time_limit=3.0)
    problem = Problem(test_fmu("VanDerPol"), (experiment,), ((ParameterTarget("mu"),),), settings=settings)
    with WorkerPool(1) as pool, NativeSimulator(problem, pool=pool) as simulator:
        undisturbed = simulator.simulate(np.array([[1.0]]))
        thread, task = stopped(pool, 4.0)
        found = simulator.simulate(np.array([[1.0]]))
        thread.join()
    assert task == [0]
    assert np.all(found.outcomes == Outcome.OK)
    np.testing.assert_array_equal(found.outputs[0], undisturbed.outputs[0])
