"""Errors before and after in words."""

import math
import re

import pytest
from facts import facts

from aero_bayes.estimate.error_sentences import error_change, left_over
from aero_bayes.estimate.residual_tests import RecordingError, Verdict

pytestmark = pytest.mark.fast


def error(recording: str, output: str, before: float, after: float, verdict: Verdict = "noise") -> RecordingError:
    return RecordingError(recording, "test", output, before, after, 0.1, True, after / 0.1, math.nan, verdict)


def test_an_output_that_gets_worse_is_told_beside_the_one_that_gains_most() -> None:
    units = {"speed": "rad/s"}
    one = error_change([error("run", "speed", 1.0, 2.0), error("run", "angle", 1.0, 0.1)], units)
    assert re.search(facts("angle", "1", "0.1"), one)
    assert re.search(facts("speed", "1", "2 rad/s"), one)
    assert "speed" not in error_change([error("run", "speed", 1.0, 1.01), error("run", "angle", 1.0, 0.1)], units)


def test_a_recording_on_which_the_error_grows_is_told_although_it_falls_in_the_mean() -> None:
    one = error_change([error("slow", "speed", 0.8, 0.2), error("fast", "speed", 0.842, 0.854)], {})
    assert re.search(facts("slow", "0.8", "0.2"), one)
    assert re.search(facts("fast", "0.842", "0.854"), one)


def test_what_is_left_is_told_of_each_output_once() -> None:
    (one,) = left_over([error("a", "y", 1.0, 0.4, "too large"), error("b", "y", 1.0, 0.1, "structured"),
                        error("c", "y", 1.0, 0.1)])  # fmt: skip
    assert re.search(facts("4", "recording a", "recording b"), one)
    assert "recording c" not in one
