"""Figures over time: measured data, the model before and after its extension, and the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names
from aero_bayes.report.drawing import Band, Dots, Layer, Line, Panel, Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_run import RunJson
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
    return join_names([greek_name(name) for name in signals])


def curve(run: RunDirectory, group: str, recording: str, name: str) -> FloatArray | None:
    """Return a signal of a group of one recording; None if it is absent or nowhere known."""
    values = run.signals(group, recording).get(name)
    return values if values is not None and np.isfinite(values).any() else None


def left_over(run: RunDirectory, recording: str, output: str, model: str) -> FloatArray | None:
    """Compute the residual, measured minus model."""
    measured, modelled = curve(run, "measured", recording, output), curve(run, model, recording, output)
    left = None if measured is None or modelled is None else measured - modelled
    return left if left is not None and np.isfinite(left).any() else None


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
                float(np.sqrt(np.nanmean(found[within] ** 2)))
                for model in (BASE_SERIES, FINAL_SERIES)
                if (found := left_over(run, name, output, model)) is not None and np.isfinite(found[within]).any()
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


def scene_plate(run: RunDirectory, scene: Scene) -> Plate:
    """Return the first figure of the page: residuals, and below them the curves."""
    panels = scene_panels(run, scene)[::-1]
    low, high = scene.stretch
    whole = run.span(scene.recording) == scene.stretch
    where = scene.recording if whole else f"{scene.recording} from {low:.6g} to {high:.6g} s"
    unseen = "not fitted" if run.unseen(scene.recording) else "fitted"
    alt = f"{greek_name(scene.output)}, measured and modelled, and its residual; recording {where}, {unseen}."
    return plate(panels, alt, "time (s)", legend=legend(run, scene.recording), link=scene.recording)


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
    for name, values in run.signals("input", recording).items():
        factor, unit = scaled_unit(largest(values), run.result.unit(name))
        held = Line(time, factor * values, INK, 1.2, label="input", held=True)
        title = signal_title(name, unit, run.result.description(name))
        panels.append(Panel(title, (held,), 46, ticks=2))
    for name in _outputs(run, recording, without) if outputs is None else outputs:
        panels += _output_panels(run, recording, name, (80.0, 130.0))
    return panels + [_state_panel(run, recording, name) for name in run.signals("smoothed", recording)]


def _state_panel(run: RunDirectory, recording: str, name: str) -> Panel:
    """Return a state as all readings together have it, with its 90 % band."""
    time = run.time(recording)
    mean, low, high = (curve(run, group, recording, name) for group in ("smoothed", "smoothed_lower", "smoothed_upper"))
    factor, unit = scaled_unit(largest(mean), run.result.unit(name))
    layers: list[Layer] = []
    if low is not None and high is not None:
        layers.append(Band(time, factor * low, factor * high, ACCENT, 0.25, label="90 %"))
    if mean is not None:
        layers.append(Line(time, factor * mean, ACCENT, 1.3, label="smoothed"))
    title = f"state {signal_title(name, unit, run.result.description(name))}, from all readings"
    return Panel(title, tuple(layers), 100.0)


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
    measured = curve(run, "measured", recording, name)
    factor, unit = scaled_unit(largest(measured), run.result.unit(name))
    curves: list[Layer] = []
    if measured is not None:
        curves.append(Line(time, factor * measured, MEASURED, 3.2, label="measured", cloud=0.8))
    low, high = (curve(run, edge, recording, name) for edge in ("lower", "upper"))
    if low is not None and high is not None:
        curves.append(Band(time, factor * low, factor * high, ACCENT, 0.2, label="90 %"))
    left: list[tuple[str, str, float, FloatArray]] = []
    for colour, label, opacity, model in models:
        if (modelled := curve(run, model, recording, name)) is not None:
            curves.append(Line(time, factor * modelled, colour, 1.3, label=label))
        if (residual := left_over(run, recording, name, model)) is not None:
            left.append((colour, label, opacity, residual))
    if (unfitted := curve(run, "unfitted", recording, name)) is not None:
        seen = np.isfinite(unfitted)
        curves.append(Dots(time[seen], factor * unfitted[seen], INK, 4.0, 0.8, at_edge=True))
    title = signal_title(name, unit, run.result.description(name))
    panels = [Panel(title, tuple(curves), heights[0], x_limits=stretch)]
    if left:
        factor, unit = scaled_unit(largest(*(residual for *_, residual in left)), run.result.unit(name))
        floor = run.result.noise_floor(recording, name)
        levels = () if floor is None else (-2 * floor * factor, 2 * floor * factor)
        lines = tuple(
            Line(time, factor * residual, colour, 1.1, label=label, cloud=opacity, trend=True, rms=True)
            for colour, label, opacity, residual in left
        )
        words = f"residual of {greek_name(name)}: measured minus model" + (f" ({unit})" if unit else "")
        panels.append(Panel(words, lines, heights[1], levels=levels, ticks=3, x_limits=stretch))
    return panels


def stretch_words(run: RunDirectory, scene: Scene) -> str:
    """Return which data the opening picture shows."""
    unseen = run.unseen(scene.recording)
    if unseen is None:
        return f"{scene.recording}, fitted"
    if unseen == run.span(scene.recording):
        return f"{scene.recording}, not fitted"
    return f"{scene.recording} from {unseen[0]:.6g} s on, not fitted"


def role_of(result: RunJson, recording: str) -> str:
    """Return how a recording, or each part of it, was used."""
    parts = [p for p in (result.loop.parts if result.loop else ()) if p.recording == recording]
    if len(parts) < 2:
        return role_words(parts[0].role if parts else result.role(recording))
    told = [f"{role_words(p.role)} up to {p.end:.6g} s" for p in parts if p.end is not None]
    return f"{', '.join(told)}, then {role_words(parts[-1].role)}"
