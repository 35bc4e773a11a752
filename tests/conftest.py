"""The laws and their flat models, read once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from aero_bayes.laws import Law, LawModels, law_models, shipped_laws

#: Folders of tests that close loops, sample posteriors, run commands or build many FMUs.
SLOW = {
    "benchmarks", "design", "docs", "estimate", "export", "fleet", "judge", "known_answers", "library", "loop",
    "report", "sample", "search", "studies", "workflow",
}  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if SLOW & set(item.path.parent.parts):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def laws() -> tuple[Law, ...]:
    return shipped_laws()


@pytest.fixture(scope="session")
def models(laws: tuple[Law, ...]) -> LawModels:
    return law_models(laws)


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(20)
