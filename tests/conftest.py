"""The laws and their flat models, read once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from aero_bayes.laws import Law, LawModels, law_models, shipped_laws

#: Folders of tests that close loops, sample posteriors, run commands or build many FMUs.
SLOW_FOLDERS = {
    "benchmarks", "design", "docs", "estimate", "export", "fleets", "known_answers", "laws", "library", "loop", "ports",
    "report", "sampling", "studies", "workflow",
}  # fmt: skip
#: Tests of studies and benchmarks, which are not part of the package.
STUDY_FOLDERS = {"bench", "benchmarks", "studies"}
#: Files in these folders that make test-fast runs, so that it reaches every room; their slow tests have the mark.
FAST_FILES = {
    "test_ablation", "test_bad_input", "test_build", "test_diagnostics", "test_diagram", "test_expression",
    "test_extension_points", "test_fit_closed_form", "test_fmi3_export", "test_forecast", "test_init_command",
    "test_laws", "test_library_view", "test_loop_figures", "test_next_experiment", "test_nist_strd",
    "test_objective", "test_one_port_per_place", "test_openmodelica", "test_plausible_data", "test_plots",
    "test_ports", "test_predictive", "test_prevalence", "test_priors_parameters", "test_report_parts",
    "test_resumed_fit", "test_rig_trial", "test_rigs_laws", "test_schema", "test_search",
    "test_units_of_parameters",
}  # fmt: skip
#: Files elsewhere that take longer.
SLOW_FILES = {
    "test_bench_equations", "test_cosimulation", "test_default_recordings", "test_engine_isolation",
    "test_initial_level", "test_read_matlab", "test_repeatable", "test_time_ordered_comparison",
}  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        in_slow_folder = bool(SLOW_FOLDERS & set(item.path.parent.parts))
        if STUDY_FOLDERS & set(item.path.parent.parts):
            item.add_marker(pytest.mark.long)
        if item.path.stem in SLOW_FILES or (in_slow_folder and item.path.stem not in FAST_FILES):
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
