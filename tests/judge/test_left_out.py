"""Errors on readings that were left out, against least squares without them: exact for linear models."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest

from aero_bayes.estimate import LocalFitSettings, LocalSettings, Normal, Objective, Parameter
from aero_bayes.estimate.leave_out import BLOCK_COUNT
from aero_bayes.laws import CandidateTerm
from aero_bayes.search import (
    CandidateModel,
    CommonBlocks,
    Comparison,
    FitNoise,
    Structure,
    newton_errors,
    refitted_errors,
)
from aero_bayes.sensors import OutputNoise
from aero_bayes.simulation import ParameterTarget, open_simulator

pytestmark = pytest.mark.fast

EXACT = LocalFitSettings(LocalSettings(iterations=40, tolerance=1e-10), hold_noise=True)
PRIOR_SD = 3.0
TIME = np.arange(200) * 0.05
WAVE, NOTHING = Structure(("wave",)), Structure()


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
    model = CandidateModel(Objective(problem, simulator), candidates, own, open_simulator)
    noise = FitNoise({o: OutputNoise(sd) for o, sd in zip(outputs, (0.1, 0.4), strict=False)})
    return [model.fit(s, model.coordinates_of({}, ()), noise, EXACT) for s in (WAVE, NOTHING)]


def squares_without(x, y, blocks):
    """Squared error of each block, predicted by a ridge regression of all other readings."""
    found = []
    for block in blocks:
        rest = np.setdiff1d(np.arange(y.size), block)
        p = np.linalg.solve(x[rest].T @ x[rest] + np.eye(x.shape[1]) / PRIOR_SD**2, x[rest].T @ y[rest])
        found.append(float(np.sum((y[block] - x[block] @ p) ** 2)))
    return np.array(found)


def compared(fits):
    common = CommonBlocks.of(fits)
    return Comparison({f.structure: newton_errors(f, common) for f in fits}, common.outputs, common.least)


@pytest.mark.parametrize("size", [0.0, 0.05, 1.0])
def test_blocks_of_time_are_predicted_as_by_least_squares_without_them(size):
    rng = np.random.default_rng(3)
    x = rows(TIME)
    y = x @ [1.0, 2.0, size] + 0.1 * rng.normal(size=TIME.size)
    fits = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)
    common = CommonBlocks.of(fits)
    blocks = [block for (block,) in common.folds]
    assert len(blocks) == BLOCK_COUNT
    assert sorted(np.concatenate(blocks).tolist()) == list(range(TIME.size))
    for fitted, columns in zip(fits, ([0, 1, 2], [0, 1]), strict=True):
        exact = squares_without(x[:, columns] / 0.1, y / 0.1, blocks)
        np.testing.assert_allclose(newton_errors(fitted, common)[:, 0], exact, rtol=1e-6)
        again = [refitted_errors(fitted, common, k, EXACT)[0, 0] for k in range(len(blocks))]
        np.testing.assert_allclose(again, exact, rtol=1e-6)


def test_a_block_is_left_out_of_all_outputs_each_counted_alone():
    rng = np.random.default_rng(4)
    x = np.concatenate([rows(TIME) / 0.1, -2.0 * rows(TIME)[:, ::-1] / 0.4])
    noisy = x @ [1.0, 2.0, 0.1] + rng.normal(size=2 * TIME.size)
    y = np.stack([noisy[: TIME.size] * 0.1, noisy[TIME.size :] * 0.4], axis=-1)
    fits = study([TIME], [y], lambda t, k: -2.0 * rows(t)[:, ::-1] if k else rows(t), [free(n) for n in "abc"], 2)
    common = CommonBlocks.of(fits)
    exact = squares_without(x, noisy, [block for (block,) in common.folds])
    np.testing.assert_allclose(newton_errors(fits[0], common).sum(axis=1), exact, rtol=1e-6)
    np.testing.assert_allclose(
        [refitted_errors(fits[0], common, k, EXACT).sum() for k in range(3)], exact[:3], rtol=1e-6
    )
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
    common = CommonBlocks.of(fits)
    folds = [np.concatenate(fold) for fold in common.folds]
    assert [fold.tolist() for fold in folds] == np.arange(whole.size).reshape(3, -1).tolist()
    p = np.linalg.solve(x.T @ x + np.eye(6) / PRIOR_SD**2, x.T @ y)
    exact = squares_without(x[:, :3], y - x[:, 3:] @ p[3:], folds)
    newton = newton_errors(fitted, common)[:, 0]
    # Errors are summed by block of time, so that there are enough of them to resample.
    assert newton.size == 3 * (BLOCK_COUNT // 3)
    np.testing.assert_allclose(newton.reshape(3, -1).sum(axis=1), exact, rtol=1e-5)
    np.testing.assert_allclose([refitted_errors(fitted, common, k, EXACT).sum() for k in range(3)], exact, rtol=1e-5)


def test_a_term_that_is_not_there_does_not_predict_clearly_better():
    """Hardly one data set passes two standard errors by chance; with a wave as large as the noise nearly all do."""
    clear = {0.0: 0, 0.1: 0}
    for seed in range(20):
        noise = 0.1 * np.random.default_rng(50 + seed).normal(size=TIME.size)
        for size in clear:
            y = rows(TIME) @ [1.0, 2.0, size] + noise
            fits = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)
            clear[size] += compared(fits).clearly_better(WAVE, NOTHING)
    assert clear[0.0] <= 2
    assert clear[0.1] >= 17


def test_share_and_its_spread_are_those_of_the_errors():
    """Errors of independent blocks: the share is known, and its standard error falls with their number."""
    rng = np.random.default_rng(7)
    spreads = []
    for blocks in (20, 320):
        one, other = rng.chisquare(8, (blocks, 1)), 4.0 * rng.chisquare(8, (blocks, 1))
        found = Comparison({WAVE: one, NOTHING: other}, ("y",), np.zeros(1)).share(WAVE, NOTHING)
        # The variance of a chi-square of 8 is a quarter of its squared mean; the root halves both.
        assert found.value == pytest.approx(0.5, abs=5.0 * 0.5 * 0.5 * np.sqrt(0.5 / blocks))
        assert found.sd == pytest.approx(0.5 * 0.5 * np.sqrt(0.5 / blocks), rel=0.5)
        spreads.append(found.sd)
    assert spreads[1] < 0.5 * spreads[0]


def test_an_error_that_falls_by_three_tenths_is_surely_a_quarter_lower_with_many_blocks_only():
    rng = np.random.default_rng(13)
    for blocks, sure in ((10, False), (2000, True)):
        one, other = 0.7**2 * rng.chisquare(8, (blocks, 1)), rng.chisquare(8, (blocks, 1))
        found = Comparison({WAVE: one, NOTHING: other}, ("y",), np.zeros(1))
        assert found.surely_much_better(WAVE, NOTHING, 0.75) == sure


@pytest.mark.parametrize(("gap", "ahead"), [(1e-6, False), (1e-2, True)])
def test_what_fits_do_not_converge_to_is_no_difference(gap, ahead):
    """Two laws that do the same differ by the same little in every block, so that the spread is less still."""
    one = np.random.default_rng(8).chisquare(5, (20, 1))
    other = (1.0 + gap * np.linspace(0.9, 1.1, 20)[:, np.newaxis]) * one
    assert Comparison({WAVE: one, NOTHING: other}, ("y",), np.zeros(1)).clearly_better(WAVE, NOTHING) is ahead


def test_an_output_that_is_predicted_exactly_does_not_decide():
    """Below rounding one error is as good as another; the other output tells the structures apart."""
    exact, worse = np.full((10, 1), 1e-20), np.full((10, 1), 1e-14)
    noisy = np.random.default_rng(8).chisquare(5, (10, 1))
    found = Comparison(
        {WAVE: np.hstack([worse, noisy]), NOTHING: np.hstack([exact, 4.0 * noisy])},
        ("y", "z"),
        np.array([1e-10, 1e-10]),
    )
    assert found.scores[NOTHING] - found.scores[WAVE] == pytest.approx(np.log(4.0))
    assert found.share(WAVE, NOTHING).output == "z"


def test_wins_add_up_and_few_blocks_need_more_standard_errors():
    rng = np.random.default_rng(9)
    errors = {WAVE: rng.chisquare(4, (20, 1)), NOTHING: rng.chisquare(4, (20, 1))}
    wins = Comparison(errors, ("y",), np.zeros(1)).wins([WAVE, NOTHING])
    assert sum(wins.values()) == pytest.approx(1.0)
    # Six blocks whose errors halve, more or less: over two standard errors, which is not clear with so few.
    few = {WAVE: np.ones((6, 1)), NOTHING: np.array([[0.9], [1.0], [1.1], [1.3], [1.8], [1.3]])}
    found = Comparison(few, ("y",), np.zeros(1))
    assert 2.0 < found.ahead(WAVE, NOTHING) < 2.6
    assert not found.clearly_better(WAVE, NOTHING)
    # Of three blocks nothing is clear.
    three = Comparison(
        {s: e[:3] for s, e in {WAVE: 0.5 * few[WAVE], NOTHING: few[NOTHING]}.items()}, ("y",), np.zeros(1)
    )
    assert three.ahead(WAVE, NOTHING) > 5.0
    assert not three.clearly_better(WAVE, NOTHING)
