"""Figures of the residuals: autocorrelation, and histogram against the noise floor."""

from __future__ import annotations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.noise import autocorrelation
from aero_bayes.report.curves import FINAL_SERIES, largest, left_over
from aero_bayes.report.drawing import SMALL_WIDTH, Band, Line, Panel, Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import ACCENT, INK
from aero_bayes.report.text import greek_name, scaled_unit, significant

_MIN_SAMPLES = 16


def statistics(run: RunDirectory, recording: str) -> list[Plate]:
    """Return the residual's autocorrelation with its whiteness band, output by output, then the histograms."""
    time = run.time(recording)
    found = [(name, left_over(run, recording, name, FINAL_SERIES)) for name in run.signals("measured", recording)]
    shown = [(n, pair[0]) for n, pair in found if pair and np.count_nonzero(np.isfinite(pair[0])) >= _MIN_SAMPLES]
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
    return plate([panel], alt, f"lag ({unit})", caption, width=SMALL_WIDTH)


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
    return plate([panel], alt, f"residual ({unit})" if unit else "residual", words, width=SMALL_WIDTH)
