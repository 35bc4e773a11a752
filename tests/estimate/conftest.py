"""Small models from Modelica written in the tests, exported once a session."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from aero_bayes.simulation.model import Model


@pytest.fixture(scope="session")
def modelica(exported: Callable[[str], Model]) -> Callable[[str], Model]:
    """``modelica(source)`` loads the model that a Modelica text defines."""
    return exported
