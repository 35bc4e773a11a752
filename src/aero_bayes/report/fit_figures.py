"""Small figures of a fit: autocorrelation and histogram of residuals, profiles, and where its starts ended."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.log_posterior import LikelihoodProfile
from aero_bayes.estimate.noise import autocorrelation
from aero_bayes.report.curves import FINAL_SERIES, largest, left_over
from aero_bayes.report.drawing import Band, Dots, Layer, Line, Panel, Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import ACCENT, INK, MEASURED
from aero_bayes.report.text import NO_VALUE, greek_name, rounded_value, scaled_unit, significant, symbol

#: How far up a profile is drawn; the threshold of a 90 % interval is at 1.35.
_TOP = 5.0
_MIN_SAMPLES = 16


def statistics(run: RunDirectory, recording: str) -> list[Plate]:
    """Return the residual's autocorrelation with its whiteness band, output by output, then the histograms."""
    time = run.time(recording)
    found = [(name, left_over(run, recording, name, FINAL_SERIES)) for name in run.signals("measured", recording)]
    shown = [(n, left) for n, left in found if left is not None and np.isfinite(left).sum() >= _MIN_SAMPLES]
    memory = [_autocorrelation_plate(time, values, recording, name) for name, values in shown]
    return memory + [_histogram_plate(run, values, recording, name) for name, values in shown]


def _autocorrelation_plate(time: FloatArray, values: FloatArray, recording: str, name: str) -> Plate:
    correlation = autocorrelation(values)
    step = float(np.median(np.diff(time)))
    crossing = int(np.argmax(correlation < 0)) if (correlation < 0).any() else len(values) // 8
    lags = np.arange(1, min(len(values) // 2, max(40, 4 * crossing)) + 1)
    white = 1.96 / np.sqrt(np.count_nonzero(np.isfinite(values)))
    outside = float(np.mean(np.abs(correlation[lags]) > white))
    factor, unit = (1e3, "ms") if lags[-1] * step < 2 else (1.0, "s")
    lag = np.asarray(lags * step * factor, dtype=np.float64)
    drawn = Line(lag, correlation[lags], ACCENT, label="autocorrelation")
    strip = Band(lag[[0, -1]], np.full(2, -white), np.full(2, white), INK, 0.14)
    reach = max(4 * white, 1.15 * float(np.abs(correlation[lags]).max()))
    low = -reach if reach < 0.3 else min(-0.2, float(correlation[lags].min()) - 0.05)
    title = f"{greek_name(name)}: autocorrelation"
    panel = Panel(title, (strip, drawn), 120, y_limits=(low, min(1.05, reach)))
    share = significant(100 * outside, 2)
    alt = f"Autocorrelation of the {greek_name(name)} residual, recording {recording}: {share} % of lags outside."
    caption = f"{share} % of lags lie outside the shaded band; for white noise 5 % would."
    return plate([panel], alt, f"lag ({unit})", caption, small=True)


def _histogram_plate(run: RunDirectory, values: FloatArray, recording: str, name: str) -> Plate:
    finite = values[np.isfinite(values)]
    floor = run.result.noise_floor(recording, name)
    factor, unit = scaled_unit(largest(values), run.result.unit(name))
    reach = max(float(np.quantile(np.abs(finite), 0.995)), 3.5 * (floor or 0.0)) or 1.0
    density, edges = np.histogram(finite, bins=61, range=(-reach, reach), density=True)
    steps = factor * np.repeat(edges, 2)[1:-1]
    layers: list[Line | Band] = [
        Band(steps, np.zeros(2 * len(density)), np.repeat(density, 2), ACCENT, 0.45, label="histogram")
    ]
    if floor:
        grid = np.linspace(-reach, reach, 301)
        normal = np.exp(-0.5 * (grid / floor) ** 2) / (floor * np.sqrt(2.0 * np.pi))
        layers.append(Line(factor * grid, normal, INK, 1.3, label="noise alone"))
    top = max(float(np.max(layer.high if isinstance(layer, Band) else layer.y)) for layer in layers)
    panel = Panel(f"{greek_name(name)}: histogram", tuple(layers), 120, (0, 1.08 * top), ticks=0)
    alt = f"Histogram of the {greek_name(name)} residual, recording {recording}, and the density of the noise."
    words = f"RMS {significant(factor * float(np.sqrt(np.mean(finite**2))))} {unit}."
    if floor:
        words += f" Line: noise alone, {significant(factor * floor)} {unit}, over the same area."
    return plate([panel], alt, f"residual ({unit})" if unit else "residual", words, small=True)


def profile_plates(run: RunDirectory) -> list[Plate]:
    """Return a small figure for every profile of the run."""
    found = run.result.identifiability
    plates = [_plate(name, entry, found.profile_drop_90) for name, entry in found.profiles.items()]
    return [drawn for drawn in plates if drawn is not None]


def _plate(name: str, entry: LikelihoodProfile, level: float | None) -> Plate | None:
    values, drop, prior = entry.values, entry.drop, entry.prior_drop
    if len(values) != len(drop) or np.isfinite(drop).sum() < 3:
        return None
    near = np.flatnonzero(np.nan_to_num(drop, nan=np.inf) < _TOP)
    view = slice(max(int(near.min()) - 1, 0), int(near.max()) + 2)
    values, drop, prior = values[view], drop[view], prior[view]
    low, high = float(values.min()), float(values.max())
    shown = rounded_value(float(values[int(np.nanargmin(drop))]), low, high, entry.unit, digits=2)
    power = _power(values)
    fine = np.isfinite(drop)
    layers: list[Layer] = []
    if len(prior) == len(values):
        layers.append(Line(values / power, prior, MEASURED, 1.4, label="prior alone"))
    layers += [
        Line(values[fine] / power, drop[fine], ACCENT, 1.6, label="decrease of the log-posterior"),
        Dots(values[fine] / power, drop[fine], INK, 3.0, 0.8),
    ]
    title = f"{greek_name(name)} ({shown.unit})" if shown.unit else greek_name(name)
    panel = Panel(
        title, tuple(layers), 110, y_limits=(-0.15, _TOP), x_limits=(low / power, high / power),
        levels=() if level is None else (level,), ticks=3,
    )  # fmt: skip
    words = _interval_words(entry)
    alt = f"Profile of {name}: {words}."
    return plate([panel], alt, "fixed value", Markup("{}: {}.").format(symbol(name), words), small=True)


def _interval_words(entry: LikelihoodProfile) -> str:
    """Return the interval at the threshold; a side on which the profile stays below it has no end."""
    first, last = [*entry.interval, None, None][:2]
    unit = entry.unit
    if first is None and last is None:
        return "flat over the whole range, no 90 % interval"
    shown = rounded_value(first if first is not None else last, first, last, unit, digits=3)
    if first is None or last is None:
        side, end = ("above", shown.value) if last is None else ("below", shown.value)
        return f"90 % {side} {end} {shown.unit}, open on the other side".replace("  ", " ")
    return f"90 % between {shown.low} and {shown.high} {shown.unit}".rstrip() if shown.low != NO_VALUE else ""


def waterfall_plates(levels: Sequence[float | None]) -> list[Plate]:
    """Draw how far below the best the local fits from several starts ended; nothing for one start."""
    known = np.sort(np.array([level for level in levels if level is not None], dtype=np.float64))[::-1]
    if len(known) < 2:
        return []
    below = known[0] - known
    log = bool(below[-1] > 10.0)
    shown = np.maximum(below, 0.1) if log else below
    rank = np.arange(1.0, len(below) + 1)
    layers = (Line(rank, shown, ACCENT, label="below the best"), Dots(rank, shown, ACCENT, 6.0, 1.0))
    alt = f"Log-posterior below the best at which local fits from {len(below)} starts ended, the best first."
    caption = "A level stretch at the left: several starts ended at the same, best answer."
    panel = Panel("log-posterior below the best", layers, 120, log_y=log)
    return [plate([panel], alt, "start, the best first", caption, small=True)]


def _power(values: FloatArray) -> float:
    largest = float(np.max(np.abs(values)))
    return 1.0 if largest == 0 or 1e-3 <= largest < 1e5 else 10.0 ** (3 * np.floor(np.log10(largest) / 3))
