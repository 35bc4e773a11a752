"""The studies of intervals: their rigs repeat an experiment, and their figures are those of known distributions."""

from __future__ import annotations

import numpy as np
import pytest

from study import coverage
from study.coverage import held, repeated_rigs
from study.coverage_wrong import of_rigs

pytestmark = pytest.mark.long

RIGS = repeated_rigs()


@pytest.mark.parametrize("name", sorted(RIGS))
@pytest.mark.parametrize("state", ["missing", "unlisted", "process_noise"])
def test_what_is_missing_is_about_three_times_as_large_at_the_larger_size(name: str, state: str):
    """The same levels are driven and the same noise is read, but for the size of it; medians leave that noise out."""
    rig = RIGS[name]
    truth = rig.draw(np.random.default_rng(1))
    plain, small, large = (
        rig.record(truth, np.random.default_rng(3), "r", state=state, size=size).outputs for size in (0.0, 1.0, 3.0)
    )
    for output, values in plain.items():
        one, three = (float(np.std(of[output] - values)) for of in (small, large))
        if one > 1e-3 * np.std(values):
            assert 1.5 * one < three < 6.0 * one


def test_shares_of_uniform_ranks():
    """4,000 ranks: shares are uncertain by 0.008 and 0.005."""
    ranks = np.random.default_rng(7).uniform(size=4000)
    found = held(ranks.tolist())
    assert found["50"] == pytest.approx(0.5, abs=0.032)
    assert found["90"] == pytest.approx(0.9, abs=0.02)
    assert found["p"] > 1e-3
    assert held((ranks**1.2).tolist())["p"] < 1e-6


def test_the_summary_of_coverage_keeps_its_contract():
    rows = [
        {"key": f"1/pendulum/{kind}/{n}/{k}", "ranks": {"J": (k + 0.5) / 20}}
        for kind in ("white", "correlated") for n in (1, 2) for k in range(20)
    ]  # fmt: skip
    found = coverage.summary([*rows, {"key": "1/motor/white/1/0", "error": "stopped"}])
    assert (found["recordings"], found["failed"]) == (120, 1)
    assert all((of["50"], of["90"], of["count"]) == (0.5, 0.9, 40) for of in found["noises"].values())
    assert [cell[:3] for cell in found["cells"]] == [["white", "pendulum", "J"], ["correlated", "pendulum", "J"]]
    assert min(of["p"] for *_, of in found["cells"]) > 0.9
    assert coverage.table(found)[1][0][1:4] == (40, "50 %", "90 %")


def row(number: int, error: float, state: str = "missing") -> dict[str, object]:
    """A repetition whose error is given in units of a standard deviation that its intervals know."""
    values = [error, error - 0.6745, error + 0.6745, error - 1.6449, error + 1.6449]
    narrow = [error, *(error + 0.5 * (v - error) for v in values[1:])]
    return {
        "key": f"1/{state}/pendulum/{number}", "rig": "pendulum", "state": state, "targets": {"k": 0.0},
        "error_of_model": [], "number": number, "methods": {"ours": {"k": values}, "curve_fit": {"k": narrow}},
    }  # fmt: skip


def test_coverage_and_width_of_gaussian_errors():
    """4,000 errors: shares are uncertain by 0.008 and 0.005, widths by 1 %."""
    errors = np.random.default_rng(4).standard_normal(4000)
    rows = [row(k, float(error)) for k, error in enumerate(errors)]
    half, ours = of_rigs(rows).sort_values("method").to_dict("records")
    assert ours["50"] == pytest.approx(0.5, abs=0.032)
    assert ours["90"] == pytest.approx(0.9, abs=0.02)
    assert ours["width_90"] == pytest.approx(1.0, abs=0.05)
    assert half["90"] == pytest.approx(0.589, abs=0.032)  # of a Gaussian within 0.8224 standard deviations
    assert half["width_90"] == pytest.approx(0.5 * ours["width_90"])
