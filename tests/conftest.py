"""The laws and their flat models, read once; the time that each room's tests took."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import heated_room
import numpy as np
import pytest
from numpy.random import Generator

from aero_bayes.laws.attach import LawBlocks
from aero_bayes.laws.law import Law, shipped_laws
from aero_bayes.laws.law_models import LawModels, law_models
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.model import Model


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print how long the tests of each room took."""
    seconds: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                seconds[Path(report.nodeid.partition("::")[0]).parent.name] += report.duration
    rooms = ", ".join(f"{room} {spent:.0f} s" for room, spent in seconds.most_common() if spent >= 1.0)
    if rooms:
        terminalreporter.write_line(f"time by room: {rooms}")


@pytest.fixture(scope="session")
def laws() -> tuple[Law, ...]:
    return shipped_laws()


@pytest.fixture(scope="session")
def models(laws: tuple[Law, ...]) -> LawModels:
    return law_models(laws)


@pytest.fixture(scope="session")
def blocks(models: LawModels, tmp_path_factory: pytest.TempPathFactory) -> LawBlocks:
    """The FMUs of laws, each built once."""
    return LawBlocks(models, tmp_path_factory.mktemp("laws"))


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """The model of the heated room, built once."""
    return heated_room.model(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="session")
def one_dof(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """The AERO that pitches only, built once."""
    return Model.load(export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("aero") / "OneDof.fmu"))


@pytest.fixture
def trust(record_property: Callable[[str, object], None]) -> Callable[[str, float], None]:
    """Notes how far a result is from what it is compared with, in a row of ``docs/trust.md``."""
    return lambda row, value: record_property(f"trust:{row}", float(value))


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(20)


@pytest.fixture
def modelica(tmp_path: Path) -> Callable[..., Path]:
    """Writes a Modelica file, named after its first class or as told, and returns its path."""

    def write(text: str, name: str = "") -> Path:
        found = re.search(r"^[\s\ufeff]*(?:model|package|block|partial model) (\w+)", text, re.MULTILINE)
        path = tmp_path / f"{name or (found[1] if found else 'Model')}.mo"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Model]:
    """``exported(source)`` loads the model that a Modelica text defines, built once."""
    built: dict[str, Model] = {}

    def load(source: str) -> Model:
        if source not in built:
            name = source.split()[1]
            path = tmp_path_factory.mktemp(name) / f"{name}.mo"
            path.write_text(source)
            built[source] = Model.load(export_fmu(name, path.with_suffix(".fmu"), sources=[path]))
        return built[source]

    return load
