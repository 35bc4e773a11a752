"""The study of wrong models: its rigs repeat an experiment, and its figures are those of known distributions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aero_bayes import load_model
from coverage_wrong import DEVELOPMENT, REPORT, STATES, Best, best_values, of_rig, summarise
from coverage_wrong_page import misses, parts
from wrong_rigs import rigs

pytestmark = pytest.mark.long

RIGS = rigs()


@pytest.mark.parametrize("name", sorted(RIGS))
def test_a_repetition_has_new_levels_and_the_noise_that_was_asked_for(name: str):
    """Over 1,334 readings a standard deviation is uncertain by 2 %; the motor's noise has a memory of 3 readings."""
    rig = RIGS[name]
    first, silent = rig.record("right", 1.0, np.random.default_rng(1))
    again, _ = rig.record("right", 1.0, np.random.default_rng(1))
    other, _ = rig.record("right", 1.0, np.random.default_rng(2))
    column = next(iter(first.inputs))
    assert np.array_equal(first.inputs[column], again.inputs[column])
    assert not np.array_equal(first.inputs[column], other.inputs[column])
    expected = {"aero": 2e-3, "pendulum": 2e-3, "motor": np.hypot(0.5, 0.3), "reservoirs": 2e-3}[name]
    output = list(first.outputs)[-1]
    noise = first.outputs[output] - silent.outputs[output]
    assert np.std(noise) == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("name", sorted(RIGS))
@pytest.mark.parametrize("state", ["missing", "unlisted", "process_noise"])
def test_what_is_missing_is_three_times_as_large_at_the_larger_size(name: str, state: str):
    """The same levels are driven; without reading noise the outputs differ by what is missing alone."""
    silent = [RIGS[name].record(state, size, np.random.default_rng(3))[1] for size in (0.0, 1.0, 3.0)]
    for output, plain in silent[0].outputs.items():
        small, large = (float(np.std(one.outputs[output] - plain)) for one in silent[1:])
        if small > 1e-6 * np.std(plain):
            assert 1.5 * small < large < 6.0 * small


@pytest.mark.slow
def test_best_values_of_a_right_model_are_the_true_ones(tmp_path: Path):
    rig = RIGS["reservoirs"]
    load_model(rig.reference, folder=tmp_path / "built").path.replace(tmp_path / "reservoirs.fmu")
    found = best_values(Best(1, "reservoirs", "right", 1.0, tmp_path), rig)
    assert found["values"] == pytest.approx(dict(rig.truth), rel=1e-4)


def row(number: int, error: float, state: str = "missing") -> dict[str, object]:
    """A repetition whose error is given in units of a standard deviation that its intervals know."""
    values = [error, error - 0.6745, error + 0.6745, error - 1.6449, error + 1.6449]
    narrow = [error, *(error + 0.5 * (v - error) for v in values[1:])]
    return {
        "key": f"1/{state}/cart/{number}", "targets": {"k": 0.0}, "error_of_model": [], "number": number,
        "methods": {"ours": {"k": values}, "curve_fit": {"k": narrow}},
    }  # fmt: skip


def test_coverage_and_width_of_gaussian_errors():
    """4,000 errors: shares are uncertain by 0.008 and 0.005, widths by 1 %."""
    errors = np.random.default_rng(4).standard_normal(4000)
    rows = [row(k, float(error)) for k, error in enumerate(errors)]
    ours, half = (of_rig(rows, method) for method in ("ours", "curve_fit"))
    assert ours["50"] == pytest.approx(0.5, abs=0.032)
    assert ours["90"] == pytest.approx(0.9, abs=0.02)
    assert ours["width_90"] == pytest.approx(1.0, abs=0.05)
    assert half["90"] == pytest.approx(0.589, abs=0.032)  # of a Gaussian within 0.8224 standard deviations
    assert half["width_90"] == pytest.approx(0.5 * ours["width_90"])


def test_the_summary_keeps_its_contract_and_the_page_says_what_missed():
    rows = [row(k, 3.0, state) for k in range(4) for state in STATES]
    result = summarise(rows, {}, {"report": REPORT, "development": DEVELOPMENT, "used": REPORT}, 0)
    assert set(result["states"]) == {"right", "missing", "mended", "unlisted", "process_noise"}
    assert {"50", "90", "width_90"} <= set(result["states"]["right"]["ours"])
    assert {"states", "bands_90", "seeds"} <= set(result)
    assert len(misses(result)) >= len(STATES)
    assert sum(part.count("<table") for part in parts(result)) == 2


def test_seeds_of_development_and_report_differ():
    assert DEVELOPMENT != REPORT
    rig = RIGS["pendulum"]
    assert replace(rig, push=0.0) != rig
