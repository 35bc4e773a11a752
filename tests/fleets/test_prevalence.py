"""How common an effect is: the binomial answer where every effect is noticed, coverage where some are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta

from aero_bayes.fleets.prevalence import NamedEffect, estimate_prevalence, shared_out

pytestmark = pytest.mark.fast

LEVELS = np.array([0.05, 0.5, 0.95])


def test_an_effect_that_cannot_be_missed_is_only_counted() -> None:
    strengths = np.full(30, 9.0) + np.linspace(-0.2, 0.2, 30)
    found = estimate_prevalence(strengths, np.ones(30), 100)
    assert found.noticed > 0.999
    np.testing.assert_allclose(found.quantiles(LEVELS), beta.ppf(LEVELS, 30.5, 70.5), atol=3e-3)


def test_an_effect_at_the_edge_of_what_is_noticed_may_be_anywhere() -> None:
    weak = estimate_prevalence(np.abs(np.random.default_rng(1).normal(0.0, 0.4, 6)), np.ones(6), 20)
    assert weak.noticed < 0.8
    low, _, high = weak.quantiles(LEVELS)
    assert high - low > 0.4


@pytest.mark.parametrize(("distance", "differs"), [(40.0, 0.5), (8.0, 0.5), (4.0, 0.7)])
def test_intervals_hold_the_share_as_often_as_they_say(distance: float, differs: float) -> None:
    # Distances are log-normal, the log-evidence half their square less the price of a parameter: not quite the model
    # that is inferred. 100 fleets: the standard error of the share held is 3 %.
    rng = np.random.default_rng([2, int(distance)])
    held = 0
    for _ in range(100):
        has = rng.random(20) < 0.3
        z = distance * np.exp(differs * rng.normal(size=20)) + rng.normal(size=20)
        gain = 0.5 * z**2 - 3.0
        named = has & (gain > 7.0)
        strengths = np.log((gain[named] + 4.0) / 11.0)
        low, high = estimate_prevalence(strengths, np.ones(len(strengths)), 20).quantiles(LEVELS[::2])
        held += low <= 0.3 <= high
    assert held / 100 > 0.78


def test_a_rig_that_cannot_tell_learns_from_those_that_can() -> None:
    sure = [[NamedEffect("stiction@v", (), 3.0)]] * 6
    unsure = [NamedEffect("lag@u", ("stiction@v",), 1.0)]
    *_, (share,) = shared_out([*sure, unsure])
    assert share["stiction@v"] > 0.9
    assert sum(share.values()) == pytest.approx(1.0)
    ((alone,),) = shared_out([unsure])
    assert alone["lag@u"] == pytest.approx(0.5)
