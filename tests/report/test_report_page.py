"""The page of a run: whole, self-contained, readable without seeing it, and never wrong about what is not known."""

from __future__ import annotations

import json
import os
import re
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_runs import write_posterior, write_run

from aero_bayes.errors import InputError
from aero_bayes.report import write_report

VOID = {"meta", "link", "br", "img", "hr", "input"}
SHAPES = {"path", "use", "rect", "line", "circle"}


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


def small_run(directory: Path, kind: str) -> dict[str, Any]:
    """A small run's result, with the run written to the directory."""
    write_run(directory, kind, rows=301)
    return dict(json.loads((directory / "result.json").read_text(encoding="utf-8")))


def page_of(directory: Path, result: dict[str, Any]) -> str:
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "result.json").write_text(json.dumps(result), encoding="utf-8")
    return write_report(directory).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Pages of small runs of every kind."""
    base = tmp_path_factory.mktemp("runs")
    return {
        kind: write_report(write_run(base / kind, kind, rows=301)).read_text(encoding="utf-8")
        for kind in ("fit", "posterior", "loop")
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A result with every key that any kind of run writes."""
    base = tmp_path_factory.mktemp("whole")
    return small_run(base / "loop", "loop") | small_run(base / "posterior", "posterior")


@pytest.mark.parametrize("kind", ["fit", "posterior", "loop"])
def test_every_element_is_closed_and_every_id_is_used_once(pages: dict[str, str], kind: str) -> None:
    page = Page(pages[kind])
    assert page.faults == []
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    anchors = [str(a["href"])[1:] for a in page.all("a")]
    assert anchors
    assert set(anchors) <= set(ids)


@pytest.mark.parametrize("kind", ["fit", "posterior", "loop"])
def test_page_asks_for_nothing_outside_itself(pages: dict[str, str], kind: str) -> None:
    text = pages[kind]
    for tag, attributes in Page(text).elements:
        assert tag not in {"script", "iframe", "object", "embed", "base", "form"}
        for name in ("src", "href", "xlink:href", "srcset", "action", "data"):
            if attributes.get(name) is not None:
                assert str(attributes[name]).startswith(("#", "data:,"))
    assert set(re.findall(r"url\((.)", text)) <= {"#"}
    assert "@import" not in text
    assert "http://" not in text
    assert "https://" not in text
    policies = [a["content"] for a in Page(text).all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies == ["default-src 'none'; img-src data:; style-src 'unsafe-inline'"]


@pytest.mark.parametrize("kind", ["fit", "posterior", "loop"])
def test_every_drawing_has_words_and_every_cell_has_a_heading(pages: dict[str, str], kind: str) -> None:
    page = Page(pages[kind])
    drawings = page.all("svg")
    assert len(drawings) > 10
    for drawing in drawings:
        assert drawing["role"] == "img"
        assert len(str(drawing["aria-label"])) > 15
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("h1")) == 1
    assert all(cell.get("scope") in {"row", "col"} for cell in page.all("th"))
    depths = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h[1-6]", tag)]
    assert all(deeper <= depth + 1 for depth, deeper in pairwise(depths))


def test_drawings_take_their_colours_from_the_page(pages: dict[str, str]) -> None:
    drawn = "".join(re.findall(r"<svg.*?</svg>", pages["loop"], flags=re.DOTALL))
    assert "var(--accent)" in drawn
    assert re.findall(r"#[0-9a-f]{6}\b", drawn) == []
    assert {f"--{name}" for name in re.findall(r"var\(--([a-z0-9-]+)\)", pages["loop"])} <= set(
        re.findall(r"(--[a-z0-9-]+):", pages["loop"])
    )


def test_simulated_data_is_announced_only_where_it_is(pages: dict[str, str]) -> None:
    assert '<div class="simulated"' in pages["loop"]
    assert "<strong>Simulated data.</strong>" in pages["loop"]
    assert '<div class="simulated"' not in pages["fit"]


@pytest.mark.parametrize("status", ["unidentified", "fixed"])
def test_a_parameter_without_an_estimate_never_shows_an_interval(tmp_path: Path, status: str) -> None:
    entry = {"value": 0.00116, "sd": 4e-4, "q05": 0.000512, "q50": 0.00116, "q95": 0.00247, "unit": "H",
             "lower": 1e-4, "upper": 1e-2, "prior_q05": 1e-4, "prior_q95": 1e-2}  # fmt: skip
    text = page_of(tmp_path / status, {"parameters": {"L_a": {**entry, "status": status}}})
    assert "0.00116" in text
    assert "0.0005" not in text
    assert "0.0024" not in text
    assert 'class="bar"' not in text
    shown = page_of(tmp_path / "identified", {"parameters": {"L_a": {**entry, "status": "identified"}}})
    assert "0.00051" in shown
    assert "0.00247" in shown
    assert 'class="bar"' in shown


def test_values_are_shown_as_the_interval_justifies_with_unit(pages: dict[str, str]) -> None:
    row = next(row for row in Page(pages["posterior"]).rows if "Inertia of rotor" in row)
    assert "11.20" in row
    assert "11.00 … 11.40" in row
    assert "×10⁻⁶ kg·m²" in row
    assert "identified" in row


def test_warnings_and_verdict_stand_before_everything_else(pages: dict[str, str]) -> None:
    text = pages["posterior"]
    assert text.index('class="verdict warning"') < text.index('class="warnings"') < text.index("<nav")


def test_sampler_that_has_not_converged_is_called_so(tmp_path: Path) -> None:
    text = page_of(tmp_path, {"mcmc": {"converged": False, "reason": "40 autocorrelation times", "r_hat_max": 1.08}})
    assert 'class="verdict bad"' in text
    assert "has not converged (40 autocorrelation times)" in text


def test_difference_of_the_source_is_coloured_line_by_line(pages: dict[str, str]) -> None:
    kinds = [str(a.get("class")) for tag, a in Page(pages["loop"]).elements if tag == "span"]
    assert (kinds.count("hunk"), kinds.count("del"), kinds.count("add"), kinds.count("same")) == (3, 1, 5, 1)


def test_candidates_are_ranked_by_evidence_and_the_chosen_is_marked(pages: dict[str, str]) -> None:
    rows = [row for row in Page(pages["loop"]).rows if "Coulomb" not in row]
    names = ("pivot_coulomb_friction", "body_quadratic_drag", "cubic_stiffness", "rotor_coulomb_friction")
    ranked = [next(i for i, row in enumerate(rows) if row.startswith(name)) for name in names]
    assert ranked == sorted(ranked)
    assert "chosen" in rows[ranked[0]]
    assert "cannot be told apart" in rows[ranked[1]]


def test_ripple_and_encoder_are_shown_with_their_evidence(pages: dict[str, str]) -> None:
    rows = Page(pages["fit"]).rows
    assert any("ripple twice a turn" in r and "0.00809 with it, 0.00503 without" in r for r in rows)
    assert any("encoder" in r and "0.00307" in r and "0.73 %" in r for r in rows)
    assert not any("left in" in r for r in rows)


def test_paper_stands_beside_the_replay(pages: dict[str, str]) -> None:
    assert any(row.startswith("local search") and row.endswith("0.228") for row in Page(pages["posterior"]).rows)


def test_page_draws_what_is_left_when_any_piece_is_missing(tmp_path: Path, whole: dict[str, Any]) -> None:
    result = whole
    bare = tmp_path / "bare"
    for key in result:
        without = page_of(bare, {name: value for name, value in result.items() if name != key})
        alone = page_of(bare, {key: result[key]})
        assert Page(without).faults == Page(alone).faults == []
    assert Page(page_of(bare, {})).faults == []


@pytest.mark.parametrize("odd", [None, "text", 3.5, True, [None], ["text"], {"text": None}, {"a": {"b": None}}])
def test_page_survives_values_of_another_shape(odd: object, tmp_path: Path, whole: dict[str, Any]) -> None:
    result = whole | {"fit": {}}
    for key in whole.keys() - {"schema"}:
        assert Page(page_of(tmp_path / "bare", result | {key: odd})).faults == []
    for key in result["loop"]:
        assert Page(page_of(tmp_path / "bare", {"loop": result["loop"] | {key: odd}})).faults == []


@pytest.mark.parametrize("missing", ["series.npz", "posterior.nc"])
def test_page_needs_neither_series_nor_posterior(missing: str, tmp_path: Path) -> None:
    write_run(tmp_path, "loop", rows=301)
    (tmp_path / missing).unlink()
    text = write_report(tmp_path).read_text(encoding="utf-8")
    assert Page(text).faults == []
    assert ("Parameters in pairs" in text) == (missing != "posterior.nc")


@pytest.mark.parametrize("group", ["input", "measured", "fitted", "lower", "before", "after", "port", "portstate"])
def test_page_draws_the_other_series_when_one_group_is_missing(group: str, tmp_path: Path) -> None:
    write_run(tmp_path, "loop", rows=61, outputs=("theta",))
    (tmp_path / "posterior.nc").unlink()
    with np.load(tmp_path / "series.npz") as archive:
        kept = {key: archive[key] for key in archive.files if not key.startswith(f"{group}/")}
    np.savez(tmp_path / "series.npz", **kept)
    assert Page(write_report(tmp_path).read_text(encoding="utf-8")).faults == []


def test_series_without_a_single_finite_value_are_left_out(tmp_path: Path) -> None:
    time = np.linspace(0, 1, 50)
    blank = np.full(50, np.nan)
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    np.savez(tmp_path / "series.npz", **{"time/a": time, "measured/a/theta": blank, "fitted/a/theta": blank,
                                         "before/a/theta": blank, "port/a/body": blank, "portstate/a/theta": blank,
                                         "replay/time": time, "replay/measured": blank})  # fmt: skip
    assert Page(write_report(tmp_path).read_text(encoding="utf-8")).faults == []


def test_names_from_the_data_are_text_and_never_markup(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    result = small_run(tmp_path / "run", "loop")
    text = json.dumps(result).replace("step_16v5", evil).replace("pivot_coulomb_friction", "<img src=x onerror=y>")
    result = json.loads(text)
    result["parameters"]['"><b onclick="z'] = {
        "value": 1.0,
        "unit": "<i>",
        "description": evil,
        "prior": evil,
        "status": evil,
    }
    result |= {
        "title": evil,
        "verdict": {"text": evil, "level": evil},
        "warnings": [evil, f"`{evil}`"],
        "command": evil,
    }
    with np.load(tmp_path / "run" / "series.npz") as archive:
        series = {key.replace("step_16v5", evil).replace("theta", "<u>$x$</u>"): archive[key] for key in archive.files}
    np.savez(tmp_path / "run" / "series.npz", **series)
    page = Page(page_of(tmp_path / "run", result))
    assert page.faults == []
    assert {tag for tag, _ in page.elements}.isdisjoint({"script", "img", "b", "u"})
    assert [name for _, attributes in page.elements for name in attributes if name.startswith("on")] == []


def test_a_recording_may_have_a_slash_in_its_name(tmp_path: Path) -> None:
    time = np.linspace(0, 1, 50)
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    np.savez(tmp_path / "series.npz", **{"time/a/b": time, "measured/a/b/theta": time, "fitted/a/b/theta": time**2})
    assert "<h3>a/b</h3>" in write_report(tmp_path).read_text(encoding="utf-8")


def test_one_run_always_gives_the_same_page(tmp_path: Path) -> None:
    write_run(tmp_path, "posterior", rows=301, outputs=("theta",))
    first = write_report(tmp_path).read_bytes()
    assert write_report(tmp_path).read_bytes() == first


def test_long_recordings_still_make_a_light_page(tmp_path: Path) -> None:
    page = write_report(write_run(tmp_path, "loop", rows=30001))
    assert page.stat().st_size < 3_000_000


def test_page_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "report.html"
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    page.write_text("the page before", encoding="utf-8")

    def refuse(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="disk full"):
        write_report(tmp_path)
    assert page.read_text(encoding="utf-8") == "the page before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "result.json"]


def test_directory_without_a_result_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no result\.json there"):
        write_report(tmp_path)
    with pytest.raises(InputError, match=r"no result\.json there"):
        write_report(tmp_path / "nowhere")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("result.json", b'{"schema": 1,\n "seed": }', r"result\.json: line 2, column 10: not valid JSON"),
        ("result.json", b"[1, 2]", "holds a list, expected an object"),
        ("result.json", b'{"schema": 2}', "schema 2, this version draws schema 1"),
        ("result.json", b"\xff\xfe\x00", "not UTF-8"),
        ("series.npz", b"not an archive", r"series\.npz: not a readable archive"),
        ("posterior.nc", b"not a posterior", r"posterior\.nc: not a readable posterior"),
    ],
)
def test_damaged_files_are_input_errors_in_one_line(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        write_report(tmp_path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "report.html").exists()


def test_series_of_another_length_than_its_times_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    np.savez(tmp_path / "series.npz", **{"time/a": np.arange(9.0), "measured/a/theta": np.zeros(8)})
    with pytest.raises(InputError, match=r"measured/a/theta has shape \(8,\), expected \(9,\)"):
        write_report(tmp_path)


def test_pair_plot_leaves_out_what_the_data_do_not_determine(tmp_path: Path, whole: dict[str, Any]) -> None:
    (tmp_path / "few").mkdir()
    kept = {name: whole["parameters"][name] for name in ("R_a", "c_m", "L_a")}
    write_posterior(tmp_path / "few" / "posterior.nc", {"parameters": kept}, np.random.default_rng(3))
    text = page_of(tmp_path / "few", {"parameters": kept})
    assert "Pair plot of 2 parameters" in text
