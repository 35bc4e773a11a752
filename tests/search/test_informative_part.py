"""The part of the recordings on which starts are looked for, on linear models whose information is known."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest

from aero_bayes.estimate import LocalFitSettings, NoiseModel, Normal, Objective, Parameter
from aero_bayes.laws import CandidateTerm
from aero_bayes.loop.long_recordings import FIRST_ROWS, rows_that_tell_enough
from aero_bayes.search import CandidateModel, FitNoise, Structure
from aero_bayes.search.informative_part import informative_share
from aero_bayes.sensors import OutputNoise
from aero_bayes.simulation import Experiment, ParameterTarget, Problem, Trajectories, open_simulator

pytestmark = pytest.mark.fast


class LinearSimulator:
    """Answers ``y = basis' p`` with exact sensitivities."""

    def __init__(self, time, measured, basis):
        self.basis = basis
        self.problem = Problem(None, (Experiment(time, ("y",), measured=measured[:, None]),), ((None,) * len(basis),))

    def simulate(self, values, *, active=None):
        slopes = None
        if active is not None:
            slopes = (np.repeat(self.basis[list(active)].T[None, :, None, :], len(values), axis=0),)
        outcomes = np.zeros((len(values), 1), dtype=np.uint8)
        return Trajectories(((values @ self.basis)[:, :, None],), slopes, outcomes)

    def close(self):
        pass


def share(time, own, term, missing):
    """The share of the fit's recording on which structures are explored."""
    return informative_share(first_fit(time, own, term, missing))


def first_fit(time, own, term, missing):
    """The fit of a model with one parameter and one candidate, given the response to each and what is missing."""
    basis = np.stack([own, term])
    measured = own + missing + np.random.default_rng(5).normal(0.0, 0.1, time.size)
    items = [
        Parameter(name, "1", 0.0, -50.0, 50.0, Normal(0.0, 3.0), "linear", "", ParameterTarget(name)) for name in "ab"
    ]
    problem = closed_form.calibration([(time, measured[:, None])], ["y"], items, NoiseModel())
    objective = Objective(problem, LinearSimulator(time, measured, basis))
    model = CandidateModel(objective, {"term": CandidateTerm("term", "p", ((1.0,),), (1,))}, (0,), open_simulator)
    noise = FitNoise({"y": OutputNoise(0.5)})
    return model.fit(Structure(), model.coordinates_of({}, ()), noise, LocalFitSettings(hold_noise=True))


LONG = np.arange(6000) * 0.05


def test_a_beginning_is_enough_where_all_goes_on_alike():
    wave, other = np.sin(LONG), np.cos(1.7 * LONG)
    assert share(LONG, wave, other, 0.5 * other) == 0.15  # 900 readings; a tenth of them has less than 800


def test_the_part_reaches_until_a_parameter_or_a_term_has_acted():
    wave, late = np.sin(LONG), np.where(0.2 * LONG[-1] < LONG, np.cos(1.7 * LONG), 0.0)
    for own, term in ((wave, late), (late, wave)):
        # Needed is half of the information per reading: at 30 % it is an eighth of all, at 40 % a quarter.
        assert share(LONG, own, term, 0.5 * np.cos(2.3 * LONG)) == 0.4


@pytest.mark.parametrize(
    ("term", "missing"),
    [
        (np.where(0.6 * LONG[-1] < LONG, 1.0, 0.0), np.cos(2.3 * LONG)),
        (np.cos(1.7 * LONG), np.where(0.6 * LONG[-1] < LONG, np.cos(2.3 * LONG), 0.0)),
    ],
)
def test_all_readings_are_taken_where_the_beginning_shows_too_little(term, missing):
    assert share(LONG, np.sin(LONG), term, missing) == 1.0


def test_all_is_taken_of_a_short_recording():
    few = LONG[:1500]
    assert share(few, np.sin(few), np.cos(1.7 * few), 0.5 * np.cos(1.7 * few)) == 1.0


def rows(time, own, missing, length):
    """Rows of a recording of some length on which the loop works, the fit having few of its readings."""
    found = first_fit(time, own, np.cos(1.7 * time), missing)
    return rows_that_tell_enough(found.model.objective, found.optimum, [length])


def test_of_a_very_long_recording_the_first_rows_are_enough_where_all_goes_on_alike():
    assert rows(LONG, np.sin(LONG), np.cos(2.3 * LONG), 1_000_000) == FIRST_ROWS


def test_the_beginning_of_a_very_long_recording_is_doubled_until_a_parameter_or_what_is_missing_has_acted():
    wave, late = np.sin(LONG), np.where(0.2 * LONG[-1] < LONG, np.cos(2.3 * LONG), 0.0)
    # Needed is half of the information per reading, 40 % of all: at 40 % of the rows a half of them has acted.
    assert rows(LONG, wave, late, 1_000_000) == 16 * FIRST_ROWS
    assert rows(LONG, late, wave, 1_000_000) == 16 * FIRST_ROWS
    assert rows(LONG, wave, np.where(0.8 * LONG[-1] < LONG, wave, 0.0), 200_000) >= 200_000
