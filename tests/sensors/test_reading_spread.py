"""Noise that differs from reading to reading: the kind that was drawn is chosen, and its size is found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import t as student_t

from aero_bayes.estimate.reading_spread import SpreadModel, choose_spread, estimate_spread

pytestmark = pytest.mark.fast

N = 600
READINGS = 50.0 + 40.0 * np.sin(np.arange(N) / 30.0)
Draw = Callable[[np.random.Generator], np.ndarray]


def kinds(draw: Draw, repetitions: int) -> list[str]:
    return [choose_spread([draw(np.random.default_rng(seed))], [READINGS]).kind for seed in range(repetitions)]


def relative(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(rng.normal(size=N) * (0.1 + 0.02 * READINGS))


def outliers(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(rng.normal(size=N) + 10.0 * rng.choice([-1, 0, 1], N, p=[0.015, 0.97, 0.015]))


def test_noise_of_equal_size_is_left_as_it_is() -> None:
    # A false choice in 1,000 each: four of 40 happen less than once in 10 million times.
    assert kinds(lambda rng: rng.normal(size=N), 40).count("constant") > 36


@pytest.mark.parametrize(("draw", "kind"), [(relative, "relative"), (outliers, "student")])
def test_the_kind_that_was_drawn_is_chosen(draw: Draw, kind: str) -> None:
    assert kinds(draw, 20).count(kind) >= 18


def test_size_of_relative_noise() -> None:
    rng = np.random.default_rng(3)
    found = [estimate_spread("relative", [relative(rng)], [READINGS]) for _ in range(20)]
    per_unit = np.array([model.per_unit for model in found])
    # The grid of the ratio is 1.25 from one to the next; the mean of 20 is within four standard errors.
    assert abs(per_unit.mean() - 0.02) < 4.0 * per_unit.std() / 20**0.5 + 0.001


def test_scale_of_student_noise_against_scipy() -> None:
    residual = np.random.default_rng(4).standard_t(3.0, size=4000) * 0.2
    found = estimate_spread("student", [residual], [np.zeros(4000)])
    freedom, _, scale = student_t.fit(residual, floc=0.0)
    assert found.base == pytest.approx(scale, rel=0.03)
    assert found.freedom == pytest.approx(freedom, rel=0.25)


def test_density_of_student_noise_against_scipy() -> None:
    model = SpreadModel("student", 0.3, freedom=4.0)
    at = np.linspace(-3.0, 3.0, 13)
    assert model.log_density(at, at) == pytest.approx(student_t.logpdf(at, 4.0, scale=0.3), abs=1e-12)
