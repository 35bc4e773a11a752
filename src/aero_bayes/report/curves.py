"""Figures over time: measured data, the model before and after its extension, and the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.report.drawing import Band, Dots, Layer, Line, Panel, Plate, Source, Terms, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import ACCENT, INK, MEASURED, WARM_COLOUR
from aero_bayes.report.text import greek_name, role_words, scaled_unit, signal_title

#: The model as it stood, and the one that came out.
BASE_SERIES, FINAL_SERIES = "before", "fitted"


@dataclass(frozen=True)
class Scene:
    """The picture that a page opens with: one output of one recording, over one stretch."""

    recording: str
    output: str
    stretch: tuple[float, float]


def largest(*arrays: FloatArray | None) -> float:
    """Compute the greatest finite magnitude."""
    return max((float(np.nanmax(np.abs(a))) for a in arrays if a is not None and np.isfinite(a).any()), default=0.0)


def named(signals: Sequence[str]) -> str:
    """Name signals in words for an alternative text."""
    words = [greek_name(name) for name in signals]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def summed(run: RunDirectory, recording: str, *terms: tuple[int, str]) -> tuple[FloatArray, Source] | None:
    """Return a sum of series of one recording (sign, ``group/signal``), and where the script finds it.

    None if one is absent."""
    full: Terms = tuple((sign, f"{group}/{recording}/{name}") for sign, key in terms
                        for group, _, name in [key.partition("/")])  # fmt: skip
    if any(key not in run.series for _, key in full):
        return None
    for _, key in full:
        run.check(key, recording)
    values = np.sum([sign * run.series[key] for sign, key in full], axis=0)
    return (values, Source(f"time/{recording}", full)) if np.isfinite(values).any() else None


def left_over(run: RunDirectory, recording: str, output: str, model: str) -> tuple[FloatArray, Source] | None:
    """Compute the residual, measured minus model."""
    return summed(run, recording, (1, f"measured/{output}"), (-1, f"{model}/{output}"))


def _before(run: RunDirectory, recording: str) -> dict[str, FloatArray]:
    """Return the outputs of the model as it stood; none where nothing was added to it."""
    added = run.result.loop is None or bool(run.result.loop.effects)
    return run.signals(BASE_SERIES, recording) if added else {}


def opening_scene(run: RunDirectory) -> Scene | None:
    """Return the output with the largest residual before or after, on unseen data if there are any."""
    unseen = [(name, stretch) for name in run.recordings() if (stretch := run.unseen(name)) is not None]
    stretches = unseen or [(name, run.span(name)) for name in run.recordings()]
    best: tuple[float, Scene] | None = None
    for name, stretch in stretches:
        within = (run.time(name) >= stretch[0]) & (run.time(name) <= stretch[1])
        for output in run.signals("measured", name):
            sizes = [
                float(np.sqrt(np.nanmean(found[0][within] ** 2)))
                for model in (BASE_SERIES, FINAL_SERIES)
                if (found := left_over(run, name, output, model)) and np.isfinite(found[0][within]).any()
            ]
            if sizes:
                floor = run.result.noise_floor(name, output) or min(sizes) or 1.0
                weight = max(sizes) / floor
                if best is None or weight > best[0]:
                    best = weight, Scene(name, output, stretch)
    return best[1] if best else None


def scene_panels(run: RunDirectory, scene: Scene) -> list[Panel]:
    """Draw panels of the curves (small, since they overlap) and of the residuals (large)."""
    return _output_panels(run, scene.recording, scene.output, (85.0, 210.0), scene.stretch)


def scene_plate(run: RunDirectory, scene: Scene, width: float) -> Plate:
    """Return the first figure of the page: residuals, and below them the curves."""
    panels = scene_panels(run, scene)[::-1]
    low, high = scene.stretch
    whole = run.span(scene.recording) == scene.stretch
    where = scene.recording if whole else f"{scene.recording} from {low:.6g} to {high:.6g} s"
    unseen = "not fitted" if run.unseen(scene.recording) else "fitted"
    alt = f"{greek_name(scene.output)}, measured and modelled, and its residual; recording {where}, {unseen}."
    return plate(panels, alt, "time (s)", legend=legend(run, scene.recording), link=scene.recording, width=width)


def recording_plate(run: RunDirectory, recording: str, without: str = "") -> Plate | None:
    """Draw the inputs, then every output (except one that is shown elsewhere) with its residual, over one time axis."""
    outputs = _outputs(run, recording, without)
    if not (outputs or run.signals("smoothed", recording)) or len(run.time(recording)) < 2:
        return None
    compared = f", {named(outputs)} measured and modelled, and their residuals" if outputs else " and states"
    alt = f"Recording {recording}: inputs{compared}."
    panels = recording_panels(run, recording, without)
    return plate(panels, alt, "time (s)", legend=legend(run, recording), link=recording)


def _outputs(run: RunDirectory, recording: str, without: str) -> list[str]:
    return [o for o, y in run.signals("measured", recording).items() if o != without and np.isfinite(y).any()]


def recording_panels(
    run: RunDirectory, recording: str, without: str = "", outputs: Sequence[str] | None = None
) -> list[Panel]:
    """Draw the inputs, then every recorded output (except one that is shown elsewhere) with its residual."""
    time, panels = run.time(recording), []
    for name in run.signals("input", recording):
        values, source = summed(run, recording, (1, f"input/{name}")) or (np.zeros(0), None)
        factor, unit = scaled_unit(largest(values), run.result.unit(name))
        held = Line(time, factor * values, INK, 1.2, label="input", source=source, held=True)
        title = signal_title(name, unit, run.result.description(name))
        panels.append(Panel(title, (held,), 46, ticks=2, factor=factor))
    for name in _outputs(run, recording, without) if outputs is None else outputs:
        panels += _output_panels(run, recording, name, (80.0, 130.0))
    return panels + [_state_panel(run, recording, name) for name in run.signals("smoothed", recording)]


def _state_panel(run: RunDirectory, recording: str, name: str) -> Panel:
    """Return a state as all readings together have it, with its 90 % band."""
    time = run.time(recording)
    mean, low, high = (
        summed(run, recording, (1, f"{group}/{name}")) for group in ("smoothed", "smoothed_lower", "smoothed_upper")
    )
    factor, unit = scaled_unit(largest(mean[0] if mean else None), run.result.unit(name))
    layers: list[Layer] = []
    if low and high:
        source = Source(low[1].time, low[1].terms, high[1].terms)
        layers.append(Band(time, factor * low[0], factor * high[0], ACCENT, 0.25, label="90 %", source=source))
    if mean:
        layers.append(Line(time, factor * mean[0], ACCENT, 1.3, label="smoothed", source=mean[1]))
    title = f"state {signal_title(name, unit, run.result.description(name))}, from all readings"
    return Panel(title, tuple(layers), 100.0, factor=factor)


def legend(run: RunDirectory, recording: str) -> tuple[tuple[str, str], ...]:
    """Return the legend of a recording's curves: colours and labels."""
    fitted, base = run.signals(FINAL_SERIES, recording), _before(run, recording)
    entries = [
        (MEASURED, "measured", True),
        (WARM_COLOUR, "before", bool(base)),
        (ACCENT, "after" if base else "fitted", bool(fitted)),
        (INK, "dots: not fitted; at the edge where beyond it", bool(run.signals("unfitted", recording))),
        (ACCENT, "shaded: 90 % prediction interval of a reading", bool(run.signals("lower", recording))),
    ]
    return tuple((colour, label) for colour, label, there in entries if there)


def _output_panels(
    run: RunDirectory, recording: str, name: str, heights: tuple[float, float],
    stretch: tuple[float, float] | None = None,
) -> list[Panel]:  # fmt: skip
    """Draw panels of the curve and of its residual."""
    time = run.time(recording)
    models = [(WARM_COLOUR, "before", 0.25, BASE_SERIES), (ACCENT, "after", 0.5, FINAL_SERIES)]
    if name not in _before(run, recording):
        models = [(ACCENT, "fitted", 0.5, FINAL_SERIES)]
    shown = [(MEASURED, "measured", summed(run, recording, (1, f"measured/{name}")))]
    shown += [(colour, label, summed(run, recording, (1, f"{key}/{name}"))) for colour, label, _, key in models]
    factor, unit = scaled_unit(largest(*(found[0] for *_, found in shown[:1] if found)), run.result.unit(name))
    curves: list[Layer] = [
        Line(time, factor * found[0], colour, 3.2 if label == "measured" else 1.3, label=label, source=found[1],
             cloud=0.8 if label == "measured" else 0.0)
        for colour, label, found in shown if found
    ]  # fmt: skip
    if unfitted := summed(run, recording, (1, f"unfitted/{name}")):
        seen = np.isfinite(unfitted[0])
        curves.append(Dots(time[seen], factor * unfitted[0][seen], INK, 4.0, 0.8, unfitted[1]))
    low, high = (summed(run, recording, (1, f"{edge}/{name}")) for edge in ("lower", "upper"))
    if low and high:
        source = Source(low[1].time, low[1].terms, high[1].terms)
        curves.insert(1, Band(time, factor * low[0], factor * high[0], ACCENT, 0.2, label="90 %", source=source))
    title = signal_title(name, unit, run.result.description(name))
    panels = [Panel(title, tuple(curves), heights[0], x_limits=stretch, factor=factor)]
    left = [(colour, label, opacity, left_over(run, recording, name, key)) for colour, label, opacity, key in models]
    found = [(colour, label, opacity, pair) for colour, label, opacity, pair in left if pair]
    if found:
        factor, unit = scaled_unit(largest(*(pair[0] for *_, pair in found)), run.result.unit(name))
        floor = run.result.noise_floor(recording, name)
        levels = () if floor is None else (-2 * floor * factor, 2 * floor * factor)
        lines = tuple(
            Line(time, factor * pair[0], colour, 1.1, label=label, source=pair[1], cloud=opacity, trend=True, rms=True)
            for colour, label, opacity, pair in found
        )
        words = f"residual of {greek_name(name)}: measured minus model" + (f" ({unit})" if unit else "")
        panels.append(Panel(words, lines, heights[1], levels=levels, ticks=3, x_limits=stretch, factor=factor))
    return panels


def stretch_words(run: RunDirectory, scene: Scene) -> str:
    """Return which data the opening picture shows."""
    unseen = run.unseen(scene.recording)
    if unseen is None:
        return f"{scene.recording}, fitted"
    if unseen == run.span(scene.recording):
        return f"{scene.recording}, not fitted"
    return f"{scene.recording} from {unseen[0]:.6g} s on, not fitted"


def role_of(run: RunDirectory, recording: str) -> str:
    """Return how a recording was used, for its heading."""
    unseen = run.unseen(recording)
    if unseen is not None and unseen != run.span(recording):
        return f"fitted up to {unseen[0]:.6g} s"
    return role_words(run.result.role(recording))
