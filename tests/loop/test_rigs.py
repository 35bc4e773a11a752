"""The loop finds the law that each rig lacks, with the right values, and predicts what it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from closed_form import square_wave_lag
from rigs import METER, RIGS, Rig

from aero_bayes.data import Recording
from aero_bayes.loop import LoopResult
from aero_bayes.loop.first_fit import FIRST_ROWS
from aero_bayes.loop.search import Effort

Closed = Callable[[str], LoopResult]


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Closed:
    """``closed(name)`` is the result of a rig's loop, done once."""
    return cache(lambda name: RIGS[name].closed(tmp_path_factory.mktemp(name)))


@pytest.mark.parametrize("name", RIGS)
def test_the_missing_law_is_named_with_its_values(name: str, closed: Closed) -> None:
    rig, found = RIGS[name], closed(name)
    (effect,) = found.effects
    assert effect.id == rig.effect, found.sentence
    values = [p.value for p in effect.parameters]
    for value, truth, most in rig.known:
        assert value(values) == pytest.approx(truth, abs=most)
    for own, (truth, share) in rig.values.items():
        assert found.parameters[own].value == pytest.approx(truth, rel=share)
    if rig.output:
        assert found.predicted_before.pooled("test")[rig.output] > rig.before
        assert found.predicted_after.pooled("test")[rig.output] < rig.after


@pytest.mark.parametrize(("name", "output", "share"), [("spring", "y", 0.05), ("cart", "x", 0.2)])
def test_the_error_on_an_unseen_run_falls_by_far(name: str, output: str, share: float, closed: Closed) -> None:
    before, after = (p.test["b", output].rms for p in (closed(name).predicted_before, closed(name).predicted_after))
    assert after < share * before


def test_intervals_hold_the_truth(closed: Closed) -> None:
    (start,) = closed("room").effects[0].parameters
    assert start.q05 < 2.0 < start.q95
    for p, truth in zip(closed("geared").effects[0].parameters, (0.3, 0.02 / 0.3), strict=False):
        assert p.q05 - 0.02 * truth <= truth <= p.q95 + 0.02 * truth


def test_a_short_recording_validates_and_none_is_left_for_a_test(closed: Closed) -> None:
    after = closed("body").predicted_after
    assert not after.test
    assert after.pooled("validation")["z"] < 0.06  # it begins at a reading


def test_a_long_recording_is_searched_on_its_beginning(closed: Closed) -> None:
    assert closed("oscillator").table.readings == FIRST_ROWS / 2  # every second reading of a third of the rows


def test_no_law_is_claimed_where_the_effort_ends_before_all_was_tried(
    closed: Closed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = closed("geared").effects[0]
    assert (whole.claim, whole.tried_all) == ("law", True)
    monkeypatch.setattr(Effort, "of", lambda steps: Effort(fitted=(1, 6), swaps=0))
    (effect,) = RIGS["geared"].closed(tmp_path).effects
    assert (effect.claim, effect.tried_all) == ("place", False)


def test_the_fits_of_a_result_still_simulate(closed: Closed) -> None:
    """Their FMUs are there as long as the result."""
    found, (_, test) = closed("meter"), RIGS["meter"].recordings()
    for fit, told in ((found.before, found.predicted_before), (found.after, found.predicted_after)):
        assert fit.simulate(test).outputs["y"] == pytest.approx(told.fitted["b", "y"], abs=1e-6)


def test_the_loop_says_the_same_whatever_the_number_of_workers(closed: Closed, tmp_path: Path) -> None:
    told = [
        (r.outcome, r.simulations, [[(rival.id, rival.share) for rival in step.candidates] for step in r.steps])
        for r in (closed("body"), RIGS["body"].closed(tmp_path, workers=2))
    ]
    assert told[0] == told[1]


def unseen(name: str, seed: int) -> Recording:
    """A lag whose gain is larger by a tenth in the run that is not fitted."""
    return square_wave_lag(np.random.default_rng(seed), 2.0 if name == "a" else 2.2, name=name)


def test_a_model_that_misses_unseen_data_by_far_is_not_adequate(tmp_path: Path) -> None:
    found = Rig(METER, unseen, (5, 6), ("T", "K"), ("gain", "offset"), "", most=1).closed(tmp_path)
    assert found.outcome == "unexplained"
    assert "error of y" in found.sentence
