"""Readings that are left out, foretold in closed form, against dense conditional densities: exact for linear models."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.estimate import LocalFitSettings, LocalSettings, Normal, Objective, Parameter
from aero_bayes.estimate.leave_out import BLOCK_COUNT
from aero_bayes.judge import blocks_of, held_out_gain
from aero_bayes.laws import CandidateTerm
from aero_bayes.search import CandidateModel, FitNoise, Structure
from aero_bayes.sensors import OutputNoise
from aero_bayes.simulation import ParameterTarget, open_simulator

EXACT = LocalFitSettings(LocalSettings(max_iterations=40, tolerance=1e-10), hold_noise=True)
PRIOR_SD = 3.0
TIME = np.arange(200) * 0.05


def free(name: str, recording: int | None = None) -> Parameter:
    prior, target = Normal(0.0, PRIOR_SD), ParameterTarget(name)
    return Parameter(name, "1", 0.0, -50.0, 50.0, prior, "linear", "", target, recording=recording)


def rows(time):
    """Design (n, 3): a constant and a ramp, which the first model has, and a wave, which it may lack."""
    return np.stack([np.ones_like(time), time / 10.0, np.sin(time)], axis=-1)


def study(times, measured, design, parameters, term, temperature=1.0):
    """The linear model ``y = design(time) p`` with and without the parameter ``term``, fitted under white noise."""
    outputs = ["y", "z"][: measured[0].shape[1]]
    problem = closed_form.calibration(list(zip(times, measured, strict=True)), outputs, parameters)
    simulator = closed_form.FormulaSimulator(
        problem.problem(), lambda time, p: np.stack([design(time, k) @ p for k in range(len(outputs))], axis=-1)
    )
    own = tuple(j for j in range(len(parameters)) if j != term)
    candidates = {"wave": CandidateTerm("wave", "one", ((1.0,),), (term,))}
    model = CandidateModel(Objective(problem, simulator), candidates, own, open_simulator)
    noise = FitNoise({o: OutputNoise(sd) for o, sd in zip(outputs, (0.1, 0.4), strict=False)}, temperature)
    structures = Structure(("wave",)), Structure()
    return [model.fit(s, model.at({}, ()), noise, EXACT) for s in structures]


def log_density(x, y, blocks):
    """Log-density of each block given all others, summed: the conditional normal of dense covariances."""
    covariance, total = PRIOR_SD**2 * x @ x.T + np.eye(y.size), 0.0
    for block in blocks:
        rest = np.setdiff1d(np.arange(y.size), block)
        gain = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[np.ix_(rest, block)])
        spread = covariance[np.ix_(block, block)] - covariance[np.ix_(block, rest)] @ gain
        total += multivariate_normal(np.zeros(len(block)), spread).logpdf(y[block] - gain.T @ y[rest])
    return total


def fitted(x, y):
    """Readings as a fit to all of them has them."""
    return x @ np.linalg.solve(x.T @ x + np.eye(x.shape[1]) / PRIOR_SD**2, x.T @ y)


def gain_and_error(x, y, blocks, term):
    fewer = np.delete(x, term, axis=1)
    gain = log_density(x, y, blocks) - log_density(fewer, y, blocks)
    return gain, np.linalg.norm(fitted(x, y) - fitted(fewer, y))


@pytest.mark.parametrize("size", [0.0, 0.05, 1.0])
def test_blocks_of_time_are_foretold_as_by_refits_without_them(size):
    rng = np.random.default_rng(3)
    x = rows(TIME)
    y = x @ [1.0, 2.0, size] + 0.1 * rng.normal(size=TIME.size)
    model, rival = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)
    found = held_out_gain(model, rival)
    gain, error = gain_and_error(x / 0.1, y / 0.1, blocks_of(model)[0], 2)
    assert found.by == "blocks"
    assert found.blocks == BLOCK_COUNT
    assert found.gain == pytest.approx(gain, rel=1e-6, abs=1e-6)
    assert found.standard_error == pytest.approx(error, rel=1e-6)
    assert found.in_errors == pytest.approx(gain / error, rel=1e-6, abs=1e-6)


def test_gain_and_error_are_those_of_effective_samples():
    """At a temperature the log-density counts for less, and so does its variance; the prior stays as it is."""
    y = rows(TIME) @ [1.0, 2.0, 0.3] + 0.1 * np.random.default_rng(6).normal(size=TIME.size)
    cold, warm = (
        held_out_gain(*study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2, temperature))
        for temperature in (1.0, 9.0)
    )
    assert warm.gain == pytest.approx(cold.gain / 9.0, abs=1.5)
    assert warm.standard_error == pytest.approx(cold.standard_error / 3.0)


def test_a_block_is_left_out_of_all_outputs_at_once():
    rng = np.random.default_rng(4)
    x = np.concatenate([rows(TIME) / 0.1, -2.0 * rows(TIME)[:, ::-1] / 0.4])
    noisy = x @ [1.0, 2.0, 0.1] + rng.normal(size=2 * TIME.size)
    y = np.stack([noisy[: TIME.size] * 0.1, noisy[TIME.size :] * 0.4], axis=-1)
    model, rival = study(
        [TIME], [y], lambda t, k: -2.0 * rows(t)[:, ::-1] if k else rows(t), [free(n) for n in "abc"], 2
    )
    blocks = blocks_of(model)[0]
    assert sorted(np.concatenate(blocks).tolist()) == list(range(2 * TIME.size))
    found, (gain, error) = held_out_gain(model, rival), gain_and_error(x, noisy, blocks, 2)
    assert found.gain == pytest.approx(gain, rel=1e-6)
    assert found.standard_error == pytest.approx(error, rel=1e-6)


def test_of_several_recordings_one_at_a_time_is_left_out_and_its_own_parameters_follow_it():
    """Each recording has an offset of its own, which readings of the others do not tell."""
    rng = np.random.default_rng(5)
    times = [TIME + 100.0 * k for k in range(3)]

    def design(time, k):
        return np.concatenate([rows(time), np.stack([(time // 100.0) == e for e in range(3)], axis=-1)], axis=-1)

    whole = np.concatenate(times)
    x = design(whole, 0)
    y = x @ [1.0, 2.0, 0.3, -1.0, 0.5, 2.0] + 0.1 * rng.normal(size=whole.size)
    parameters = [*(free(n) for n in "abc"), *(free(f"o{e}", e) for e in range(3))]
    model, rival = study(times, [part[:, None] for part in np.split(y, 3)], design, parameters, 2)
    found, blocks, x, y = held_out_gain(model, rival), np.split(np.arange(whole.size), 3), x / 0.1, y / 0.1
    densities, seen = [], []
    for columns in ([0, 1, 2], [0, 1]):
        every = x[:, [*columns, 3, 4, 5]]
        offsets = x[:, 3:] @ np.linalg.solve(every.T @ every + np.eye(every.shape[1]) / PRIOR_SD**2, every.T @ y)[-3:]
        densities.append(log_density(x[:, columns], y - offsets, blocks))
        seen.append(fitted(every, y))
    gain, error = densities[0] - densities[1], np.linalg.norm(seen[0] - seen[1])
    assert found.by == "recordings"
    assert found.blocks == 3
    assert found.gain == pytest.approx(gain, rel=1e-5)
    assert found.standard_error == pytest.approx(error, rel=1e-5)


def test_a_term_that_is_not_there_gains_nothing_on_what_was_left_out():
    """Hardly one data set passes two standard errors by chance; with a wave as large as the noise nearly all do."""
    named = {0.0: 0, 0.1: 0}
    for seed in range(20):
        noise = 0.1 * np.random.default_rng(50 + seed).normal(size=TIME.size)
        for size in named:
            y = rows(TIME) @ [1.0, 2.0, size] + noise
            model, rival = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)
            named[size] += held_out_gain(model, rival).in_errors > 2.0
    assert named[0.0] <= 2
    assert named[0.1] >= 18
