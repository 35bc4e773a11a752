"""The page of a fleet of ten thousand rigs: small, no long table, and every rig is found by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from report.headless_chromium import Browser, find_chromium

from aero_bayes.fleets import Table
from aero_bayes.fleets.summary import summarise_fleet
from aero_bayes.report import write_fleet_page
from aero_bayes.schema import FleetJson


def made_up(path: Path, count: int) -> tuple[Path, FleetJson]:
    """A page of rigs that nobody fitted: one far from the others in R, one that failed, a third with an effect."""
    rng = np.random.default_rng(1)
    with Table(path / "rigs.sqlite") as table:
        for k in range(count):
            centre = 0.05 * rng.normal() + (1.0 if k == 7 else 0.0)
            one = {"value": float(np.exp(centre)), "sd": 0.002, "unit": "ohm", "status": "identified", "log": True}
            effects = [{"id": "friction@v", "alike": []}] if k % 3 == 0 else []
            row = {
                "key": f"rig-{k:05}", "simulated": False,
                "parameters": {"R_a": one | {"centre": centre, "width": 0.002}},
                "outputs": {}, "over_floor": float(np.exp(0.05 * rng.normal())), "effects": effects, "level": "good",
                "outcome": "extended" if effects else "adequate", "text": "", "words": {},
            }  # fmt: skip
            table.put(row if k != 5 else {"key": "rig-00005", "error": "<b>no file</b>"}, {"seconds": 2.0 + k % 7})
        result, columns = summarise_fleet(table, work="loop", seed=1, versions={})
    return write_fleet_page(path, result, columns), result


@pytest.mark.long
def test_ten_thousand_rigs_fit_on_a_page(tmp_path: Path) -> None:
    page, result = made_up(tmp_path, 10_000)
    text = page.read_text("utf-8")
    assert page.stat().st_size < 5e6
    assert text.count("<tr") < 120
    assert "&lt;b&gt;no file" in text
    assert [entry.rig for entry in result.stand_out] == ["rig-00007"]
    share = result.effects[0].share
    assert share.q05 is not None
    assert share.q95 is not None
    assert share.q05 < 1 / 3 < share.q95
    spread = result.parameters["R_a"].spread
    assert spread.q05 is not None
    assert spread.q95 is not None
    assert spread.q05 * 0.97 < 0.05 < spread.q95
    _finds_rigs(page, tmp_path)


def _finds_rigs(page: Path, folder: Path) -> None:
    chromium = find_chromium()
    if chromium is None:
        pytest.skip("no chromium")
    with Browser(chromium, folder / "profile") as browser:
        browser.open(page)
        assert browser.complaints() == []
        assert browser.requests() == [page.resolve().as_uri()]
        browser.evaluate(
            "const f = document.querySelector('.finder input'); f.value = 'rig-00007';"
            "f.dispatchEvent(new Event('input', {bubbles: true}))"
        )
        address = browser.evaluate("document.querySelector('.finder a').getAttribute('href')")
        assert address == "rigs/rig-00007/report.html"
    assert browser.complaints() == []
