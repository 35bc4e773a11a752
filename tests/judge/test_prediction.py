"""Errors before and after in words, and what makes one prediction surely worse than another."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

from aero_bayes.data import Recording
from aero_bayes.judge import Prediction, Recordings, RmsError, describe_error_change, surely_worse

pytestmark = pytest.mark.fast


def prediction(**rms: float) -> Prediction:
    return Prediction({}, {("run", output): RmsError(value, 0.02 * value, 100) for output, value in rms.items()}, {})


def test_an_output_that_gets_worse_is_told_beside_the_one_that_gains_most() -> None:
    units = {"speed": "rad/s"}
    one = describe_error_change(prediction(speed=1.0, angle=1.0), prediction(speed=2.0, angle=0.1), units)
    assert re.search(r"angle\b.*\b1\b.*\b0\.1\b.*speed\b.*\b1\b.*\b2 rad/s", one)
    assert "speed" not in describe_error_change(
        prediction(speed=1.0, angle=1.0), prediction(speed=1.01, angle=0.1), units
    )


@pytest.mark.parametrize(("missed", "sure"), [(0.0, False), (1.0, True)])
def test_what_a_disturbance_gives_or_takes_is_not_surely_better(missed: float, sure: bool) -> None:
    """Slow disturbance of size 1 in two readings of the same kind; one prediction misses a sine beside it."""
    rng = np.random.default_rng(3)
    time = np.arange(4000) * 0.1
    counts = 0
    for _ in range(40):
        slow, wrong, other = lfilter([0.1], [1.0, -0.995], rng.standard_normal((3, time.size)))
        sine = missed * np.sin(0.8 * time)
        recording = Recording("run", time, {"u": sine}, {"y": sine + slow}, {"time": "s"}, "")
        test = {("run", "y"): RmsError(1.0, 0.1, time.size)}
        one = Prediction({}, test, {("run", "y"): 0.1 * wrong})
        two = Prediction({}, test, {("run", "y"): sine + 0.1 * other})
        counts += bool(surely_worse(one, two, Recordings((), (recording,), (), {}, ("y",))))
    # without a difference two standard deviations are passed in 2 % of cases, correlation being estimated in a few more
    assert counts >= 36 if sure else counts <= 10
