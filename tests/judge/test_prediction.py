"""Errors before and after in words."""

import re

import pytest

from aero_bayes.loop import Prediction, RmsError, describe_error_change

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
