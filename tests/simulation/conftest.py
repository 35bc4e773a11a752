"""Test FMUs, compiled once a session, and one pool of workers for all tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from fmu_builder import build

from aero_bayes.simulation.interface import InputSignal
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool

MakeModel = Callable[..., Model]


@pytest.fixture(params=["rare jumps", "held samples", "straight lines"])
def drive(request: pytest.FixtureRequest) -> Callable[[np.ndarray], tuple[InputSignal, ...]]:
    """``drive(time)`` is an input ``u`` that jumps once, or one that moves at each of these times."""

    def make(time: np.ndarray) -> tuple[InputSignal, ...]:
        if request.param == "rare jumps":
            return (InputSignal("u", np.array([0.0, 0.7]), np.array([1.0, 3.0])),)
        level = 2.0 + np.sin(5.0 * time) + 0.3 * np.cos(37.0 * time)
        return (InputSignal("u", time, level, "hold" if request.param == "held samples" else "linear"),)

    return make


@pytest.fixture(scope="session")
def test_fmu(tmp_path_factory: pytest.TempPathFactory) -> MakeModel:
    """``test_fmu("Dahlquist", directional=False)`` loads a test model."""
    folder = tmp_path_factory.mktemp("fmus")
    built: dict[tuple[object, ...], Model] = {}

    def make(name: str, *, directional: bool = True, defines: tuple[str, ...] = ()) -> Model:
        key = (name, directional, defines)
        if key not in built:
            built[key] = Model.load(build(folder, name, directional=directional, defines=defines))
        return built[key]

    return make


@pytest.fixture(scope="session")
def here() -> Iterator[WorkerPool]:
    """Runs in the test's own process."""
    with WorkerPool(0) as pool:
        yield pool


@pytest.fixture(scope="session")
def pool() -> Iterator[WorkerPool]:
    """One worker process."""
    with WorkerPool(1) as pool:
        yield pool


@pytest.fixture(scope="session")
def aero(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """The AERO, exported from its Modelica source."""
    export = pytest.importorskip("aero_bayes.modelica.compilers")
    pytest.importorskip("casadi")
    pytest.importorskip("rumoca")
    path: Path = tmp_path_factory.mktemp("aero") / "OneDof.fmu"
    export.export_fmu("Aero.Systems.OneDof", path)
    return Model.load(path)
