"""What a part of the effects must do on unseen data to be named where all of them together do not carry over."""

import pytest

from aero_bayes.loop.decide import PARTLY, _plainly_better
from aero_bayes.loop.judge import Error, Prediction
from aero_bayes.loop.tell import gain_text


def prediction(**rms: float) -> Prediction:
    return Prediction({}, {("run", output): Error(value, 0.02 * value, 100) for output, value in rms.items()}, {})


@pytest.mark.parametrize(
    ("after", "better"),
    [
        ({"speed": 1.0, "angle": 0.3}, True),
        ({"speed": 1.01, "angle": 0.3}, True),  # an output that the effect does not reach
        ({"speed": 1.1, "angle": 0.3}, False),
        ({"speed": 0.9, "angle": 0.6}, False),
        ({"speed": 0.4, "angle": 0.4}, True),
    ],
)
def test_one_output_gains_much_and_none_loses(after: dict[str, float], better: bool) -> None:
    assert _plainly_better(prediction(speed=1.0, angle=1.0), prediction(**after)) is better


@pytest.mark.parametrize(("angle", "named"), [(0.3, False), (0.2, True)])
def test_more_is_asked_of_what_leaves_much(angle: float, named: bool) -> None:
    assert _plainly_better(prediction(speed=1.0, angle=1.0), prediction(speed=1.0, angle=angle), PARTLY) is named


def test_an_output_that_gets_worse_is_told_beside_the_one_that_gains_most() -> None:
    units = {"speed": "rad/s"}
    one = gain_text(prediction(speed=1.0, angle=1.0), prediction(speed=2.0, angle=0.1), units)
    assert one == (
        "on data that was not fitted the error of angle falls from 1 to 0.1, but of speed grows from 1 to 2 rad/s."
    )
    assert "speed" not in gain_text(prediction(speed=1.0, angle=1.0), prediction(speed=1.01, angle=0.1), units)
