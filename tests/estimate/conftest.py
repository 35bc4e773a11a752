"""Small models from Modelica written in the tests, exported once a session."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model


@pytest.fixture(scope="session")
def modelica(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Model]:
    """``modelica(source)`` loads the model that a Modelica text defines."""
    folder, built = tmp_path_factory.mktemp("modelica"), {}

    def load(source: str) -> Model:
        if source not in built:
            name = source.split()[1]
            path = folder / f"{name}.mo"
            path.write_text(source)
            built[source] = Model.load(export_fmu(name, folder / f"{name}.fmu", sources=[path]))
        return built[source]

    return load
