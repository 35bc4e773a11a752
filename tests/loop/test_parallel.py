"""Independent tasks over forked worker processes give what they give one after the other."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Iterable
from functools import partial

import pytest

from aero_bayes.parallel import ParallelMap, Task
from aero_bayes.simulation.workers import WorkerPool

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are forked")


class Questions:
    """Numbers that are squared by whoever is asked, and how often each was."""

    def __init__(self) -> None:
        self.counts, self.asker = Counter[int](), os.getpid()

    def ask(self, number: int) -> tuple[int, int]:
        """The square of a number and the process that worked it out."""
        if os.getpid() != self.asker and number == 13:
            os._exit(1)
        if number == 7:
            raise ValueError("nobody knows")
        time.sleep(0.02)
        self.counts[number] += 1
        return number**2, os.getpid()

    def tasks(self, numbers: Iterable[int]) -> list[Task[tuple[int, int]]]:
        return [Task(partial(self.ask, number), self.counts) for number in numbers]


def asked(numbers, workers=3, late=lambda: False):
    questions, told = Questions(), []
    with WorkerPool(workers) as pool:
        found = ParallelMap(pool, late)(questions.tasks(numbers), told.append)
    return found, questions.counts, told


def test_workers_share_the_tasks_and_results_and_counts_come_back_in_order():
    found, counts, told = asked(range(100, 120))
    assert [square for square, _ in found] == [number**2 for number in range(100, 120)]
    by = {process for _, process in found}
    assert len(by) > 1
    assert os.getpid() not in by
    assert counts == Counter(range(100, 120))
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_what_a_dying_worker_was_at_is_done_in_the_asking_process():
    for numbers, workers in (([13, *range(100, 110)], 3), ([13, 13, 13, 13, 1, 2], 2)):
        found, counts, _ = asked(numbers, workers)
        assert [square for square, _ in found] == [number**2 for number in numbers]
        assert {process for square, process in found if square == 169} == {os.getpid()}
        assert counts == Counter(numbers)


def test_what_a_task_raises_is_raised_in_the_asking_process():
    with pytest.raises(ValueError, match="nobody knows"):
        asked([7, *range(100, 110)])


def test_one_worker_means_no_further_process():
    found, counts, told = asked(range(5), workers=1)
    assert found == [(number**2, os.getpid()) for number in range(5)]
    assert counts == Counter(range(5))
    assert told[-1] == 1.0


def test_nothing_is_begun_late():
    for workers in (1, 3):
        found, counts, told = asked(range(5), workers, late=lambda: True)
        assert found == [None] * 5
        assert not counts
        assert told == []


def test_an_interruption_ends_the_workers_at_once():
    questions, began = Questions(), time.monotonic()

    def interrupt(done: float) -> None:
        raise KeyboardInterrupt

    with WorkerPool(2) as pool, pytest.raises(KeyboardInterrupt):
        ParallelMap(pool)([*questions.tasks([1]), Task(partial(time.sleep, 600.0))], interrupt)
    assert time.monotonic() - began < 60.0
