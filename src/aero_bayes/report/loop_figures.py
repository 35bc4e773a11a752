"""Figures of the closed loop: its rounds, and the curves that it learned."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from aero_bayes.report.curves import largest
from aero_bayes.report.drawing import NARROW_WIDTH, WIDE_WIDTH, Band, Line, Panel, Plate, plate, tick_text
from aero_bayes.report.schema_loop import CandidateJson, EffectJson, LoopJson, StepJson
from aero_bayes.report.svg import ACCENT, INK, MUTED, RULE, WARM_COLOUR, Canvas
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import NO_VALUE, greek_name, minus, scaled_unit
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

PORT = 430.0
_ROW, _TOP = 19.0, 46.0
_MOST_ROWS = 24
#: Falls of the error that are marked on the axis, in %.
TICKS = (0, 25, 50, 75, 100)
#: Width of a letter beside a bar, and letters of a candidate's label.
LETTER, LABEL_LETTERS = 6.3, 52


def rounds(loop: LoopJson) -> tuple[list[StepJson], list[str], list[str]]:
    """Return rounds that tried anything, all candidates (those taken first, then by gain), and those to be drawn."""
    steps = [step for step in loop.steps if any(c.share is not None for c in step.candidates)]
    best: dict[str, float] = {}
    for step in steps:
        for c in step.candidates:
            best[c.id] = max(best.get(c.id, -math.inf), fall(c))
    taken = [step.chosen for step in steps if step.chosen in best]
    rest = sorted((id_ for id_ in best if id_ not in taken), key=lambda id_: -best[id_])
    ids = [*dict.fromkeys(taken), *rest]
    return steps, ids, [id_ for id_ in ids if best[id_] > 0 or id_ in taken][:_MOST_ROWS] or ids[:1]


def rounds_plate(loop: LoopJson, words: Mapping[str, str]) -> Plate | None:
    """Draw a row for each candidate, a column for each round, bars of how far the error falls."""
    steps, ids, shown = rounds(loop)
    if not steps:
        return None
    alt = f"Fall of the error on left-out readings for {len(ids)} candidates over {len(steps)} steps. " + " ".join(
        f"Step {step.round}: {step.chosen or 'none'} chosen." for step in steps
    )
    left_out = len(ids) - len(shown)
    rest = f" {left_out} candidates that do not lower the error are not shown." if left_out else ""
    caption = Markup(
        "The output where the error falls most, all parameters fitted again. Orange: chosen. Outlined: the data cannot "
        "tell it from the chosen one.{}"
    ).format(rest)
    wide, narrow = (_rounds_drawing(steps, shown, words, width, alt) for width in (WIDE_WIDTH, NARROW_WIDTH))
    return Plate(wide, narrow, alt, caption, (), _rounds_table(steps, ids, words))


def _rounds_drawing(steps: list[StepJson], ids: list[str], words: Mapping[str, str], width: float, alt: str) -> Markup:
    wide = width > 600
    ports = {c.id: c.port for step in steps for c in step.candidates}
    label = 350.0 if wide else 0.0
    row = _ROW if wide else 2 * _ROW
    canvas = Canvas(width, _TOP + row * len(ids) + 24, alt)
    column = (width - label - 10) / len(steps)
    found = [c for step in steps for c in step.candidates]
    beside = 8 + LETTER * max(len(fall_text(c)) for c in found)

    def across(percent: float) -> float:
        return (column - beside) * min(max(percent, 0.0), 100.0) / 100.0

    for index, id_ in enumerate(ids):
        y = _TOP + row * index
        canvas.curve([0, width], [y + row - 2, y + row - 2], RULE, 0.6)
        fits = LABEL_LETTERS - (len(ports.get(id_, "")) if wide else 0)
        canvas.text(0, y + 13, short_label(id_, words, fits), INK, 11.5)
        if wide:
            canvas.text(label - 12, y + 13, ports.get(id_, ""), MUTED, 10.5, "end")
    for k, step in enumerate(steps):
        left = label + 4 + column * k
        canvas.text(left, 14, f"Step {step.round}", INK, 12)
        for percent in TICKS[:: 1 if column > 200.0 else 2]:
            canvas.text(left + across(percent), _TOP - 10, tick_text(percent), MUTED, 10, "middle")
        by_id = {c.id: c for c in step.candidates}
        for index, id_ in enumerate(ids):
            if id_ in by_id:
                y = _TOP + row * index + (0 if wide else _ROW - 3)
                length = max(across(fall(by_id[id_])), 1.5)
                _bar(canvas, by_id[id_], step, (left, y, length), fall_text(by_id[id_]))
    return canvas.svg()


def short_label(id_: str, words: Mapping[str, str], letters: int = LABEL_LETTERS) -> str:
    """Return what a candidate is, by its words or else its id, cut to a number of letters."""
    text = words.get(id_) or id_
    return text if len(text) <= letters else f"{text[: letters - 1]}…"


def _bar(canvas: Canvas, found: CandidateJson, step: StepJson, place: tuple[float, float, float], text: str) -> None:
    """Draw a candidate's fall of the error as a bar (left, top, length), with its text where it falls at all."""
    left, y, length = place
    chosen = found.id == step.chosen
    colour, opacity = (WARM_COLOUR, 1.0) if chosen else (ACCENT, 0.45)
    alike = "" if found.id not in step.equivalent or chosen else f";stroke:var(--{WARM_COLOUR});stroke-width:1.6"
    outline = f"M{left:.1f} {y + 4:.1f}h{length:.1f}v10h-{length:.1f}Z"
    canvas.shape(outline, f"fill:var(--{colour});fill-opacity:{opacity}{alike}")
    if fall(found) >= 1.0 or chosen:
        canvas.text(left + length + 4, y + 13, text, INK if chosen else MUTED, 10.5)


def _rounds_table(steps: list[StepJson], ids: list[str], words: Mapping[str, str]) -> Markup:
    cells = [{c.id: c for c in step.candidates} for step in steps]
    rows = []
    for id_ in ids:
        name = Markup("<code>{}</code><small>{}</small>").format(id_, words.get(id_, ""))
        port = next((by_id[id_].port for by_id in cells if id_ in by_id), NO_VALUE)
        rows.append(
            (name, port, *(_candidate_cell(by_id.get(id_), step) for by_id, step in zip(cells, steps, strict=True)))
        )
    heads = [Column(f"step {step.round}", "right") for step in steps]
    return html_table(
        ("candidate", "port", *heads), rows, "Candidates: fall of the error on left-out readings in each step"
    )


def _candidate_cell(found: CandidateJson | None, step: StepJson) -> Markup:
    if found is None:
        return Markup(NO_VALUE)
    notes = [
        "chosen" if found.id == step.chosen else "equivalent" if found.id in step.equivalent else "",
        "" if found.refitted else "by one Newton step",
    ]
    return Markup("{}<small>{}</small>").format(fall_text(found), "; ".join(filter(None, notes)))


def fall(found: CandidateJson | EffectJson) -> float:
    """Return by how much the error on left-out readings falls, in %; minus infinity where that is not known."""
    return -math.inf if found.share is None else 100.0 * (1.0 - found.share)


def fall_text(found: CandidateJson | EffectJson) -> str:
    """Return the same in words, with its standard error."""
    if found.share is None:
        return NO_VALUE
    spread = "" if found.share_sd is None else f" ± {100.0 * found.share_sd:.0f}"
    return minus(f"{fall(found):z.0f}{spread} %")


def curve_plate(effect: EffectJson) -> Plate | None:
    """Return a learned curve and its 90 % band over its signal."""
    found = effect.curve
    if found is None:
        return None
    x, value, sd = (np.array(numbers) for numbers in (found.x, found.value, found.sd))
    across, x_unit = scaled_unit(largest(x), found.x_unit)
    up, unit = scaled_unit(largest(value), found.unit)
    low, high = (value + side * NORMAL_HALF_WIDTH * sd for side in (-1.0, 1.0))
    layers = (
        Band(x * across, low * up, high * up, ACCENT, 0.18, label="90 % band"),
        Line(x * across, value * up, ACCENT, 2.0, label="learned"),
    )
    over = greek_name(effect.over)
    title, label = (
        f"{words} ({of})" if of else words for words, of in ((f"{effect.port}: learned effect", unit), (over, x_unit))
    )
    alt = f"Learned effect at {effect.port} as a function of {over}: curve and 90 % band."
    # The band is wide where there are no data; showing all of it would flatten the curve.
    room = 0.3 * float(np.ptp(value)) or 1.0
    limits = (float(value.min() - room) * up, float(value.max() + room) * up)
    return plate(
        [Panel(title, layers, 220, y_limits=limits)],
        alt,
        label,
        "The band is wide where there are no data.",
        width=PORT,
    )
