"""The page of a fleet: every rig with its value and a link, what is no HTML is shown as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.commands.fleet_summary import summarise_fleet
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.report.schema_run import FleetJson


def made_up(path: Path, count: int) -> tuple[Path, FleetJson]:
    """A page of rigs that nobody fitted: one far from the others in R, one that failed, a third with an effect."""
    rng = np.random.default_rng(1)
    rows = []
    for k in range(count):
        centre = 0.05 * rng.normal() + (1.0 if k == 7 else 0.0)
        one = {"value": float(np.exp(centre)), "unit": "ohm", "log": True, "centre": centre, "width": 0.002}
        effects = [{"id": "friction@v", "summary": "friction", "alike": []}] if k % 3 == 0 else []
        row = {
            "key": f"rig-{k:05}", "simulated": False, "parameters": {"R_a": one},
            "over_floor": float(np.exp(0.05 * rng.normal())), "effects": effects,
            "outcome": "extended" if effects else "adequate", "seconds": 2.0 + k % 7,
        }  # fmt: skip
        rows.append(row if k != 5 else {"key": "rig-00005", "error": "<b>no file</b>"})
    result, rows = summarise_fleet(rows, work="loop", seed=1, versions={})
    return write_fleet_page(path, result, rows), result


@pytest.mark.parametrize("count", [30, pytest.param(2_000, marks=pytest.mark.long)])
def test_the_page_holds_every_rig(tmp_path: Path, count: int) -> None:
    page, result = made_up(tmp_path, count)
    text = page.read_text("utf-8")
    assert page.stat().st_size < 60_000 + 500 * count
    for k in range(count):
        assert (f'href="rigs/rig-{k:05}/report.html"' in text) == (k != 5)
    assert "&lt;b&gt;no file" in text
    assert [entry.rig for entry in result.stand_out] == ["rig-00007"]
    share = result.effects[0].share
    assert share.q05 is not None
    assert share.q95 is not None
    assert share.q05 < 1 / 3 < share.q95
    spread = result.parameters["R_a"].spread
    assert spread.q05 is not None
    if count > 1000:  # of many rigs one outlier does not widen the fleet's spread much
        assert spread.q95 is not None
        assert spread.q05 * 0.9 < 0.055 < spread.q95 * 1.1
