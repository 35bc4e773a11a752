"""Errors on readings that were left out, and what a term promises, against least squares: exact for linear models."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest

from aero_bayes.estimate import Normal
from aero_bayes.estimate.levenberg_marquardt import LocalSettings
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.loop.folds import BLOCKS, FOLDS, Folds, newton_errors, refitted_errors
from aero_bayes.loop.modelica_family import CandidateTerm
from aero_bayes.loop.models import CandidateModel, FittedModel
from aero_bayes.loop.screen import Screen
from aero_bayes.loop.table import Row, Table
from aero_bayes.simulation.interface import ParameterTarget

pytestmark = pytest.mark.fast

EXACT = LocalFitSettings(LocalSettings(iterations=40, tolerance=1e-10), hold_noise=True)
PRIOR_SD = 3.0
TIME = np.arange(200) * 0.05
WAVE, NOTHING = ("wave",), ()


def free(name: str, recording: int | None = None) -> Parameter:
    prior, target = Normal(0.0, PRIOR_SD), ParameterTarget(name)
    return Parameter(name, "1", 0.0, -50.0, 50.0, prior, "linear", "", target, recording=recording)


def rows(time):
    """Design (n, 3): a constant and a ramp, which the first model has, and a wave, which it may lack."""
    return np.stack([np.ones_like(time), time / 10.0, np.sin(time)], axis=-1)


def study(times, measured, design, parameters, term):
    """The linear model ``y = design(time) p`` with and without the parameter ``term``, fitted under white noise."""
    outputs = ["y", "z"][: measured[0].shape[1]]
    problem = closed_form.calibration(list(zip(times, measured, strict=True)), outputs, parameters)
    simulator = closed_form.FormulaSimulator(
        problem.problem(), lambda time, p: np.stack([design(time, k) @ p for k in range(len(outputs))], axis=-1)
    )
    own = tuple(j for j in range(len(parameters)) if j != term)
    candidates = {"wave": CandidateTerm("wave", "one", ((1.0,),), (term,))}
    model = CandidateModel(Objective(problem, simulator), candidates, own)
    noise = {o: OutputNoise(sd) for o, sd in zip(outputs, (0.1, 0.4), strict=False)}
    start = model.coordinates_of({}, ())
    ends = {s: local_fit(model.objective, start, model.free(s), noise=noise, settings=EXACT) for s in (WAVE, NOTHING)}
    return [FittedModel(model, s, end) for s, end in ends.items()]


def squares_without(x, y, folds):
    """Squared error of each block of each fold, predicted by a ridge regression of all readings outside the fold."""
    found = []
    for blocks in folds:
        rest = np.setdiff1d(np.arange(y.size), np.concatenate(blocks))
        p = np.linalg.solve(x[rest].T @ x[rest] + np.eye(x.shape[1]) / PRIOR_SD**2, x[rest].T @ y[rest])
        found += [float(np.sum((y[block] - x[block] @ p) ** 2)) for block in blocks]
    return np.array(found)


@pytest.mark.parametrize("size", [0.0, 0.05, 1.0])
def test_folds_of_time_are_predicted_as_by_least_squares_without_them(size):
    rng = np.random.default_rng(3)
    x = rows(TIME)
    y = x @ [1.0, 2.0, size] + 0.1 * rng.normal(size=TIME.size)
    fits = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)
    common = Folds.of(fits[-1])
    blocks = [block for fold in common.blocks for block in fold]
    assert (len(common.folds), len(blocks)) == (FOLDS, BLOCKS)
    assert np.concatenate(blocks).tolist() == list(range(TIME.size))  # each fold is one stretch of time
    for fitted, columns in zip(fits, ([0, 1, 2], [0, 1]), strict=True):
        exact = 0.1**2 * squares_without(x[:, columns] / 0.1, y / 0.1, common.blocks)
        np.testing.assert_allclose(newton_errors(fitted, common)[:, 0], exact, rtol=1e-6)
        np.testing.assert_allclose(refitted_errors(fitted, common, EXACT)[:, 0], exact, rtol=1e-6)


def test_a_fold_is_left_out_of_all_outputs_each_counted_alone():
    rng = np.random.default_rng(4)
    x = np.concatenate([rows(TIME) / 0.1, -2.0 * rows(TIME)[:, ::-1] / 0.4])
    noisy = x @ [1.0, 2.0, 0.1] + rng.normal(size=2 * TIME.size)
    y = np.stack([noisy[: TIME.size] * 0.1, noisy[TIME.size :] * 0.4], axis=-1)
    fits = study([TIME], [y], lambda t, k: -2.0 * rows(t)[:, ::-1] if k else rows(t), [free(n) for n in "abc"], 2)
    common = Folds.of(fits[-1])
    exact = squares_without(x, noisy, common.blocks)
    for found in (newton_errors(fits[0], common), refitted_errors(fits[0], common, EXACT)):
        np.testing.assert_allclose((found / np.square([0.1, 0.4])).sum(axis=1), exact, rtol=1e-6)
    assert common.outputs == ("y", "z")


def test_one_of_three_recordings_is_left_out_and_its_offset_stays():
    """Each recording has an offset of its own, which readings of the others do not tell."""
    rng = np.random.default_rng(5)
    times = [TIME + 100.0 * k for k in range(3)]

    def design(time, k):
        return np.concatenate([rows(time), np.stack([(time // 100.0) == e for e in range(3)], axis=-1)], axis=-1)

    whole = np.concatenate(times)
    x = design(whole, 0) / 0.1
    y = x @ [1.0, 2.0, 0.3, -1.0, 0.5, 2.0] + rng.normal(size=whole.size)
    parameters = [*(free(n) for n in "abc"), *(free(f"o{e}", e) for e in range(3))]
    (fitted, _) = fits = study(times, [part[:, None] * 0.1 for part in np.split(y, 3)], design, parameters, 2)
    common = Folds.of(fits[-1])
    assert [fold.tolist() for fold in common.folds] == np.arange(whole.size).reshape(3, -1).tolist()
    p = np.linalg.solve(x.T @ x + np.eye(6) / PRIOR_SD**2, x.T @ y)
    exact = 0.1**2 * squares_without(x[:, :3], y - x[:, 3:] @ p[3:], common.blocks)
    np.testing.assert_allclose(newton_errors(fitted, common)[:, 0], exact, rtol=1e-5)
    np.testing.assert_allclose(refitted_errors(fitted, common, EXACT)[:, 0], exact, rtol=1e-5)


def test_the_start_of_a_law_that_a_fold_alone_tells_is_as_declared():
    """Of one recording, whose first fifth has all that an offset of its beginning changes."""
    rng = np.random.default_rng(6)
    start = np.arange(TIME.size) < 8
    x = np.stack([np.ones(TIME.size), TIME, start], axis=-1) / 0.1
    y = x @ [1.0, 2.0, 0.3] + rng.normal(size=TIME.size)
    parameters = [free("a"), free("b"), free("o0", 0)]
    (fitted, _) = fits = study([TIME], [y[:, None] * 0.1], lambda t, k: 0.1 * x, parameters, 2)
    common = Folds.of(fits[-1])
    exact = 0.1**2 * squares_without(x[:, :2], y, common.blocks)
    first = slice(len(common.blocks[0]))
    for found in (newton_errors(fitted, common), refitted_errors(fitted, common, EXACT)):
        np.testing.assert_allclose(found[first, 0], exact[first], rtol=1e-5)


def table(**errors):
    """A table of squared errors (blocks, outputs) by term, the last one also those of the first model.

    ``least`` counts as none."""
    least = np.array(errors.pop("least", [0.0]))
    rows = {(k,): Row((k,), np.asarray(e), 1) for k, e in errors.items()}
    rows[()] = Row((), list(rows.values())[-1].errors, 0)
    return Table(("y", "z")[: least.size], least, {}, {}, (), rows)


def test_share_and_its_spread_are_those_of_the_errors():
    """Errors of independent blocks: the share is known, and its standard error falls with their number."""
    rng = np.random.default_rng(7)
    spreads = []
    for blocks in (20, 320):
        one, other = rng.chisquare(8, (blocks, 1)), 4.0 * rng.chisquare(8, (blocks, 1))
        value, sd, _ = table(a=one, b=other).share(("a",), ("b",))
        # The variance of a chi-square of 8 is a quarter of its squared mean; the root halves both.
        assert value == pytest.approx(0.5, abs=5.0 * 0.5 * 0.5 * np.sqrt(0.5 / blocks))
        assert sd == pytest.approx(0.5 * 0.5 * np.sqrt(0.5 / blocks), rel=0.5)
        spreads.append(sd)
    assert spreads[1] < 0.5 * spreads[0]


def test_an_output_that_is_predicted_exactly_does_not_decide():
    """Below rounding one error is as good as another; the other output tells the structures apart."""
    exact, worse = np.full((10, 1), 1e-20), np.full((10, 1), 1e-14)
    noisy = np.random.default_rng(8).chisquare(5, (10, 1))
    found = table(a=np.hstack([worse, noisy]), b=np.hstack([exact, 4.0 * noisy]), least=[1e-10, 1e-10])
    assert found.score(("b",)) - found.score(("a",)) == pytest.approx(np.log(2.0))
    assert found.share(("a",), ("b",))[2] == "z"


def screened(size):
    """The first model without a wave, fitted to readings that have one, and the wave screened beside it."""
    x = rows(TIME)
    y = x @ [1.0, 2.0, size] + 0.1 * np.random.default_rng(3).normal(size=TIME.size)
    fitted = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)[-1]
    return x, y, Screen(fitted, fitted.model, "wave", Folds.of(fitted), np.array([0.05])).run()


def ridge(x, y):
    """Squared residual of a ridge regression under the same prior."""
    p = np.linalg.solve(x.T @ x + 0.1**2 * np.eye(x.shape[1]) / PRIOR_SD**2, x.T @ y)
    return y - x @ p


@pytest.mark.parametrize("size", [0.05, 1.0])
def test_a_promise_is_the_fall_of_the_error_by_least_squares(size):
    x, y, found = screened(size)
    before, after = (np.sum(ridge(part, y) ** 2) for part in (x[:, :2], x))
    assert found.gain == pytest.approx(0.5 * np.log(before / after), rel=1e-3)


def test_the_smallest_size_raises_what_is_left_by_a_third():
    """Readings of that size, the first model fitted to them, leave four thirds of what the noise alone leaves."""
    x, y, found = screened(0.0)
    more = ridge(x[:, :2], y + found.smallest * x[:, 2]), ridge(x[:, :2], y - found.smallest * x[:, 2])
    alone = ridge(x[:, :2], y)
    assert np.mean([np.sum(r**2) for r in more]) == pytest.approx(np.sum(alone**2) / 0.75**2, rel=1e-3)
    assert (found.port, found.parameter) == ("one", ("c", "1"))
    # its nominal size is one, and the sensor's noise half of what the fit leaves
    assert found.response == pytest.approx(np.linalg.norm(ridge(x[:, :2], x[:, 2])) / 0.05, rel=1e-3)
    assert found.imitators == ()
