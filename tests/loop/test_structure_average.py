"""Intervals over several structures, against the distribution function of the mixture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from aero_bayes.estimate import Normal
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.loop.found_effect import NewParameter
from aero_bayes.loop.structure_average import NORMAL_POINTS, StructureAverage
from aero_bayes.simulation import ParameterTarget

WINS = (0.6, 0.3, 0.1)
MEANS, SDS = np.array([1.0, 1.8, -0.5]), np.array([0.2, 0.1, 0.4])


def average(scale: str = "linear", lower: float = -50.0, upper: float = 50.0) -> StructureAverage:
    item = Parameter("a", "m", 1.0, lower, upper, Normal(0.0, 9.0), scale, "", ParameterTarget("a"))
    unit = 1.0 if scale == "log" else upper - lower
    return StructureAverage(
        structures=(("one",), ("two",), ("three",)),
        wins=WINS,
        parameters=ParameterSet((item,)),
        draws={"a": (MEANS[0] + SDS[0] * NORMAL_POINTS) / unit},
        mean={"a": MEANS[0] / unit},
        shift={"a": (MEANS - MEANS[0]) / unit},
        scale={"a": SDS / SDS[0]},
    )


def quantile(level: float) -> float:
    """Of the mixture of normals, by its distribution function."""
    return brentq(lambda x: float(np.dot(WINS, norm.cdf(x, MEANS, SDS))) - level, -9.0, 9.0)


def test_quantiles_and_deviation_are_those_of_the_mixture() -> None:
    found = average().mixture("a")
    assert [found.q05, found.q50, found.q95] == pytest.approx([quantile(q) for q in (0.05, 0.5, 0.95)], abs=2e-3)
    mean = np.dot(WINS, MEANS)
    assert found.sd == pytest.approx(np.sqrt(np.dot(WINS, SDS**2 + (MEANS - mean) ** 2)), rel=1e-3)
    alone = average().chosen("a")
    assert [alone.q05, alone.q50, alone.q95] == pytest.approx(norm.ppf([0.05, 0.5, 0.95], 1.0, 0.2), abs=1e-3)
    assert alone.sd == pytest.approx(0.2, rel=1e-3)


def test_a_logarithmic_parameter_is_mixed_on_its_own_axis() -> None:
    found = average("log", 1e-9, 1e9).mixture("a")
    expected = np.exp([quantile(q) for q in (0.05, 0.5, 0.95)])
    assert [found.q05, found.q50, found.q95] == pytest.approx(expected, rel=2e-3)


def test_no_quantile_lies_beyond_the_bounds_of_the_search() -> None:
    found = average(lower=0.0, upper=1.85).mixture("a")
    assert (found.q05, found.q95) == (0.0, 1.85)


def test_draws_of_a_sampler_take_the_place_of_the_chosen_structures_normal() -> None:
    draws = np.random.default_rng(1).normal(1.0, 0.2, 200_000)
    found, exact = average().with_draws({"a": draws}).mixture("a"), average().mixture("a")
    assert [found.q05, found.q50, found.q95] == pytest.approx([exact.q05, exact.q50, exact.q95], abs=0.01)


def test_parameters_keep_their_value_and_get_the_mixture_interval() -> None:
    fitted = {
        "a": NewParameter("a", 1.0, 0.2, 0.67, 1.33, "m", ""),
        "new": NewParameter("new", 3.0, 0.1, 2.8, 3.2, "N", ""),
    }
    found = average().averaged(fitted)
    mixture = average().mixture("a")
    assert found["new"] == fitted["new"]
    assert found["a"] == replace(fitted["a"], sd=mixture.sd, q05=mixture.q05, q50=mixture.q50, q95=mixture.q95)
    assert found["a"].to_dict()["q50"] == mixture.q50
