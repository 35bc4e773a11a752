"""The page for those who do not see it, see little, or use no mouse: axe-core's rules, contrast, keys, paper."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import axe_core_python
import pytest
from headless_chromium import Browser

pytestmark = pytest.mark.long

AXE = (Path(axe_core_python.__file__).parent / "axe.min.js").read_text("utf-8")
RUN = """axe.run(document, {resultTypes: ['violations', 'incomplete']}).then(found => JSON.stringify(
    [...found.violations.map(v => [v.id, v.nodes[0].html, v.nodes[0].failureSummary]),
     ...found.incomplete.filter(v => v.id !== 'color-contrast').map(v => [v.id, v.nodes[0].html])]))"""
#: axe leaves contrast undecided over the shadows of scrolling tables and in drawings; here every text is measured.
CONTRAST = """(() => {
    const part = c => (c /= 255, c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    const numbers = colour => { const c = document.createElement('canvas').getContext('2d', {willReadFrequently: true});
        c.fillStyle = colour; c.fillRect(0, 0, 1, 1); return [...c.getImageData(0, 0, 1, 1).data]; };
    const light = ([r, g, b]) => 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
    const ground = element => { for (let e = element; e; e = e.parentElement) {
        const colour = numbers(getComputedStyle(e).backgroundColor); if (colour[3] === 255) return colour; }
        return [255, 255, 255]; };
    const poor = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    let measured = 0;
    while (walk.nextNode()) {
        const element = walk.currentNode.parentElement, style = getComputedStyle(element);
        const box = element.getBoundingClientRect();
        if (!walk.currentNode.textContent.trim() || !box.width || style.visibility === 'hidden') continue;
        if (element.closest('script, style, noscript')) continue;
        const colour = numbers(element.closest('svg') ? style.fill : style.color);
        const [a, b] = [light(colour), light(ground(element))].sort((x, y) => y - x);
        const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
        measured += 1;
        if ((a + 0.05) / (b + 0.05) < (large ? 3 : 4.5))
            poor.push([walk.currentNode.textContent.trim().slice(0, 40), element.outerHTML.slice(0, 80)]);
    }
    return [measured, poor.slice(0, 8)];
})()"""
OPEN = "document.querySelectorAll('details').forEach(d => d.open = true)"
TABBABLE = """[...document.querySelectorAll('a[href], button, summary, input, select, [tabindex="0"]')].filter(e =>
    !e.disabled && e.checkVisibility({contentVisibilityAuto: true, visibilityProperty: true}))"""


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (400, True)])
def test_axe_finds_no_violation(browser: Browser, page: Path, width: int, dark: bool) -> None:
    browser.open(page, width=width, dark=dark)
    browser.evaluate(OPEN)
    browser.evaluate(AXE + ";0")
    found = browser.tab("Runtime.evaluate", expression=RUN, awaitPromise=True, returnByValue=True)
    assert json.loads(found["result"]["value"]) == []


@pytest.mark.parametrize("dark", [False, True])
def test_all_text_stands_out_from_its_ground(browser: Browser, page: Path, dark: bool) -> None:
    """4.5 to 1, large text 3 to 1 (WCAG 1.4.3), in drawings too."""
    browser.open(page, dark=dark)
    browser.evaluate(OPEN)
    measured, poor = browser.evaluate(CONTRAST)
    assert measured > 150
    assert poor == []


def test_the_watch_axe_and_the_measure_of_contrast_hear_what_is_wrong(browser: Browser, tmp_path: Path) -> None:
    bad = tmp_path / "bad.html"
    bad.write_text(
        "<html><body><p style='color:#aaa'>pale</p><button></button><h1>a</h1><h4>b</h4>"
        '<script>console.error("heard")</script><img src="http://127.0.0.1:9/seen.png"></body></html>',
        "utf-8",
    )
    browser.open(bad)
    assert any("heard" in said for said in browser.complaints())
    assert "http://127.0.0.1:9/seen.png" in browser.requests()
    browser.evaluate(AXE + ";0")
    found = browser.tab("Runtime.evaluate", expression=RUN, awaitPromise=True, returnByValue=True)
    ids = {violation[0] for violation in json.loads(found["result"]["value"])}
    assert {"button-name", "heading-order", "html-has-lang"} <= ids
    assert [text for text, _ in browser.evaluate(CONTRAST)[1]] == ["pale"]


def test_the_tab_key_reaches_everything(browser: Browser, page: Path) -> None:
    browser.open(page)
    wanted = browser.evaluate(f"window.reached = new Set(); {TABBABLE}.length")
    assert wanted > 1
    browser.evaluate("document.addEventListener('focusin', e => reached.add(e.target))")
    missed = f"{TABBABLE}.filter(e => !reached.has(e)).map(e => e.outerHTML.slice(0, 90))"
    for _ in range(20):  # laps: what is unpacked, or comes into view, is made to be used when the machine gets to it
        for _ in range(2 * wanted + 20):
            for kind in ("keyDown", "keyUp"):
                browser.tab("Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab", windowsVirtualKeyCode=9)
        if not browser.evaluate(missed):
            break
    assert browser.evaluate(missed) == []


@pytest.mark.parametrize("page", ["loop", "posterior"], indirect=True)
def test_the_page_is_printed_whole(browser: Browser, page: Path) -> None:
    """On A4, nothing wider than the paper between its margins, figures as still pictures."""
    browser.open(page, width=718)
    browser.tab("Emulation.setEmulatedMedia", media="print")
    try:
        beyond = """[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > 719).map(e =>
            e.outerHTML.slice(0, 90))"""
        assert browser.evaluate(beyond) == []
        shown = "[...document.querySelectorAll('{}')].map(e => getComputedStyle(e).display)"
        assert set(browser.evaluate(shown.format(".tools, .numbers"))) == {"none"}
        assert "block" in browser.evaluate(shown.format("svg.plot"))
        paper = base64.b64decode(browser.tab("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)["data"])
    finally:
        browser.tab("Emulation.setEmulatedMedia", media="")
    assert paper.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", paper)) < 40
