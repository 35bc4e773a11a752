"""Helpers find result_cache before they are asked for, and change nothing."""

from __future__ import annotations

import os
import sys
import time

import numpy as np
import pytest

from aero_bayes.checkpoint import ResultCache
from aero_bayes.data import Recording
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.simulation import WorkerPool
from aero_bayes.speculative import SpeculativeExecutor, doubling_batches

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="helpers are forked")

SOURCE = """model Cart "A cart in a viscous fluid"
  parameter Real m(unit = "kg", min = 0) = 1;
  parameter Real c(unit = "N.s/m", min = 0) = 1;
  input Real F(unit = "N");
  output Real v(unit = "m/s");
protected
  Real w(unit = "m/s", start = 0, fixed = true);
equation
  m*der(w) = F - c*w;
  v = w;
end Cart;
"""


class Questions:
    """Numbers that are worked out once, and by whom."""

    def __init__(self) -> None:
        self.result_cache, self.asker = ResultCache(), os.getpid()

    def ask(self, number: int) -> int:
        known = self.result_cache.get(str(number))
        if known is None:
            if os.getpid() != self.asker and number == 13:
                os._exit(1)
            if number == 7:
                raise ValueError("nobody knows")
            time.sleep(0.02)
            known = {"square": np.array(number**2), "by": np.array(os.getpid())}
            self.result_cache.put(str(number), known)
        return int(known["square"])

    def by(self, number: int) -> int | None:
        known = self.result_cache.get(str(number))
        return int(known["by"]) if known is not None else None


def asked(numbers, workers=3, late=lambda: False):
    questions, told = Questions(), []
    with WorkerPool(workers) as pool:
        tasks = [lambda number=number: questions.ask(number) for number in numbers]
        SpeculativeExecutor(questions.result_cache, pool, late)(tasks, told.append)
    return questions, told


def test_helpers_share_the_work_and_send_what_they_found():
    questions, told = asked(range(100, 120))
    workers = {questions.by(number) for number in range(100, 120)}
    assert os.getpid() not in workers
    assert None not in workers
    assert len(workers) > 1
    assert told[-1] == 1.0
    assert told == sorted(told)
    assert [questions.ask(number) for number in range(100, 120)] == [number**2 for number in range(100, 120)]


def test_a_helper_that_dies_or_fails_leaves_its_question_to_the_asker():
    questions, _ = asked([13, 7, *range(100, 110)])
    assert questions.by(13) is None
    assert questions.by(7) is None
    assert all(questions.by(number) is not None for number in range(100, 110))
    assert questions.ask(13) == 169
    assert questions.by(13) == os.getpid()
    with pytest.raises(ValueError, match="nobody knows"):
        questions.ask(7)


def test_where_all_helpers_die_the_asker_goes_on():
    questions, _ = asked([13, 13, 13, 13, 13, 1, 2], workers=2)
    assert questions.by(1) is None
    assert questions.ask(1) == 1


def test_nothing_is_begun_late_or_without_a_second_worker():
    for questions, told in (asked(range(5), late=lambda: True), asked(range(5), workers=1)):
        assert questions.result_cache.known() == frozenset()
        assert told == []


def test_what_goes_wrong_in_the_asker_ends_the_helpers_at_once():
    questions, began = Questions(), time.monotonic()

    def interrupt(done: float) -> None:
        raise KeyboardInterrupt

    with WorkerPool(2) as pool, pytest.raises(KeyboardInterrupt):
        SpeculativeExecutor(questions.result_cache, pool)(
            [lambda: questions.ask(1), lambda: time.sleep(600.0)], interrupt
        )
    assert time.monotonic() - began < 60.0


def test_waves_double_and_hold_everything_in_order():
    assert [list(wave) for wave in doubling_batches(range(12), 2)] == [[0, 1], [2, 3, 4, 5], [6, 7, 8, 9, 10, 11]]
    assert list(doubling_batches([], 5)) == []


def recording(name: str, seed: int) -> Recording:
    """A cart with drag by the square of its speed beside the viscous one, by the explicit midpoint rule."""
    rng = np.random.default_rng(seed)
    force, v, h = np.repeat(rng.normal(0.0, 3.0, 30), 10), np.zeros(300), 0.05
    for n in range(299):
        now = v[n]
        for _ in range(50):
            half = now + h / 100.0 * (force[n] - now - 0.8 * now * abs(now))
            now += h / 50.0 * (force[n] - half - 0.8 * half * abs(half))
        v[n + 1] = now
    return Recording(name, h * np.arange(300), {"F": force}, {"v": v + rng.normal(0.0, 0.005, 300)})


def test_the_loop_says_the_same_whoever_helps(tmp_path):
    source = tmp_path / "Cart.mo"
    source.write_text(SOURCE)
    settings = LoopSettings(sources=(source,), free=("m", "c"), cache=tmp_path / "fmu")
    train, test = recording("train", 31), recording("test", 32)
    results = [close_loop([train], [test], model="Cart", settings=settings, workers=workers) for workers in (1, 2)]
    told = [
        (
            r.outcome,
            r.simulations,
            [[(rival.id, rival.gain, rival.odds) for rival in step.candidates] for step in r.steps],
        )
        for r in results
    ]
    assert told[0] == told[1]
    assert results[0].outcome == "extended"
    assert [effect.id for effect in results[0].effects] == ["quadratic_drag@w"]
