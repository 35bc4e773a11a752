"""Thinning, numbers, names and statistics of the page, against closed forms and plain loops."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from xml.etree import ElementTree

import numpy as np
import pytest
from pydantic import TypeAdapter

from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.residual_tests import RecordingError
from aero_bayes.loop.extend import FoundEffect
from aero_bayes.report import words
from aero_bayes.report.drawing import Line, Panel, band_envelope, data_table, draw, envelope, nice_ticks
from aero_bayes.report.findings import _beside_noise, _changed, checks_table
from aero_bayes.report.page import BITS, pack_series
from aero_bayes.report.pairs import most_correlated
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.svg import Canvas
from aero_bayes.report.tables import html_table, parameter_table
from aero_bayes.report.text import duration, pretty_unit, rounded_value, sentence, signed, significant, symbol, tidy

pytestmark = pytest.mark.fast


@pytest.mark.parametrize("seed", range(20))
def test_envelope_keeps_the_extremes_of_every_column(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.1, 2.0, 5000))
    values = rng.standard_normal(5000).cumsum()
    values[rng.integers(5000)] += 1000
    thin_time, thin = envelope(time, values, 100)
    assert len(thin) <= 200
    assert np.all(np.diff(thin_time) >= 0)
    assert (thin.min(), thin.max()) == (values.min(), values.max())
    column = np.minimum(((time - time[0]) / (time[-1] - time[0]) * 100).astype(int), 99)
    for index, pair in zip(np.unique(column), thin.reshape(-1, 2), strict=True):
        assert sorted(pair) == [values[column == index].min(), values[column == index].max()]


def test_envelope_keeps_gaps_and_leaves_short_series_alone() -> None:
    time = np.linspace(0, 1, 1001)
    values = np.sin(time)
    values[400:600] = np.nan
    thin_time, thin = envelope(time, values, 50)
    inside = (thin_time > 0.42) & (thin_time < 0.58)
    assert np.isnan(thin[inside]).all()
    assert np.isfinite(thin[~inside & (np.abs(thin_time - 0.5) > 0.12)]).all()
    assert envelope(time[:90], values[:90], 50)[1] is not None
    np.testing.assert_array_equal(envelope(time[:90], values[:90], 50)[1], values[:90])


def test_thinned_band_contains_the_band() -> None:
    rng = np.random.default_rng(4)
    time = np.linspace(0, 10, 4000)
    low, high = -rng.uniform(1, 2, 4000), rng.uniform(1, 2, 4000)
    _, thin_low, thin_high = band_envelope(time, low, high, 80)
    column = np.minimum((time / 10 * 80).astype(int), 79)
    assert np.all(thin_low[column] <= low)
    assert np.all(thin_high[column] >= high)


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ((9.6021, 9.5861, 9.6189, "ohm"), ("9.602", "9.586", "9.619", "Ω")),
        ((1.1203e-5, 1.0987e-5, 1.1409e-5, "kg.m2"), ("11.20", "10.99", "11.41", "×10⁻⁶ kg·m²")),
        ((-0.0021, -0.0040, -0.0003, "N.m"), ("−0.0021", "−0.0040", "−0.0003", "N·m")),
        ((0.00120042, 0.00119951, 0.00120133, "s"), ("0.0012004", "0.0011995", "0.0012013", "s")),
        ((-7.824e-4, None, None, "m"), ("−0.0007824", "–", "–", "m")),
        ((0.0, -1.2, 1.3, "V"), ("0.0", "−1.2", "1.3", "V")),
        ((0.0219, None, None, "kg m^2"), ("0.0219", "–", "–", "kg·m²")),
        ((4.0e-6, None, None, "kg.m2"), ("4", "–", "–", "×10⁻⁶ kg·m²")),
        ((12345.6, 12000.0, 12700.0, "1"), ("12346", "12000", "12700", "")),
        ((None, None, None, ""), ("–", "–", "–", "")),
        ((float("nan"), 1.0, 2.0, "s"), ("–", "1.00", "2.00", "s")),
    ],
)
def test_quantities_carry_the_digits_their_interval_justifies(given: tuple, shown: tuple) -> None:
    found = rounded_value(*given)
    assert (found.value, found.low, found.high, found.unit) == shown


def test_a_power_of_ten_stands_at_each_number_of_a_table() -> None:
    found = rounded_value(3.4412e-6, 3.4e-6, 3.48e-6, "kg.m2").apart
    assert (found.value, found.low, found.high) == ("3.44×10⁻⁶", "3.40×10⁻⁶", "3.48×10⁻⁶")
    assert found.unit == "kg·m²"
    plain = rounded_value(9.6021, 9.5861, 9.6189, "ohm")
    assert plain.apart == plain


def test_an_interval_that_is_not_even_is_written_by_its_ends_everywhere() -> None:
    """At a bound half of a width would be another interval than that of the table."""
    told = {"value": 0.003, "q05": 0.001, "q95": 0.089, "unit": "m/s", "status": "identified"}
    held = {"value": 0.1, "q05": 0.05, "q95": 0.1, "unit": "m/s", "status": "at_bound"}
    effect = TypeAdapter(FoundEffect).validate_python(
        {"id": "law@v", "port": "v", "kind": "catalogue", "parameters": {"v_s": told, "v_b": held}}
    )
    text = words.values(effect, {})
    assert "±" not in text
    low, high = (float(x) for x in re.search(r"\(([\d.]+) to ([\d.]+)\)", text).groups())
    assert (low, high) == (0.001, 0.089)
    assert "0.05" not in text.partition("v_b")[2]
    table = str(parameter_table({p.name: p for p in effect.parameters}))
    assert f"{low:.3f}" in table
    assert f"{high:.3f}" in table


def test_a_ratio_to_a_noise_that_is_not_known_is_not_one() -> None:
    """What was fitted is beside itself 1, whatever it is."""
    error = RecordingError("r", "train", "y", None, 0.2, 0.2, False, 1.0, 1e-9, "structured")
    told = {known: _beside_noise(replace(error, noise_known=known)) for known in (True, False)}
    assert told[True] == "1.00"
    assert not any(digit in told[False] for digit in "0123456789")
    assert _beside_noise(replace(error, role="test", ratio=2.0)) == "2.00"


#: Numbers, times, units and changes as the page writes them.
WRITTEN = [
    *((significant, (x,), shown) for x, shown in (
        (0, "0"), (1234.5, "1230"), (0.00123456, "0.00123"), (9.999e-5, "1.00×10⁻⁴"), (-2.5e7, "−2.50×10⁷"),
        (99.97, "100"), (None, "–"), (float("inf"), "–"),
    )),
    *((tidy, (x,), shown) for x, shown in (
        (3.1, "3.1"), (1000.0, "1000"), (251307, "251\u202f307"), (0.0110, "0.011"), (1e-12, "1×10⁻¹²"),
    )),
    *((duration, (x,), shown) for x, shown in (
        (0.021, "21 ms"), (9.4, "9.40 s"), (148, "2 min 28 s"), (7325, "2 h 02 min"),
    )),
    *((pretty_unit, (x,), shown) for x, shown in (
        ("kg.m2", "kg·m²"), ("kg m^2", "kg·m²"), ("N.m.s/rad", "N·m·s/rad"), ("N*s^2", "N·s²"), ("ohm", "Ω"),
        ("Ohm", "Ω"), ("m.s-1", "m·s⁻¹"), ("rad/s", "rad/s"), ("1", ""), (None, ""), ("%", "%"),
    )),
    (signed, (0.04, 1), "0.0"), (signed, (-0.04, 1), "0.0"), (signed, (-0.06, 1), "−0.1"), (signed, (92.6, 0), "+93"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "given", "shown"), WRITTEN)
def test_numbers_are_written_as_a_person_does(written: Callable[..., str], given: tuple, shown: str) -> None:
    assert written(*given) == shown


def test_symbols_and_code() -> None:
    assert "<i>R</i><sub>a</sub>" in symbol("R_a")
    assert "<i>ω</i><sub>m</sub>" in symbol("omega_m")
    assert symbol("input_delay[a<b]") == "<code>input_delay[a&lt;b]</code>"
    assert sentence("`theta` < 3") == f"{symbol('theta')} &lt; 3"
    assert sentence("a ` b") == "a ` b"


def test_a_value_many_times_larger_is_told_as_a_factor() -> None:
    assert _changed(40.0, 25313.0).startswith("633")
    assert "%" not in _changed(-2.0, -9.0)
    assert _changed(2.0, 1.0) == "−50.0\u00a0%"
    assert "%" in _changed(-2.0, 9.0)  # no factor leads from one sign to the other


def test_a_check_that_the_page_names_has_its_row() -> None:
    """The long sentence of a loop has it, too, but the page's head does not."""
    row = DiagnosisRow("data", True, "u was read with noise", "in r", "Measure better.")
    result = RunJson(diagnosis=[row])
    assert "u was read with noise" in checks_table(result, "With it only noise is left.")
    assert "data" in words.checks_line(result)
    assert words.checks_told(result, "") == ["Data: u was read with noise (in r). Measure better."]
    assert words.checks_told(result, "Data: u was read with noise (in r).") == []


def test_tables_escape_what_is_not_markup_and_numbers_stand_right() -> None:
    table = html_table(("name", "size", "unit"), [("<b>", "−3.1", "1/s"), ("ok", None, "m")], "a & b", marked=(1,))
    assert re.findall('<td data-of="(.*?)" class="(.*?)">', table)[0] == ("size", "right")
    assert re.findall('<td [^>]*class="(.*?)">', table) == ["right", "left"] * 2
    assert html_table(("name",), []) == ""
    assert "&lt;b&gt;" in table
    assert "<b>" not in table
    assert "a &amp; b" in table
    assert table.count('class="marked"') == 1
    assert "–" in table


def test_pair_plot_picks_the_strongest_correlations() -> None:
    rng = np.random.default_rng(7)
    draws = {f"p{index}": rng.standard_normal((4, 500)) for index in range(12)}
    draws["p11"] = draws["p3"] + 0.1 * draws["p11"]
    draws["still"] = np.ones((4, 500))
    chosen = most_correlated(draws, most=4)
    assert len(chosen) == 4
    assert {"p3", "p11"} <= set(chosen)
    assert "still" not in chosen


def test_ticks_are_round_and_within_the_ends() -> None:
    assert nice_ticks(0, 30, 9) == [0, 5, 10, 15, 20, 25, 30]
    assert nice_ticks(-0.013, 0.021, 4) == pytest.approx([-0.01, 0, 0.01, 0.02])
    assert nice_ticks(-15.6, 15.6, 3) == [-10, 0, 10]
    assert nice_ticks(1, 1, 4) == []
    rng = np.random.default_rng(8)
    for low, span in zip(rng.uniform(-1e3, 1e3, 300), 10 ** rng.uniform(-6, 6, 300), strict=True):
        ticks = nice_ticks(low, low + span, 5)
        assert 2 <= len(ticks) <= 5
        assert low - 1e-6 * span <= ticks[0] <= ticks[-1] <= low + span * (1 + 1e-6)


def drawn_points(svg: str) -> list[np.ndarray]:
    """The polylines of a drawing's paths, each of shape (n, 2)."""
    pieces = [piece for data in re.findall(r' d="([^"]*)"', svg) for piece in data.split("M") if piece]
    found = [np.array(re.findall(r"-?(?:\d+\.?\d*|\.\d+)", piece), dtype=float) for piece in pieces]
    return [np.cumsum(steps.reshape(-1, 2), axis=0) for steps in found]


def test_curves_pass_every_point_with_no_more_points_than_needed() -> None:
    rng = np.random.default_rng(9)
    corners = np.column_stack([np.sort(rng.uniform(0, 900, 40)), rng.uniform(0, 200, 40)])
    share = np.linspace(0, 39, 4000)
    x, y = (np.interp(share, np.arange(40), corners[:, axis]) for axis in (0, 1))
    canvas = Canvas(900, 200, "a curve")
    canvas.curve(np.repeat(x, 2), np.repeat(y, 2), "ink")
    (path,) = drawn_points(canvas.svg())
    assert len(path) < 4000
    starts, ways = path[:-1], np.diff(path, axis=0)
    for point in np.column_stack([x, y])[::7]:
        along = np.clip(np.sum((point - starts) * ways, axis=1) / np.sum(ways**2, axis=1), 0, 1)
        assert np.min(np.hypot(*(starts + along[:, None] * ways - point).T)) < 0.1


def test_repeated_points_do_not_hide_a_corner_and_gaps_break_the_curve() -> None:
    canvas = Canvas(10, 10, "corner")
    canvas.curve([0, 1, 1, 1, 2, 3, 4, np.nan, 6, 7], [0, 0, 0, 5, 5, 5, 5, 1, 1, 1], "ink")
    first, second = drawn_points(canvas.svg())
    assert first.tolist() == [[0, 0], [1, 0], [1, 5], [4, 5]]
    assert second.tolist() == [[6, 1], [7, 1]]


def test_drawings_escape_words_and_set_subscripts() -> None:
    canvas = Canvas(10, 10, 'a "quoted" <name>')
    canvas.text(1, 1, "R_a < k_t2 and some_name")
    svg = str(canvas.svg())
    assert "R<tspan" in svg
    assert "some_name" in svg
    assert "&lt; k<tspan" in svg
    assert "<name>" not in svg
    assert ElementTree.fromstring(svg).get("aria-label") == 'a "quoted" <name>'


def test_panels_put_values_where_the_axis_says() -> None:
    x = np.array([0.0, 10.0])
    panel = Panel("p (V)", (Line(x, np.array([-1.0, 1.0]), "accent"),), height=100, y_limits=(-1, 1))
    svg = draw([panel], "words", "x").svg()
    (curve,) = drawn_points(svg)
    assert curve.tolist() == [[0, 100], [1000, 0]]  # within the panel, from its left foot to its right top
    top = float(re.findall(r'<svg y="([\d.]+)" height="100" viewBox="0 0 1000 100"', svg)[0])
    labels = re.findall(r'<text class="tick" x="([-\d.%]+)" y="([\d.]+)"[^>]*>([^<]*)<', svg)
    down = {text: float(y) - 4 - top for x, y, text in labels if "%" not in x}
    assert (down["1"], down["−1"]) == pytest.approx((0, 100))
    across = {text: x for x, _, text in labels if "%" in x}
    assert (across["0"], across["10"]) == ("0.00%", "100.00%")


def unpacked(packed: dict) -> np.ndarray:
    """A packed series by plain loops."""
    if packed.get("even"):
        return np.array([packed["lo"] + packed["step"] * k for k in range(packed["n"])])
    flat = zlib.decompress(base64.b64decode(packed["d"]))
    whole, values = 0, []
    for low, middle, high in zip(*(flat[k * packed["n"] : (k + 1) * packed["n"]] for k in range(3)), strict=True):
        folded = low + 256 * middle + 65536 * high
        whole += -(folded + 1) // 2 if folded % 2 else folded // 2
        values.append(np.nan if whole == 0 else packed["lo"] + (whole - 1) * packed["step"])
    return np.array(values)


@pytest.mark.parametrize("seed", range(4))
def test_embedded_series_lose_less_than_a_2_to_the_18th_of_their_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(2000) * 10 ** rng.uniform(-6, 6) + rng.standard_normal()
    values[rng.random(2000) < 0.1] = np.nan
    packed = pack_series(values)
    back = unpacked(packed)
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values)) <= 0.501 * np.ptp(values[np.isfinite(values)]) / 2**BITS
    assert len(str(packed["d"])) < 4 * 2000


def test_even_times_are_only_described_and_constants_survive() -> None:
    time = np.round(np.arange(0, 30, 0.001), 6)
    assert "d" not in pack_series(time)
    assert unpacked(pack_series(time)) == pytest.approx(time, abs=1e-6)
    assert unpacked(pack_series(np.full(5, 3.25))).tolist() == [3.25] * 5
    assert np.isnan(unpacked(pack_series(np.full(4, np.nan)))).all()


def test_the_table_beside_a_figure_states_means_and_rms_of_equal_stretches() -> None:
    x = np.arange(0.0, 12.0, 0.01)
    curve, left = (
        Line(x, np.floor(x), "accent", label="level"),
        Line(x, np.where(x < 6, 3.0, -4.0), "warm", label="left", rms=True),
    )
    table = str(data_table([Panel("y (V)", (curve,)), Panel("rest", (left,))], "time (s)", "words"))
    rows = [re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", row) for row in table.split("<tr>")[2:]]
    assert len(rows) == 12
    assert [float(row[1]) for row in rows] == pytest.approx(range(12), abs=0.02)
    assert [float(row[2]) for row in rows] == pytest.approx([3.0] * 6 + [4.0] * 6, abs=0.05)


def test_the_middle_of_an_even_range_is_zero_in_a_table() -> None:
    """Seven twelfths of a range and less half of it are zero but for rounding."""
    reach = next(r for r in np.linspace(0.1, 1.0, 500) if np.linspace(-r, r, 13)[6] != 0.0)
    x = np.linspace(-reach, reach, 200)
    table = str(data_table([Panel("y", (Line(x, x, "accent", label="left"),))], "x", "words"))
    heads = re.findall(r'<th scope="row"[^>]*>([^<]*)</th>', table)
    assert len(heads) == 12
    assert heads[5].endswith("… 0")
    assert heads[6].startswith("0 …")


def test_a_panel_tells_the_script_where_its_data_are() -> None:
    x = np.linspace(0, 1, 9)
    series: dict[str, np.ndarray] = {}
    svg = draw([Panel("y", (Line(x, 2 * x, "accent", label="left"),))], "words", "x", series).svg()
    axes, line = (json.loads(unescape(text)) for text in re.findall(r'data-spec="([^"]*)"', svg))
    assert axes["x"] == [0, 1]
    assert (line["k"], line["n"]) == ("line", "left")
    np.testing.assert_array_equal([series[line["t"]], series[line["y"]]], [x, 2 * x])
