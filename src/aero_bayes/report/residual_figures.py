"""Figures of what the fit leaves: over time, against itself, and against the noise floor."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from aero_bayes.report.drawing import Band, Line, Panel, Plate, cloud, draw, line
from aero_bayes.report.run_directory import FloatArray, RunDirectory, mapping, number, table
from aero_bayes.report.series_figures import NARROW, SMALL, WIDE, columns_for, largest, named, unit_of
from aero_bayes.report.svg import ACCENT, INK, WARM
from aero_bayes.report.text import scaled_unit, signal_title, significant


def residuals(run: RunDirectory, recording: str, model: str = "fitted") -> dict[str, FloatArray]:
    """Measured minus modelled, by output, each of shape (n,); ``model`` is fitted, before or after.

    Ripple that the fit took out of the readings is no part of what the fit left.
    """
    modelled = run.signals(model, recording)
    measured = run.signals("measured", recording)
    ripple = run.signals("ripple", recording) if model == "fitted" else {}
    return {
        name: values - ripple.get(name, 0.0) - modelled[name] for name, values in measured.items() if name in modelled
    }


def noise_floor(run: RunDirectory, recording: str, output: str) -> float | None:
    """Standard deviation of the measurement noise as estimated from the data, if the run states it."""
    stated = number(mapping(run.result, "residual", recording, output).get("noise_floor"))
    if stated is not None:
        return stated
    rows = [row for row in table(run.result, "recordings") if row.get("name") == recording]
    return number(mapping(rows[0], "noise_floor").get(output)) if rows else None


def over_time(run: RunDirectory, recording: str, model: str = "fitted") -> Plate | None:
    """Residuals of every output over time, with twice the noise floor as dashed lines."""
    found = {name: values for name, values in residuals(run, recording, model).items() if np.isfinite(values).any()}
    time = run.time(recording)
    if not found or len(time) < 2:
        return None
    colour = WARM if model == "before" else ACCENT

    def panels(width: float) -> list[Panel]:
        drawn = []
        for name, values in found.items():
            factor, unit = scaled_unit(largest(values), unit_of(run, name))
            floor = noise_floor(run, recording, name)
            levels = () if floor is None else (-2 * floor * factor, 2 * floor * factor)
            layers = cloud(time, values * factor, colour, columns_for(width), trend=True)
            drawn.append(Panel(signal_title(name, unit), layers, height=96, levels=levels, ticks=3))
        return drawn

    alt = f"Recording {recording}: residual ({model} model) of {named(list(found))} over time."
    caption = Markup(
        "Measured minus model. Dashed: twice the noise floor; noise alone leaves 95 % of samples between. "
        "Shaded: from the least to the greatest value of every pixel column; line: running mean."
    )
    return Plate(draw(panels(WIDE), WIDE, alt, "time (s)"), draw(panels(NARROW), NARROW, alt, "time (s)"), alt, caption)


def autocorrelation(values: FloatArray) -> FloatArray:
    """Autocorrelation at lags 0, 1, ... n-1; gaps (NaN) do not count.

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        Normalised to 1 at lag 0; the estimate divides by the number of pairs at lag 0 (biased, never above 1).
    """
    centred = np.where(np.isfinite(values), values - np.nanmean(values), 0.0)
    size = 1 << (2 * len(values) - 1).bit_length()
    power = np.abs(np.fft.rfft(centred, size)) ** 2
    products = np.fft.irfft(power, size)[: len(values)]
    return np.asarray(products / products[0], dtype=np.float64) if products[0] > 0 else np.zeros_like(products)


def statistics(run: RunDirectory, recording: str, model: str = "fitted") -> list[Plate]:
    """The residual's autocorrelation with its whiteness band, output by output, then the histograms."""
    time = run.time(recording)
    found = residuals(run, recording, model).items()
    shown = [(name, values) for name, values in found if np.count_nonzero(np.isfinite(values)) >= 16]
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
    drawn = line(lag, correlation[lags], ACCENT, columns_for(SMALL))
    strip = Band(lag[[0, -1]], np.full(2, -white), np.full(2, white), INK, 0.14)
    reach = max(4 * white, 1.15 * float(np.abs(correlation[lags]).max()))
    low = -reach if reach < 0.3 else min(-0.2, float(correlation[lags].min()) - 0.05)
    panel = Panel(f"{signal_title(name, '')}: autocorrelation", (strip, drawn), 120, y_limits=(low, min(1.05, reach)))
    share = significant(100 * outside, 2)
    alt = f"Autocorrelation of the {named([name])} residual, recording {recording}: {share} % of lags outside the band."
    caption = Markup("{} % of lags lie outside the shaded band; white noise would put 5 % there.").format(share)
    return Plate(draw([panel], SMALL, alt, f"lag ({unit})"), None, alt, caption)


def _histogram_plate(run: RunDirectory, values: FloatArray, recording: str, name: str) -> Plate:
    finite = values[np.isfinite(values)]
    floor = noise_floor(run, recording, name)
    factor, unit = scaled_unit(largest(values), unit_of(run, name))
    reach = max(float(np.quantile(np.abs(finite), 0.995)), 3.5 * (floor or 0.0)) or 1.0
    density, edges = np.histogram(finite, bins=61, range=(-reach, reach), density=True)
    density = density / max(density.max(), 1e-300)
    layers: list[Line | Band] = [
        Band(factor * np.repeat(edges, 2)[1:-1], np.zeros(2 * len(density)), np.repeat(density, 2), ACCENT, 0.45)
    ]
    if floor:
        grid = np.linspace(-reach, reach, 301)
        layers.append(Line(factor * grid, np.exp(-0.5 * (grid / floor) ** 2), INK, 1.3))
    panel = Panel(f"{signal_title(name, '')}: how often", tuple(layers), 120, (0, 1.08), ticks=0)
    alt = f"Histogram of the residual of {named([name])}, recording {recording}, against the noise floor's bell curve."
    rms = float(np.sqrt(np.mean(finite**2)))
    words = f"RMS {significant(factor * rms)} {unit}."
    if floor:
        words += f" Line: the noise floor alone, {significant(factor * floor)} {unit}; peaks drawn at one height."
    return Plate(
        draw([panel], SMALL, alt, f"residual ({unit})" if unit else "residual"), None, alt, Markup.escape(words)
    )
