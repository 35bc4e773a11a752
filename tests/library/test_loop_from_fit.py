"""A loop that begins at a fit takes over how it was fitted, and what is free in it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from aero_bayes import LoopSettings
from aero_bayes.loop.loop import settings_of


@pytest.mark.parametrize("cost", ["posterior", "weighted", "eq6"])
def test_structures_are_compared_by_the_posterior_whatever_cost_the_fit_minimised(cart, cost):
    settings = settings_of(replace(cart.fit, settings=replace(cart.fit.settings, cost=cost)), LoopSettings())
    assert settings.fitting.cost == "posterior"
    assert settings.parameters.names == ("k", "d")
    assert settings.fit.noise == cart.fit.settings.noise


def test_what_the_settings_do_not_name_stays_at_its_fitted_value(cart):
    settings = settings_of(cart.fit, LoopSettings(parameters=["k"]))
    assert settings.parameters.names == ("k",)
    assert settings.fit.fixed["d"] == pytest.approx(cart.fit["d"].value)
