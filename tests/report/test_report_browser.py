"""The page in a real browser: silent, asking for nothing, explored by mouse and keys, still readable without scripts."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from headless_chromium import Browser

from aero_bayes.report import write_comparison

FIGURES = "[...document.querySelectorAll('figure[data-link]')]"
STACK = "document.querySelector('#fit figure[data-link=\"train\"]')"


@pytest.fixture(scope="module", params=["loop", "posterior", "compare"])
def page(request: pytest.FixtureRequest, runs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param == "compare":
        return write_comparison([runs / "loop", runs / "posterior"], tmp_path_factory.mktemp("page") / "compare.html")
    return runs / request.param / "report.html"


@pytest.fixture
def loop(browser: Browser, runs: Path) -> Iterator[Browser]:
    browser.open(runs / "loop" / "report.html")
    yield browser
    assert browser.complaints() == []


def until(browser: Browser, expression: str) -> None:
    """Wait until an expression holds."""
    for _ in range(200):
        if browser.evaluate(f"!!({expression})"):
            return
        time.sleep(0.05)
    raise AssertionError(f"never true: {expression}")


def show(browser: Browser, figure: str) -> Callable[[float, float], tuple[float, float]]:
    """Scroll to a figure; where a share of its drawing's width and height is on the screen."""
    browser.evaluate(f"{figure}.scrollIntoView({{behavior: 'instant'}})")
    place = f"(() => {{ const r = [...{figure}.querySelectorAll('svg.plot')].find(s => s.getBoundingClientRect().width > 0).getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; }})()"
    left, top, width, height = browser.evaluate(place)
    return lambda across, down: (left + across * width, top + down * height)


def mouse(browser: Browser, kind: str, at: tuple[float, float], **more: object) -> None:
    browser.tab("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], button="left", **more)


def drag(browser: Browser, start: tuple[float, float], stop: tuple[float, float], **more: object) -> None:
    mouse(browser, "mousePressed", start, buttons=1, clickCount=1, **more)
    for share in (0.3, 0.7, 1.0):
        at = start[0] + share * (stop[0] - start[0]), start[1] + share * (stop[1] - start[1])
        mouse(browser, "mouseMoved", at, buttons=1, **more)
    mouse(browser, "mouseReleased", stop, clickCount=1, **more)


def press(browser: Browser, figure: str, key: str, *, shift: bool = False) -> None:
    event = f"new KeyboardEvent('keydown', {{key: '{key}', shiftKey: {str(shift).lower()}, bubbles: true}})"
    browser.evaluate(f"{figure}.focus(); {figure}.dispatchEvent({event})")


def ticks(figure: str) -> str:
    """The time axis' ticks of a figure, as an expression."""
    return (
        f"[...{figure}.querySelector('.x.axis').querySelectorAll('.tick')].map(t => +t.textContent.replace('−', '-'))"
    )


def test_the_watch_hears_complaints_and_sees_requests(browser: Browser, tmp_path: Path) -> None:
    bad = tmp_path / "bad.html"
    bad.write_text('<script>console.error("heard")</script><img src="http://127.0.0.1:9/seen.png">', "utf-8")
    browser.open(bad)
    assert any("heard" in said for said in browser.complaints())
    assert "http://127.0.0.1:9/seen.png" in browser.requests()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 820, 390])
def test_page_is_silent_and_asks_for_nothing(browser: Browser, page: Path, width: int, dark: bool) -> None:
    browser.open(page, width=width, dark=dark)
    assert browser.complaints() == []
    outside = [url for url in browser.requests() if not url.startswith("data:")]
    assert outside == [page.resolve().as_uri()]
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    ground = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    brightness = sum(int(part) for part in ground.removeprefix("rgb(").removesuffix(")").split(",")) / 3
    assert (brightness < 128) == dark


@pytest.mark.parametrize("scripts", [True, False], ids=["with scripts", "without"])
def test_every_figure_is_visible_in_one_form(browser: Browser, page: Path, scripts: bool) -> None:
    hidden = """[...document.querySelectorAll('figure')].filter(figure => !figure.closest('details')).filter(figure =>
                [...figure.querySelectorAll('svg.plot')].filter(svg => svg.getBoundingClientRect().height > 20).length !== 1
             ).length"""
    browser.tab("Emulation.setScriptExecutionDisabled", value=not scripts)
    try:
        for width in (1280, 390):
            browser.open(page, width=width)
            assert browser.evaluate("document.querySelectorAll('figure').length") > 1
            assert browser.evaluate(hidden) == 0
            assert (browser.evaluate("document.querySelectorAll('.tools').length") > 0) == scripts
            assert browser.complaints() == []
    finally:
        browser.tab("Emulation.setScriptExecutionDisabled", value=False)


def test_text_in_figures_stays_readable_on_a_phone(browser: Browser, page: Path) -> None:
    smallest = """Math.min(...[...document.querySelectorAll('figure .plot')].filter(svg =>
                  svg.getBoundingClientRect().width > 0).map(svg =>
                  11.5 * svg.getBoundingClientRect().width / svg.viewBox.baseVal.width))"""
    browser.open(page, width=390)
    assert browser.evaluate(smallest) > 8.5


def test_dragging_zooms_every_panel_of_a_recording_and_reset_brings_the_still_back(loop: Browser) -> None:
    at = show(loop, STACK)
    still = loop.evaluate(f"{STACK}.querySelector('.y.axis').innerHTML")
    drag(loop, at(0.3, 0.3), at(0.4, 0.3))
    until(loop, f"({ticks(STACK)}).length > 1 && Math.max(...{ticks(STACK)}) < 10")
    first, last = loop.evaluate(f"(() => {{ const t = {ticks(STACK)}; return [t[0], t.at(-1)]; }})()")
    assert 3 < first < last < 8.5
    painted = f"(() => {{ const c = {STACK}.querySelector('canvas'); const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; }})()"
    assert loop.evaluate(painted) > 1000
    assert loop.evaluate(
        f"[...{STACK}.querySelectorAll('.wide path[data-spec]')].every(p => p.style.display === 'none')"
    )
    press(loop, STACK, "0")
    until(loop, f"{STACK}.querySelector('canvas').style.display === 'none'")
    assert loop.evaluate(f"[...{STACK}.querySelectorAll('.wide path[data-spec]')].every(p => p.style.display === '')")
    assert loop.evaluate(f"{STACK}.querySelectorAll('.y.axis')[0].querySelectorAll('text').length") == still.count(
        "<text"
    )


def test_figures_of_one_recording_zoom_together(loop: Browser) -> None:
    one, other = (f"{FIGURES}.filter(f => f.dataset.link === 'unseen')[{k}]" for k in (0, 1))
    show(loop, one)
    for _ in range(4):
        press(loop, one, "+")
    show(loop, other)
    until(loop, f"({ticks(one)}).join() !== '' && ({ticks(one)}).join() === ({ticks(other)}).join()")
    assert loop.evaluate(
        f"{FIGURES}.filter(f => f.dataset.link === 'train').every(f => !f.querySelector('canvas') || f.querySelector('canvas').style.display === 'none')"
    )


def test_values_under_the_cursor_are_those_of_the_series(loop: Browser, runs: Path) -> None:
    at = show(loop, STACK)
    mouse(loop, "mouseMoved", at(0.5, 0.5), buttons=0)
    until(loop, f"{STACK}.querySelector('.readout .time')")
    texts = loop.evaluate(
        f"[...{STACK}.querySelectorAll('.wide .readout')].map(r => [...r.children].map(t => t.textContent))"
    )
    moment = float(texts[0][0].removeprefix("t = ").removesuffix(" s"))
    with np.load(runs / "loop" / "series.npz") as series:
        near = int(np.argmin(np.abs(series["time/train"] - moment)))
        measured, after = (float(series[f"{group}/train/omega_m"][near]) for group in ("measured", "fitted"))
    panel = next(
        text
        for text in texts
        if any("before" in t for t in text) and abs(_value(text, "measured") - measured) < 0.02 * abs(measured) + 1e-9
    )
    assert _value(panel, "after") == pytest.approx(after, rel=1e-3)
    press(loop, STACK, "ArrowRight", shift=True)
    until(loop, f"{STACK}.querySelector('.spoken[aria-live]').textContent.includes('measured')")


def _value(texts: list[str], name: str) -> float:
    return next(
        (float(t.removeprefix(f"{name} ").replace("−", "-")) for t in texts if t.startswith(f"{name} ")), np.nan
    )


def test_full_resolution_is_reached_by_zooming(loop: Browser, runs: Path) -> None:
    """Zoomed to a second, every sample of the current is a dot where its value is."""
    show(loop, STACK)
    for _ in range(7):
        press(loop, STACK, "+")
    until(loop, f"{STACK}.querySelector('canvas')?.style.display === ''")
    spec = loop.evaluate(f"(() => {{ const t = {ticks(STACK)}; return [t[0], t.at(-1)]; }})()")
    assert 0 < spec[1] - spec[0] < 1.5


def test_draws_marked_in_one_cell_are_marked_in_all(browser: Browser, runs: Path) -> None:
    browser.open(runs / "posterior" / "report.html")
    pairs = "document.querySelector('figure.pairs')"
    until(browser, f"{pairs}.querySelector('.draws')?.getAttribute('d') !== null && {pairs}.querySelector('.cover')")
    show(browser, pairs)
    box = f"(() => {{ const r = [...{pairs}.querySelectorAll('.cover')].find(c => !c.hasAttribute('tabindex')).getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; }})()"
    left, top, width, height = browser.evaluate(box)
    drag(browser, (left + 1, top + 1), (left + 0.5 * width, top + height - 1))
    count = f"[...{pairs}.querySelectorAll('.picked')].map(p => p.getAttribute('d').split('M').length - 1)"
    until(browser, f"Math.min(...{count}) > 0")
    marked = int(browser.evaluate(f"{pairs}.querySelector('.brushed').textContent").split()[0])
    assert all(0.9 * marked <= shown <= marked for shown in browser.evaluate(count))
    slider = f"{pairs}.querySelector('[role=slider]')"
    browser.evaluate(f"{slider}.focus(); {slider}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Escape'}}))")
    assert browser.evaluate(f"Math.max(...{count})") == 0
    assert browser.complaints() == []


def test_everything_that_can_be_used_has_a_name(browser: Browser, page: Path) -> None:
    """What a screen reader needs: names, a language, tables with captions, no id twice, no positive tabindex."""
    browser.open(page)
    nameless = """[...document.querySelectorAll('button, a, summary, [tabindex], [role]')].filter(e =>
                  !(e.getAttribute('aria-label') || e.textContent).trim()).map(e => e.outerHTML.slice(0, 80))"""
    assert browser.evaluate(nameless) == []
    assert browser.evaluate("document.documentElement.lang") == "en"
    assert browser.evaluate("[...document.querySelectorAll('[tabindex]')].every(e => e.tabIndex <= 0)")
    assert browser.evaluate("[...document.querySelectorAll('svg')].every(s => s.getAttribute('role') === 'img')")


def test_print_shows_the_still_picture_and_no_tools(browser: Browser, runs: Path, tmp_path: Path) -> None:
    shutil.copy(runs / "loop" / "report.html", tmp_path / "page.html")
    browser.open(tmp_path / "page.html")
    browser.tab("Emulation.setEmulatedMedia", media="print")
    try:
        assert browser.evaluate(
            "[...document.querySelectorAll('.tools, .numbers')].every(t => getComputedStyle(t).display === 'none')"
        )
        assert browser.evaluate(
            "[...document.querySelectorAll('.wide')].every(t => getComputedStyle(t).display === 'block')"
        )
    finally:
        browser.tab("Emulation.setEmulatedMedia", media="")
