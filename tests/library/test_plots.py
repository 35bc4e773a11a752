"""Figures show the numbers of what they are drawn from, in colours that everybody tells apart."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from facts import facts
from scipy.ndimage import map_coordinates

import aero_bayes
from aero_bayes.figures import Picture
from aero_bayes.report.drawing import Band, Line
from aero_bayes.report.pairs import regions, span
from aero_bayes.report.plots import palette

pytestmark = pytest.mark.fast

#: Colour-blind vision (Machado, Oliveira & Fernandes, 2009, IEEE TVCG 15, 1291), full severity, on linear sRGB.
VISION = {
    "normal": np.eye(3),
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]


def linear(colour: str) -> np.ndarray:
    part = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of linear sRGB."""
    xyz = np.array(XYZ) @ np.clip(rgb, 0, 1) / [0.95047, 1.0, 1.08883]
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(first: str, second: str) -> float:
    """As WCAG 2.2 defines it."""
    bright, dim = sorted((linear(c) @ [0.2126, 0.7152, 0.0722] for c in (first, second)), reverse=True)
    return (bright + 0.05) / (dim + 0.05)


def curves(picture: Picture, panel: int) -> list[np.ndarray]:
    return [layer.y for layer in picture.panels[panel].layers if isinstance(layer, Line)]


def words(picture: Picture) -> str:
    return " ".join(ElementTree.fromstring(picture.svg).itertext())


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("group", [("measured", "accent", "warm"), tuple(f"s{k}" for k in range(1, 7))])
@pytest.mark.parametrize("vision", VISION)
def test_curves_are_told_apart_by_everybody(vision: str, group: tuple[str, ...], dark: bool):
    """Colours of one figure differ by ten just noticeable steps, and from the ground by 3:1 (WCAG 1.4.11)."""
    colours = palette(dark)
    seen = [lab(np.array(VISION[vision]) @ linear(colours[name])) for name in group]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 10.0
    assert min(contrast(colours[name], colours["ground"]) for name in group) >= 3.0


def test_a_recording_is_drawn_as_it_was_read(cart: SimpleNamespace):
    force, position = (curves(cart.recording.plot(), panel)[0] for panel in (0, 1))
    assert np.array_equal(force, cart.recording.inputs["F"])
    assert np.array_equal(position, cart.recording.outputs["position"])


def test_a_fit_is_drawn_over_its_recording_with_what_it_leaves(cart: SimpleNamespace):
    picture = cart.fit.plot()
    measured, fitted = curves(picture, 1)
    (left,) = curves(picture, 2)
    assert np.array_equal(measured, cart.recording.outputs["position"])
    assert np.array_equal(fitted, cart.fit.fitted[0][:, 0])
    assert left == pytest.approx(1e3 * cart.fit.residuals[0][:, 0], abs=1e-9)  # drawn in mm
    floor = cart.recording.summary().outputs[0].noise.sd
    assert picture.panels[2].levels == pytest.approx([-2e3 * floor, 2e3 * floor])
    for panel, unit in zip(picture.panels, ("(N)", "(m)", "(mm)"), strict=True):
        assert panel.title.endswith(unit)
        assert panel.title in words(picture)
    assert "time (s)" in words(picture)


def test_a_picture_is_a_file_with_the_colours_of_the_page(cart: SimpleNamespace, tmp_path: Path):
    """It needs no style sheet but its own: all colours are numbers."""
    for dark in (False, True):
        picture = cart.fit.plot(dark=dark)
        colours = re.findall(r"fill:none;stroke:(#[0-9a-f]{6});stroke-width:[13]\.[23]", picture.svg)
        assert colours == [palette(dark)[name] for name in ("ink", "measured", "accent")]
        assert f'fill="{palette(dark)["ground"]}"' in picture.svg
        assert "var(" not in picture.svg
    assert picture.save(tmp_path / "new" / "fit.svg").read_text("utf-8") == picture._repr_svg_()
    with pytest.raises(aero_bayes.InputError, match=facts("fit.png", "SVG")):
        picture.save(tmp_path / "fit.png")


@pytest.mark.slow
def test_the_pair_plot_holds_the_shares_that_it_says(posterior: aero_bayes.Posterior):
    """Half of the draws lie within the dark region, nine tenths within the light one."""
    across, up = posterior.samples("k"), posterior.samples("d")
    density, levels = regions(across, up)
    at = [0.5 + 44 * (x - span(x)[0]) / np.ptp(span(x)) for x in (up, across)]
    held = [np.mean(map_coordinates(density, at, order=1) >= level) for level in levels]
    assert held == pytest.approx([0.9, 0.5], abs=0.05)
    assert all(name in words(posterior.plot(["k", "d"])) for name in ("k", "d", "N/m", "N·s/m"))
    assert "N/m" in words(posterior.plot(["k"]))
    with pytest.raises(aero_bayes.InputError, match="no draws of stiffness"):
        posterior.plot(["stiffness"])


@pytest.mark.slow
def test_the_band_is_drawn_about_the_curve(posterior: aero_bayes.Posterior):
    (band,) = (layer for layer in posterior.plot_bands().panels[1].layers if isinstance(layer, Band))
    part = posterior.predictive[0]
    assert band.low == pytest.approx(part.lower[:, 0])
    assert band.high == pytest.approx(part.upper[:, 0])


@pytest.mark.slow
def test_the_figures_of_a_loop_and_of_its_files_show_both_models_and_the_choice(
    loop: aero_bayes.LoopResult, run: aero_bayes.RunDirectory, cart: SimpleNamespace
):
    predicted = [found.fitted["test", "position"] for found in (loop.predicted_before, loop.predicted_after)]
    written = [run.series[f"{group}/test/position"] for group in ("measured", "before", "fitted")]
    for picture, shown in ((loop.plot(), [cart.test.outputs["position"], *predicted]), (run.plot(), written)):
        factor = 1e3 if picture.panels[0].title.endswith("(mm)") else 1.0
        for mine, values in zip(curves(picture, 0), shown, strict=True):
            assert mine == pytest.approx(factor * values)
    with pytest.raises(aero_bayes.InputError, match=facts("nowhere", "train", "test")):
        run.plot("nowhere")
    rounds = words(loop.plot_rounds())
    best = max(100.0 * (1.0 - rival.share) for rival in loop.steps[0].candidates)
    for part in (f"{best:.0f} ±", "coulomb_friction@v chosen", loop.words["coulomb_friction@v"]):
        assert part in rounds


@pytest.mark.slow
def test_everything_shows_itself_in_a_line_and_a_table(
    cart: SimpleNamespace, posterior: aero_bayes.Posterior, loop: aero_bayes.LoopResult, run: aero_bayes.RunDirectory
):
    forecast = posterior.predict(cart.test, draws=20)
    summary = cart.recording.summary()
    settings = aero_bayes.FitSettings(method="local"), aero_bayes.LoopSettings(), aero_bayes.SampleSettings()
    for thing in (cart.model, cart.recording, cart.fit, posterior, loop, run, forecast, summary, *settings):
        assert len(repr(thing)) < 240, repr(thing)
        assert "\n" not in repr(thing)
        table = thing._repr_html_()
        assert re.match("<table><caption>.*<th", table, flags=re.S)
        assert table.count("<td>") == table.count("</td>") > 1
    assert repr(settings[0]) == "FitSettings(method='local')"
