"""The page in a real browser: no complaint in the console, no request to anywhere, no sideways scrolling on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from headless_chromium import Browser, find_chromium
from report_runs import write_run

from aero_bayes.report import write_report

EXECUTABLE = find_chromium()
pytestmark = pytest.mark.skipif(EXECUTABLE is None, reason="no Chromium or Chrome on the PATH to open the page with")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(str(EXECUTABLE), tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module", params=["posterior", "loop"])
def page(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(write_run(tmp_path_factory.mktemp(request.param), request.param, rows=1501))


def test_the_watch_hears_complaints_and_sees_requests(browser: Browser, tmp_path: Path) -> None:
    bad = tmp_path / "bad.html"
    bad.write_text('<script>console.error("heard")</script><img src="http://127.0.0.1:9/seen.png">', encoding="utf-8")
    browser.open(bad)
    assert any("heard" in said for said in browser.complaints())
    assert "http://127.0.0.1:9/seen.png" in browser.requests()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_page_is_silent_and_asks_for_nothing(browser: Browser, page: Path, width: int, dark: bool) -> None:
    browser.open(page, width=width, dark=dark)
    assert browser.complaints() == []
    outside = [url for url in browser.requests() if not url.startswith("data:")]
    assert outside == [page.resolve().as_uri()]
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    ground = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    brightness = sum(int(part) for part in ground.removeprefix("rgb(").removesuffix(")").split(",")) / 3
    assert (brightness < 128) == dark


def test_every_figure_is_visible_in_one_form(browser: Browser, page: Path) -> None:
    hidden = """[...document.querySelectorAll('figure')].filter(figure => !figure.closest('details')).filter(figure =>
                [...figure.querySelectorAll('svg')].filter(svg => svg.getBoundingClientRect().height > 20).length !== 1
             ).length"""
    for width in (1280, 390):
        browser.open(page, width=width)
        assert browser.evaluate("document.querySelectorAll('figure').length") > 10
        assert browser.evaluate(hidden) == 0


def test_text_in_figures_stays_readable_on_a_phone(browser: Browser, page: Path) -> None:
    smallest = """Math.min(...[...document.querySelectorAll('figure .plot')].filter(svg =>
                  svg.getBoundingClientRect().width > 0).map(svg =>
                  11.5 * svg.getBoundingClientRect().width / svg.viewBox.baseVal.width))"""
    browser.open(page, width=390)
    assert browser.evaluate(smallest) > 9
