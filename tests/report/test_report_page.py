"""The page of a run: whole, self-contained, readable without seeing it, and never wrong about what is not known."""

from __future__ import annotations

import base64
import errno
import hashlib
import io
import json
import os
import re
import shutil
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from facts import facts

from aero_bayes.cli import main
from aero_bayes.errors import InputError
from aero_bayes.report.page import write_run_page

VOID = {"meta", "link", "br", "img", "hr", "input"}
LAW_INTERFACES = {"path", "use", "rect", "line", "circle"}
KINDS = ("loop", "posterior")


class Page(HTMLParser):
    """A page as elements with their attributes, the text within table rows, and what is not properly closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[str] = []
        self.faults: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        self.faults += [f"<{tag}> is not closed" for tag in self._open]

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))
        if tag == "tr":
            self.rows.append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open[-1] != tag:
            self.faults.append(f"</{tag}> closes {self._open[-1:]}")
        else:
            self._open.pop()

    def handle_data(self, data: str) -> None:
        if "tr" in self._open:
            self.rows[-1] += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="session")
def pages(runs: Path) -> dict[str, str]:
    """Pages of the runs as the program wrote them."""
    return {kind: (runs / kind / "report.html").read_text("utf-8") for kind in KINDS}


def copied(runs: Path, kind: str, target: Path) -> Path:
    """A copy of what the page is drawn from."""
    target.mkdir(parents=True, exist_ok=True)
    for name in ("result.json", "series.npz", "posterior.nc"):
        if (runs / kind / name).exists():
            shutil.copy(runs / kind / name, target / name)
    return target


def result_of(directory: Path) -> dict[str, Any]:
    return dict(json.loads((directory / "result.json").read_text("utf-8")))


def page_of(directory: Path, result: dict[str, Any]) -> str:
    (directory / "result.json").write_text(json.dumps(result), "utf-8")
    return write_run_page(directory).read_text("utf-8")


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_is_whole_asks_for_nothing_and_runs_nothing_but_its_own_script(pages: dict[str, str], kind: str) -> None:
    text = pages[kind]
    page = Page(text)
    assert page.faults == []
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    anchors = [str(a["href"])[1:] for a in page.all("a")]
    assert anchors
    assert set(anchors) <= set(ids)
    for tag, attributes in page.elements:
        assert tag not in {"iframe", "object", "embed", "base", "form"}
        for name in ("src", "href", "xlink:href", "srcset", "action", "data"):
            if attributes.get(name) is not None:
                assert str(attributes[name]).startswith(("#", "data:,"))
    assert set(re.findall(r"url\((.)", text)) <= {"#"}
    assert "@import" not in text
    policy = str(page.all("meta")[1]["content"])
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    assert policy.startswith("default-src 'none'")
    assert re.findall(r"script-src '([^']*)'$", policy) == [f"sha256-{digest}" for digest in digests]


@pytest.mark.parametrize("kind", KINDS)
def test_every_drawing_has_words_and_every_figure_a_table(pages: dict[str, str], kind: str) -> None:
    page = Page(pages[kind])
    drawings = [a for tag, a in page.elements if tag == "svg" and "class" in a]  # others are parts of one
    assert len(drawings) > 10
    assert all(a.get("role") == "img" and len(str(a.get("aria-label"))) > 10 for a in drawings)
    figures = re.findall(r"<figure.*?</figure>", pages[kind], re.DOTALL)
    assert len(figures) > 5
    assert all('<details class="numbers">' in figure and "<table>" in figure for figure in figures)
    tables = re.findall(r"<table.*?</table>", pages[kind].partition("<main")[2], re.DOTALL)
    assert all("<caption" in table for table in tables)
    rows = re.findall(r"<tr.*?</tr>", "".join(t.partition("<tbody>")[2] for t in tables), re.DOTALL)
    assert all('<th scope="row"' in row for row in rows)
    drawn = pages[kind].partition("</style>")[2].partition('<script type="application/json"')[0]
    assert not re.findall(r"(?:fill|stroke):(?!none|var\()[^;\"]+", drawn)  # colours are those of the page
    heads = [a for tag, a in page.elements if tag == "th"]
    assert heads
    assert all(a.get("scope") in {"col", "row"} for a in heads)
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


def test_the_finding_stands_first_then_the_numbers_then_the_picture(pages: dict[str, str]) -> None:
    text = pages["loop"].partition("</style>")[2]
    places = [
        text.index(mark)
        for mark in ("<nav", "lacks", 'class="verdict', "What is missing", "How we know", "unseen from", "<svg")
    ]  # fmt: skip
    assert places == sorted(places)
    head = text[: text.index("unseen from")]
    assert all(label in head for label in (">before<", ">after<", ">noise<", "pivot_coulomb_friction"))


def test_simulated_data_is_announced_only_where_it_is(runs: Path, pages: dict[str, str], tmp_path: Path) -> None:
    assert all("Simulated data." in text for text in pages.values())
    result = result_of(copied(runs, "loop", tmp_path)) | {"simulated": False}
    assert "Simulated data." not in page_of(tmp_path, result)


@pytest.mark.parametrize("status", ["fixed", "unidentified", "at_bound"])
def test_a_parameter_without_an_estimate_never_shows_an_interval(runs: Path, status: str, tmp_path: Path) -> None:
    result = result_of(copied(runs, "posterior", tmp_path))
    result["parameters"]["R_a"] |= {"status": status, "value": 8.125, "q05": 7.6543, "q95": 9.8765}
    (tmp_path / "posterior.nc").unlink()
    text = page_of(tmp_path, result)
    assert "8.125" in text
    assert "7.65" not in text
    assert ("on a bound" in text) == (status == "at_bound")


def test_the_rounds_name_every_candidate_and_mark_the_chosen(runs: Path, pages: dict[str, str]) -> None:
    step = result_of(runs / "loop")["loop"]["steps"][0]
    rows = Page(pages["loop"]).rows
    for candidate in step["candidates"]:
        row = next(r for r in rows if r.startswith(candidate["id"]))
        assert ("chosen" in row) == (candidate["id"] == step["chosen"])
    assert step["chosen"] == "pivot_coulomb_friction"


@pytest.mark.parametrize("claim", ["law", "place", "one of"])
def test_the_head_says_how_far_the_error_falls_and_what_does_as_well(runs: Path, claim: str, tmp_path: Path) -> None:
    result = result_of(copied(runs, "loop", tmp_path))
    rival = {"id": "other_law", "port": "body", "error_ratio": 1.04}
    effect = result["loop"]["effects"][0] | {"share": 0.123, "share_sd": 0.02, "claim": claim, "alternatives": [rival]}
    result["loop"]["effects"][0] = effect
    page = Page(page_of(tmp_path, result))
    text = (tmp_path / "report.html").read_text("utf-8")
    assert "88 ± 2" in text
    assert any("other_law" in row and "larger" in row for row in page.rows)
    assert ("one of two effects" in text) == (claim == "one of")


PROFILE = {"unit": "ohm", "values": [8.0, 8.1, 8.2, 8.3], "drop": [2.0, 0.0, 0.5, None], "interval": [8.03, None]}


@pytest.mark.parametrize(
    ("key", "told", "shown"),
    [
        ("sensors", {"theta": {"encoder": {"step": 0.003068, "share": 0.0073}}}, ("0.00307", "0.73 %")),
        ("process_noise", {"theta": {"value": 0.0123, "unit": "rad/sqrt(s)"}}, ("θ", "0.0123")),
        (
            "prediction",
            {"recordings": {"train": {"rms": {"theta": 0.02}, "rms_fitted": {"theta": 0.016}}}},
            ("train", "+25.0 %"),
        ),
        ("identifiability", {"profiles": {"R_a": PROFILE}, "profile_drop_90": 1.35}, ("8.175 … 8.2", "0.5")),
    ],
)
def test_what_only_some_runs_have_is_shown(
    runs: Path, key: str, told: dict[str, Any], shown: tuple[str, ...], tmp_path: Path
) -> None:
    result = result_of(copied(runs, "posterior", tmp_path)) | {key: told}
    rows = Page(page_of(tmp_path, result)).rows
    assert any(all(text in row for text in shown) for row in rows)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_page_draws_what_is_left_when_any_piece_is_missing(runs: Path, kind: str, tmp_path: Path) -> None:
    result = result_of(copied(runs, kind, tmp_path))
    for name in ("series.npz", "posterior.nc"):
        (tmp_path / name).unlink(missing_ok=True)
    for key in result:
        without = page_of(tmp_path, {name: value for name, value in result.items() if name != key})
        assert Page(without).faults == []
    assert Page(page_of(tmp_path, {})).faults == []


@pytest.mark.parametrize("group", ["input", "measured", "fitted", "before", "after"])
def test_page_draws_the_other_series_when_one_group_is_missing(runs: Path, group: str, tmp_path: Path) -> None:
    copied(runs, "loop", tmp_path)
    with np.load(tmp_path / "series.npz") as archive:
        kept = {key: archive[key] for key in archive.files if not key.startswith(f"{group}/")}
    np.savez(tmp_path / "series.npz", **kept)
    assert Page(write_run_page(tmp_path).read_text("utf-8")).faults == []


def test_names_from_the_data_are_text_and_never_markup(runs: Path, pages: dict[str, str], tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>"
    text = (copied(runs, "loop", tmp_path) / "result.json").read_text("utf-8")
    result = json.loads(
        text.replace('"train"', json.dumps(evil)).replace("pivot_coulomb_friction", "<img src=x onerror=y>")
    )
    for row in (*result["recordings"], *result["loop"]["errors"], *result["loop"]["parts"]):
        row["role"] = "train"
    result["warnings"], result["command"] = [evil, f"`{evil}`"], evil
    result["parameters"]['"><b onclick="z'] = {"value": 1.0, "unit": "<i>", "description": evil, "prior": evil}
    with np.load(tmp_path / "series.npz") as archive:
        series = {
            key.replace("/train", f"/{evil}").replace("theta", "<u>$x$</u>"): archive[key] for key in archive.files
        }
    np.savez(tmp_path / "series.npz", **series)
    page = Page(page_of(tmp_path, result))
    assert page.faults == []
    assert {tag for tag, _ in page.elements}.isdisjoint({"img", "b", "u"})
    assert len(page.all("script")) == len(Page(pages["loop"]).all("script")) == 2
    assert [name for _, attributes in page.elements for name in attributes if name.startswith("on")] == []


def test_a_recording_may_have_a_slash_in_its_name_and_no_finite_value(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}", "utf-8")
    time, blank = np.linspace(0, 1, 50), np.full(50, np.nan)
    series = {"time/a/b": time, "measured/a/b/y": time, "fitted/a/b/y": time**2, "before/a/b/y": blank}
    np.savez(tmp_path / "series.npz", **series)
    assert ">a/b, " in write_run_page(tmp_path).read_text("utf-8")
    np.savez(tmp_path / "series.npz", **{"time/a": time, "measured/a/y": blank, "fitted/a/y": blank})
    assert Page(write_run_page(tmp_path).read_text("utf-8")).faults == []


def test_the_page_is_drawn_again_from_the_files_of_its_run(runs: Path, tmp_path: Path) -> None:
    for kind in KINDS:
        done = CliRunner().invoke(main, ["report", str(copied(runs, kind, tmp_path / kind))])
        assert done.exit_code == 0, done.output
        assert (tmp_path / kind / "report.html").read_bytes() == (runs / kind / "report.html").read_bytes()


def test_page_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "report.html"
    (tmp_path / "result.json").write_text("{}", "utf-8")
    page.write_text("the page before", "utf-8")

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "disk full")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="disk full"):
        write_run_page(tmp_path)
    assert page.read_text("utf-8") == "the page before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "result.json"]


def test_directory_without_a_result_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no result\.json there"):
        write_run_page(tmp_path)
    with pytest.raises(InputError, match=r"no result\.json there"):
        write_run_page(tmp_path / "nowhere")
    assert list(tmp_path.iterdir()) == []


SHORT = io.BytesIO()
np.savez(SHORT, **{"time/a": np.arange(9.0), "measured/a/y": np.zeros(8)})


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("series.npz", SHORT.getvalue(), facts("measured/a/y", "(8,)", "(9,)")),
        ("result.json", b'{"schema": 1,\n "seed": }', r"result\.json: line 2, column 10: not valid JSON"),
        ("result.json", b"[1, 2]", "holds a list, expected an object"),
        ("result.json", b'{"schema": 2}', "schema 2, this version draws schema 1"),
        (
            "result.json",
            b'{"fit": {"pso": {"evaluations": "many"}}}',
            r"fit\.pso\.evaluations: input should be a valid",
        ),
        ("result.json", b"\xff\xfe\x00", "not UTF-8"),
        ("series.npz", b"not an archive", r"series\.npz: not a readable archive"),
        ("posterior.nc", b"not a posterior", r"posterior\.nc: is no posterior"),
    ],
)
def test_damaged_files_are_input_errors_in_one_line(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}", "utf-8")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        write_run_page(tmp_path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "report.html").exists()
