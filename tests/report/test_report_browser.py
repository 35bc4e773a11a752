"""The page in a real browser: silent, asking for nothing, explored by mouse and keys, readable without scripts."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from headless_chromium import Browser

#: The figure of the recording ``train``, and of ``unseen`` the opening picture and the figure below.
STACK, OPENING, BELOW = "look.of('train')[0]", "look.of('unseen')[0]", "look.of('unseen')[1]"
#: What the tests ask of a page.
LOOK = """window.look = {
    of: link => [...document.querySelectorAll('figure[data-link]')].filter(f => f.dataset.link === link),
    seen: figure => figure.querySelector('svg.plot'),
    box: element => { const r = element.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; },
    number: text => +text.replace('−', '-'),
    ticks: figure => [...look.seen(figure).querySelectorAll('.x.axis .tick')].map(t => look.number(t.textContent)),
    still: figure => look.paths(figure).every(p => !('drawn' in p.dataset)),
    paths: figure => [...look.seen(figure).querySelectorAll('path[data-spec]')],
    readouts: figure => [...look.seen(figure).querySelectorAll('.readout')].map(r =>
        [...r.children].map(t => t.textContent)),
    axis: axis => [...axis.querySelectorAll('.tick')].map(t => [10 * parseFloat(t.getAttribute('x')),
        +t.getAttribute('y'), look.number(t.textContent)]),
    inked: (figure, points) => { const ends = look.paths(figure).flatMap(p => (p.getAttribute('d').match(
            /[ML](-?[\\d.]+ -?[\\d.]+)/g) ?? []).map(end => end.slice(1).split(' ').map(Number)).map(([x, y]) =>
            [x, y + +p.parentNode.getAttribute('y')]));
        return points.map(([x, y]) => ends.some(([a, b]) => Math.abs(a - x) < 1 && Math.abs(b - y) < 1)); },
}"""


@pytest.fixture
def loop(browser: Browser, runs: Path) -> Iterator[Browser]:
    browser.open(runs / "loop" / "report.html")
    browser.evaluate(f"{LOOK}; document.querySelectorAll('details').forEach(folded => {{ folded.open = true; }})")
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
    left, top, width, height = browser.evaluate(f"look.box(look.seen({figure}))")
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


@pytest.mark.parametrize("page", ["loop", "posterior"], indirect=True)
@pytest.mark.parametrize("width", [1280, 390])
def test_every_figure_is_visible_with_scripts_and_without_and_readable_on_a_phone(
    browser: Browser, page: Path, width: int
) -> None:
    figures = """(plots => [plots.length, Math.min(...plots.map(svg => svg.getBoundingClientRect().height)),
        11.5 * Math.min(...plots.map(svg => svg.getScreenCTM().a)), document.querySelectorAll('.tools').length])(
        [...document.querySelectorAll('figure')].filter(f => !f.closest('details')).map(f =>
        f.querySelector('svg.plot')))"""
    for scripts in (True, False):
        browser.tab("Emulation.setScriptExecutionDisabled", value=not scripts)
        try:
            browser.open(page, width=width)
            count, height, text, tools = browser.evaluate(figures)
        finally:
            browser.tab("Emulation.setScriptExecutionDisabled", value=False)
        assert count > 0
        assert height > 20
        assert text > 8.5
        assert (tools > 0) == scripts
        assert browser.complaints() == []


def test_dragging_zooms_every_panel_and_reset_undoes_it(loop: Browser) -> None:
    at = show(loop, STACK)
    assert loop.evaluate(f"look.still({STACK})")
    drag(loop, at(0.3, 0.3), at(0.4, 0.3))
    until(loop, f"!look.still({STACK})")
    first, last = loop.evaluate(f"[look.ticks({STACK})[0], look.ticks({STACK}).at(-1)]")
    assert 2 < first < last < 5.5
    assert loop.evaluate(f"look.paths({STACK}).every(p => 'drawn' in p.dataset)")
    press(loop, STACK, "0")
    until(loop, f"look.still({STACK})")


def test_figures_of_one_recording_zoom_together(loop: Browser) -> None:
    show(loop, OPENING)
    for _ in range(4):
        press(loop, OPENING, "+")
    show(loop, BELOW)
    until(loop, f"!look.still({OPENING}) && !look.still({BELOW})")
    assert loop.evaluate(f"look.ticks({BELOW}).length") > 1
    assert loop.evaluate(f"look.ticks({OPENING}).join()") == loop.evaluate(f"look.ticks({BELOW}).join()")
    assert loop.evaluate(f"look.still({STACK})")


def test_values_under_the_cursor_are_those_of_the_series(loop: Browser, runs: Path) -> None:
    at = show(loop, STACK)
    mouse(loop, "mouseMoved", at(0.5, 0.5), buttons=0)
    until(loop, f"look.readouts({STACK})[0].length")
    texts = loop.evaluate(f"look.readouts({STACK})")
    moment = float(texts[0][0].removeprefix("t = ").removesuffix(" s"))
    with np.load(runs / "loop" / "series.npz") as series:
        near = int(np.argmin(np.abs(series["time/train"] - moment)))
        found = {group: float(series[f"{group}/train/omega_m"][near]) for group in ("measured", "before", "fitted")}
        names = [key.rsplit("/", 1)[1] for key in series.files if key.startswith("measured/train/")]
    panel = texts[1 + 2 * names.index("omega_m")]  # the input, then each output and what is left of it
    shown = dict(text.replace("−", "-").rsplit(" ", 1) for text in panel)
    assert float(shown["measured"]) == pytest.approx(found["measured"], rel=6e-4)
    assert float(shown["before"]) == pytest.approx(found["before"], rel=6e-4)
    assert float(shown["after"]) == pytest.approx(found["fitted"], rel=6e-4)
    press(loop, STACK, "ArrowRight", shift=True)
    until(loop, f"{STACK}.querySelector('.spoken[aria-live]').textContent.includes('measured')")


def test_full_resolution_is_reached_by_zooming(loop: Browser, runs: Path) -> None:
    """Zoomed to a second, every sample of the speed is drawn where the axes say that its value is."""
    show(loop, STACK)
    for _ in range(6):
        press(loop, STACK, "+")
    # presses are drawn in frames of their own: the first may be there before the last one is drawn
    until(loop, f"!look.still({STACK}) && Math.max(...look.ticks({STACK})) - Math.min(...look.ticks({STACK})) < 1.5")
    with np.load(runs / "loop" / "series.npz") as series:
        time, speed = series["time/train"], series["measured/train/omega_m"]
        names = [key.rsplit("/", 1)[1] for key in series.files if key.startswith("measured/train/")]
    axes = f"look.seen({STACK}).querySelectorAll('.y.axis')[{1 + 2 * names.index('omega_m')}]"
    across = np.array(loop.evaluate(f"look.axis(look.seen({STACK}).querySelector('.x.axis'))"))
    down = np.array(loop.evaluate(f"look.axis({axes})"))
    assert np.ptp(across[:, 2]) < 1.5
    within = (time > across[0, 2]) & (time < across[-1, 2])
    assert np.count_nonzero(within) > 20
    x = np.interp(time[within], across[:, 2], across[:, 0])
    slope = (down[-1, 1] - down[0, 1]) / (down[-1, 2] - down[0, 2])
    y = down[0, 1] - 4 + slope * (speed[within] - down[0, 2])  # a tick's text stands four pixels below its line
    points = [*np.column_stack([x, y]).tolist(), [float(across[0, 0]), 2.0]]
    assert loop.evaluate(f"look.inked({STACK}, {points})") == [True] * len(x) + [False]


def test_a_tap_reads_values_and_does_not_move_the_figure(loop: Browser) -> None:
    at = show(loop, STACK)
    touch = f"""(kind, x, y) => look.seen({STACK}).dispatchEvent(new PointerEvent(kind, {{
        pointerId: 7, pointerType: 'touch', clientX: x, clientY: y, bubbles: true}}))"""
    x, y = at(0.5, 0.5)
    for kind in ("pointerdown", "pointerup", "pointerleave"):
        loop.evaluate(f"({touch})('{kind}', {x}, {y})")
    until(loop, f"look.readouts({STACK})[1].length > 1")
    assert loop.evaluate(f"look.still({STACK})")


def test_every_figure_is_saved_as_picture_and_numbers(loop: Browser, runs: Path, tmp_path: Path) -> None:
    loop.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    show(loop, STACK)
    for kind in ("PNG", "SVG", "CSV"):
        loop.evaluate(f"[...{STACK}.querySelectorAll('.save button')].find(b => b.textContent === '{kind}').click()")
        for _ in range(200):
            if found := list(tmp_path.glob(f"*.{kind.lower()}")):
                break
            time.sleep(0.05)
        assert found, kind
    assert next(tmp_path.glob("*.png")).read_bytes()[:4] == b"\x89PNG"
    drawing = next(tmp_path.glob("*.svg")).read_text("utf-8")
    assert ElementTree.fromstring(drawing).tag.endswith("svg")
    assert "var(--" not in drawing
    rows = list(csv.reader(next(tmp_path.glob("*.csv")).open(encoding="utf-8")))
    with np.load(runs / "loop" / "series.npz") as series:
        assert [float(row[0]) for row in rows[1:]] == pytest.approx(series["time/train"].tolist())
        column = next(k for k, head in enumerate(rows[0]) if head.startswith("ω") and head.endswith(": measured"))
        assert [float(row[column]) for row in rows[1:]] == pytest.approx(
            series["measured/train/omega_m"].tolist(), abs=2e-3
        )
    without = (
        "[...document.querySelectorAll('figure')].filter(f => f.querySelector('.plot') && !f.querySelector('.save'))"
    )
    assert loop.evaluate(f"{without}.length") == 0


@pytest.mark.parametrize("width", [1280, 390])
def test_the_section_bar_stays_and_tells_where_the_reader_is(loop: Browser, runs: Path, width: int) -> None:
    loop.open(runs / "loop" / "report.html", width=width)
    loop.evaluate("document.querySelector('#parameters').scrollIntoView({behavior: 'instant'})")
    until(loop, "document.querySelector('nav [aria-current]')?.hash === '#parameters'")
    assert loop.evaluate("document.querySelector('nav').getBoundingClientRect().top") == 0


def test_interval_and_status_of_a_parameter_are_in_view_on_a_phone(browser: Browser, runs: Path) -> None:
    browser.open(runs / "loop" / "report.html", width=390)
    beyond = browser.evaluate("""[...document.querySelectorAll('[aria-label=Estimates] tbody tr')].map(row =>
        (row.querySelector('.pill') || row.children[2]).getBoundingClientRect().right
        - row.closest('.scroll').getBoundingClientRect().right)""")
    assert beyond
    assert max(beyond) <= 0
    lines = browser.evaluate("""[...document.querySelectorAll('[aria-label=Estimates] tbody tr')].map(row =>
        new Set([...row.children[2].querySelectorAll('.whole')]
            .map(end => Math.round(end.getBoundingClientRect().top))).size)""")
    assert max(lines) <= 2
