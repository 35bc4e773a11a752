"""Figures over time: measured against fitted, and what happens right after the input jumps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.report.drawing import Layer, Panel, Plate, band, cloud, draw, line
from aero_bayes.report.run_directory import FloatArray, RunDirectory, mapping
from aero_bayes.report.svg import ACCENT, INK, MEASURED
from aero_bayes.report.text import describe_signal, duration, scaled_unit, signal_title

WIDE, NARROW, SMALL = 980.0, 350.0, 320.0
_SI = {"V_m": "V", "i_m": "A", "omega_m": "rad/s", "theta": "rad"}


def unit_of(run: RunDirectory, signal: str) -> str:
    """The signal's unit as the run states it, else that of the recording contract."""
    return str(mapping(run.result, "units").get(signal, _SI.get(signal, "")))


def columns_for(width: float) -> int:
    """Time columns of an envelope: about three for every four pixels."""
    return int(0.75 * width)


def named(signals: Sequence[str]) -> str:
    """Signals in words for an alternative text."""
    words = [describe_signal(name) or name for name in signals]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def largest(*arrays: FloatArray | None) -> float:
    """Greatest finite magnitude."""
    return max((float(np.nanmax(np.abs(a))) for a in arrays if a is not None and np.isfinite(a).any()), default=0.0)


def measured_against_fitted(run: RunDirectory, recording: str) -> Plate | None:
    """Inputs, then every output with its measurement, fit and predictive band, over a common time axis."""
    time, measured = run.time(recording), run.signals("measured", recording)
    fitted = run.signals("fitted", recording)
    outputs = [name for name in measured if name in fitted] or list(measured)
    if not outputs or len(time) < 2:
        return None

    def panels(width: float) -> list[Panel]:
        columns = columns_for(width)
        drawn = []
        for name, values in run.signals("input", recording).items():
            factor, unit = scaled_unit(largest(values), unit_of(run, name))
            held = line(np.repeat(time, 2)[1:], np.repeat(values, 2)[:-1] * factor, INK, columns, 1.2)
            drawn.append(Panel(signal_title(name, unit), (held,), height=46, ticks=2))
        for name in outputs:
            drawn.append(_output_panel(run, recording, name, np.ones(len(time), dtype=bool), columns, 150))
        return drawn

    alt = f"Recording {recording}: measured and fitted {named(outputs)} over {duration(float(time[-1] - time[0]))}."
    caption = Markup(
        "Grey: measured, drawn as the least and greatest value of every pixel column, so that no spike is lost. "
        "Blue: the fitted model. {}"
    ).format("Shaded: 90 % of new measurements should fall here." if run.signals("lower", recording) else "")
    return Plate(
        draw(panels(WIDE), WIDE, alt, "time (s)"), draw(panels(NARROW), NARROW, alt, "time (s)"), alt, caption,
        (("measured", "measured"), ("accent", "fitted")),
    )  # fmt: skip


def after_jumps(run: RunDirectory, recording: str, most: int = 2) -> list[Plate]:
    """Every output in the moments after the input's largest jumps."""
    time = run.time(recording)
    fitted = run.signals("fitted", recording)
    jumps = input_jumps(time, list(run.signals("input", recording).values()))
    plates = []
    for start, end in jumps[:most]:
        for name in run.signals("measured", recording):
            if name not in fitted:
                continue
            window = _response_window(time, fitted[name], start, end)
            shown = (time >= window[0]) & (time <= window[1])
            if np.count_nonzero(shown) < 8 or not np.isfinite(run.signals("measured", recording)[name][shown]).any():
                continue
            panel = _output_panel(run, recording, name, shown, columns_for(SMALL), 130, window)
            at = f"{time[start]:.6g}"
            alt = f"Measured and fitted {named([name])} in recording {recording} after the input jump at {at} s."
            plates.append(
                Plate(draw([panel], SMALL, alt, "time (s)"), None, alt, Markup("Input jump at {} s.").format(at))
            )
    return plates


def input_jumps(time: FloatArray, inputs: Sequence[FloatArray]) -> list[tuple[int, int]]:
    """Where an input jumps and where it jumps next, largest first.

    Parameters
    ----------
    time : ndarray, shape (n,)
    inputs : sequence of ndarray, shape (n,)

    Returns
    -------
    list of (int, int)
        Index of the first sample at the new value, index of the next jump (or of the last sample). An input that
        is not zero at its first sample counts as a jump from rest. Empty for an input that changes smoothly.
    """
    sizes = np.zeros(len(time))
    for values in inputs:
        span = largest(values)
        if span > 0:
            sizes = np.maximum(sizes, np.abs(np.diff(values, prepend=0.0)) / span)
    at = np.flatnonzero(sizes > 0.3)
    if len(at) == 0 or len(at) > 200:
        return []
    ends = np.append(at[1:], len(time) - 1)
    ranked = sorted(zip(at.tolist(), ends.tolist(), strict=True), key=lambda pair: -sizes[pair[0]])
    return [(start, end) for start, end in ranked if end - start >= 8]


def _response_window(time: FloatArray, response: FloatArray, start: int, end: int) -> tuple[float, float]:
    """From a little before a jump to three times the time that the response takes to come within 37 % of its end."""
    way = np.abs(response[start:end] - response[end - 1])
    settled = int(np.flatnonzero(way >= 0.37 * np.max(way))[-1]) if np.max(way) > 0 else (end - start) // 8
    span = time[min(end - 1, start + max(24, 3 * settled))] - time[start]
    return max(float(time[0]), float(time[start] - 0.1 * span)), float(time[start] + span)


def _output_panel(
    run: RunDirectory, recording: str, name: str, shown: NDArray[np.bool_], columns: int, height: float,
    limits: tuple[float, float] | None = None,
) -> Panel:  # fmt: skip
    time = run.time(recording)[shown]
    picked = {
        group: found[name][shown]
        for group in ("measured", "fitted", "lower", "upper")
        if name in (found := run.signals(group, recording))
    }
    factor, unit = scaled_unit(largest(picked["measured"]), unit_of(run, name))
    layers: list[Layer] = [*cloud(time, factor * picked["measured"], MEASURED, columns, opacity=0.8)]
    if "lower" in picked and "upper" in picked:
        layers.append(band(time, factor * picked["lower"], factor * picked["upper"], ACCENT, columns, 0.2))
    if "fitted" in picked:
        layers.append(line(time, factor * picked["fitted"], ACCENT, columns, 1.3))
    return Panel(signal_title(name, unit), tuple(layers), height=height, x_limits=limits)
