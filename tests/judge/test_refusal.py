"""Unseen readings may refuse a name: on predictions that are made up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aero_bayes.check import ResidualReport
from aero_bayes.data import Recording
from aero_bayes.judge import MAX_ERROR_RATIO, Prediction, Recordings, rejection_reason, rms_error

pytestmark = pytest.mark.fast

TIME = np.arange(2000) * 0.05
NOISE = np.random.default_rng(1).normal(0.0, 0.1, (2, TIME.size))
UNSEEN = Recording("run", TIME, {"u": np.sin(TIME)}, {"y": NOISE[0], "z": NOISE[1]}, {"time": "s"}, "")
RECORDINGS = Recordings((), (UNSEEN,), (), {}, ("y", "z"))
SETTLED = ResidualReport("run", "y", 0.1, 0.1, 0.1, (), TIME[:1], TIME[:1], {}, (0.0, 1.0), 0.0, "adequate")
STRUCTURED = replace(SETTLED, rms=0.3, verdict="structured")


def predicted(**missed: float) -> Prediction:
    """What misses the readings by their noise and by a sine of some size, by output."""
    fitted = {("run", o): missed.get(o, 0.0) * np.sin(0.8 * TIME) for o in ("y", "z")}
    errors = {key: rms_error(UNSEEN.outputs[key[1]] - values) for key, values in fitted.items()}
    return Prediction({}, errors, fitted)


def test_what_is_predicted_better_is_not_refused():
    assert rejection_reason(predicted(y=0.5), predicted(y=0.1), RECORDINGS, [SETTLED]) is None
    assert rejection_reason(predicted(y=0.5), predicted(y=0.1), RECORDINGS, [STRUCTURED]) is None


def test_an_output_surely_predicted_worse_refuses_though_another_gains():
    said = rejection_reason(predicted(y=0.5), predicted(z=0.2), RECORDINGS, [SETTLED])
    assert "worse" in said
    assert "(z)" in said


def test_what_chance_takes_does_not_refuse():
    change = 1e-3 * np.random.default_rng(2).normal(size=TIME.size)
    before = predicted(y=0.5)
    fitted = {key: values + change for key, values in before.fitted.items()}
    assert rejection_reason(before, replace(before, fitted=fitted), RECORDINGS, [SETTLED]) is None


@pytest.mark.parametrize(
    ("share", "refused"), [(1.0, True), (MAX_ERROR_RATIO + 0.05, True), (MAX_ERROR_RATIO - 0.05, False)]
)
def test_structure_that_is_left_asks_for_an_error_that_falls_visibly(share, refused):
    before = predicted(y=1.0)
    after = predicted(y=1.0)
    for key, error in before.test.items():
        after.test[key] = replace(error, rms=share * error.rms)
    assert bool(rejection_reason(before, after, RECORDINGS, [STRUCTURED])) is refused
    assert rejection_reason(before, after, RECORDINGS, [SETTLED]) is None


def test_a_term_without_which_the_last_fit_leaves_hardly_more_is_refused():
    before, little, much = (replace(p, train=p.test, test={}) for p in map(lambda y: predicted(y=y), (1.0, 0.95, 0.5)))
    assert "last fit" in rejection_reason(before, little, RECORDINGS, [STRUCTURED])
    assert rejection_reason(before, little, RECORDINGS, [SETTLED]) is None
    assert rejection_reason(before, much, RECORDINGS, [STRUCTURED]) is None


def test_without_unseen_readings_nothing_is_refused():
    after = replace(predicted(y=1.0), test={})
    assert rejection_reason(predicted(), after, RECORDINGS, [STRUCTURED]) is None


@pytest.mark.parametrize(
    ("size", "left", "refused"),
    [(2.3, SETTLED, True), (1.5, SETTLED, False), (1.2, STRUCTURED, True), (1.05, STRUCTURED, False)],
)
def test_an_error_that_grows_refuses_even_with_few_readings(size, left, refused):
    """One slow drift is one independent reading."""
    few = replace(
        UNSEEN, time=TIME[:9], inputs={"u": np.zeros(9)}, outputs={o: y[:9] for o, y in UNSEEN.outputs.items()}
    )
    recordings = replace(RECORDINGS, test=(few,))

    def off(y, z):
        fitted = {("run", "y"): few.outputs["y"] + y, ("run", "z"): few.outputs["z"] + z}
        return Prediction({}, {k: rms_error(few.outputs[k[1]] - v) for k, v in fitted.items()}, fitted)

    said = rejection_reason(off(1.0, 1.0), off(0.3, size), recordings, [left])
    assert bool(said) is refused


def test_gain_of_one_output_does_not_cancel_equal_loss_of_another():
    before, after = predicted(y=1.0, z=1.0), predicted(y=1.0, z=1.0)
    for (name, output), error in before.test.items():
        after.test[name, output] = replace(error, rms={"y": 0.8, "z": 1.25}[output] * error.rms)
    assert rejection_reason(before, after, RECORDINGS, [STRUCTURED])
    assert rejection_reason(before, after, RECORDINGS, [SETTLED]) is None
