"""What the page draws of a loop: its rounds, the curves that it learned, the equations that changed."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from difflib import SequenceMatcher

import numpy as np
from markupsafe import Markup, escape

from aero_bayes.loop.extend import FoundEffect
from aero_bayes.loop.result import LoopJson, Step, StepCandidate
from aero_bayes.report.curves import largest
from aero_bayes.report.drawing import Band, Line, Panel, Plate, plate
from aero_bayes.report.svg import ACCENT, INK, MEASURED, MUTED, WARM_COLOUR, Canvas
from aero_bayes.report.tables import bar, html_table
from aero_bayes.report.text import NO_VALUE, greek_name, minus, scaled_unit
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

_MOST_ROWS = 24
#: Letters of a candidate's label beside a bar; pixels of the labels, of a step's bars with their numbers, and of a row.
_LABEL_LETTERS, _LABEL, _STEP, _ROW = 52, 330.0, 250.0, 20.0


def rounds(loop: LoopJson) -> tuple[list[Step], list[str], list[str]]:
    """Return rounds that tried anything, all candidates (those taken first, then by gain), and those to be drawn."""
    steps = [step for step in loop.steps if any(math.isfinite(c.share) for c in step.candidates)]
    best: dict[str, float] = {}
    for step in steps:
        for c in step.candidates:
            best[c.id] = max(best.get(c.id, -math.inf), fall(c))
    taken = [step.chosen for step in steps if step.chosen in best]
    rest = sorted((id_ for id_ in best if id_ not in taken), key=lambda id_: -best[id_])
    ids = [*dict.fromkeys(taken), *rest]
    return steps, ids, [id_ for id_ in ids if best[id_] > 0 or id_ in taken][:_MOST_ROWS] or ids[:1]


def rounds_table(loop: LoopJson, words: Mapping[str, str]) -> Markup:
    """Write a row for each candidate, and a bar for each step: how far the error falls."""
    steps, ids, _ = rounds(loop)
    cells = [{c.id: c for c in step.candidates} for step in steps]
    rows = []
    for id_ in ids:
        name = Markup("<code>{}</code><small>{}</small>").format(id_, words.get(id_, ""))
        port = next((by_id[id_].port for by_id in cells if id_ in by_id), NO_VALUE)
        rows.append((name, port, *(_cell(by_id.get(id_), step) for by_id, step in zip(cells, steps, strict=True))))
    heads = (f"step {step.round}" for step in steps)
    caption = "How far the error on left-out readings falls, in the output where it falls most"
    return html_table(("candidate", "port", *heads), rows, caption)


def _cell(found: StepCandidate | None, step: Step) -> Markup:
    if found is None:
        return Markup(NO_VALUE)
    notes = [
        "chosen" if found.id == step.chosen else "not told from the chosen one" if found.id in step.equivalent else "",
        "" if found.refitted else "estimated, not fitted",
    ]
    drawn = bar(0.01 * max(fall(found), 0.0), f"{found.id}: {fall_text(found)}")
    return Markup("{} {}<small>{}</small>").format(drawn, fall_text(found), "; ".join(filter(None, notes)))


def rounds_canvas(loop: LoopJson, words: Mapping[str, str]) -> Canvas | None:
    """Draw how far the error falls as bars: a row for each candidate that helps, a column for each step; None if no
    candidate was tried."""
    steps, _, ids = rounds(loop)
    if not steps:
        return None
    alt = "Fall of the left-out error by candidate and step."
    canvas = Canvas(_LABEL + _STEP * len(steps), 30 + _ROW * len(ids), alt)
    for row, id_ in enumerate(ids):
        text = words.get(id_) or id_
        short = text if len(text) <= _LABEL_LETTERS else f"{text[: _LABEL_LETTERS - 1]}…"
        canvas.text(_LABEL - 8, 40 + _ROW * row, short, INK, anchor="end")
    for column, step in enumerate(steps):
        left = _LABEL + _STEP * column
        canvas.text(left, 15, f"step {step.round}: {step.chosen or 'nothing'} chosen", INK)
        for found in step.candidates:
            if found.id in ids and found.share is not None:
                top, chosen = 30 + _ROW * ids.index(found.id), found.id == step.chosen
                end = left + 1.0 + max(fall(found), 0.0)
                low, high = np.full(2, top + 12.0), np.full(2, top)
                colour = WARM_COLOUR if chosen else MEASURED
                canvas.area(np.array([left, end]), low, high, colour, 1.0, 1.5 * (found.id in step.equivalent))
                canvas.text(end + 5, top + 10, fall_text(found), INK if chosen else MUTED)
    return canvas


def fall(found: StepCandidate | FoundEffect) -> float:
    """Return by how much the error on left-out readings falls, in %; minus infinity where that is not known."""
    return -math.inf if math.isnan(found.share) else 100.0 * (1.0 - found.share)


def fall_text(found: StepCandidate | FoundEffect) -> str:
    """Return the same in words, with its standard error."""
    if not math.isfinite(fall(found)):
        return NO_VALUE
    spread = "" if math.isnan(found.share_sd) else f" ± {100.0 * found.share_sd:.0f}"
    return minus(f"{fall(found):z.0f}{spread} %")


def curve_plate(effect: FoundEffect) -> Plate | None:
    """Return a learned curve and its 90 % band over its signal."""
    found = effect.curve
    if found is None:
        return None
    x, value, sd = found.x, found.value, found.sd
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
    panel = Panel(title, layers, 220, y_limits=limits)
    return plate([panel], alt, label, "The band is wide where there are no data.", small=True)


#: What begins a part of a class that holds no equations; the text of a documentation is none either.
NO_EQUATIONS = ("end ", "public", "protected", "algorithm", "annotation")
#: What begins a class. The model's own is renamed in a difference; one that is new is a law's.
CLASS = r"(?:model|block|record|function)\s+(\w+)"


def changed_equations(loop: LoopJson) -> Markup | None:
    """Equations that the extended model has and the base model has not, what is new in them marked; None if there are
    none. Those within a law's own class are not the model's."""
    section, own, law = False, set(), ""
    for text in loop.modelica_source.splitlines():
        head = text.strip().removeprefix("initial ")
        section = (section or head == "equation") and not head.startswith(NO_EQUATIONS)
        own |= {head} if section and head != "equation" else set()
    old: list[str] = []
    found, renamed = [], tuple(f"{name}_" for name in re.findall(rf"(?m)^-\s*{CLASS}", loop.diff))
    for text in loop.diff.splitlines():
        kind, line = _diff_kind(text), text[1:].strip()
        begun = re.match(CLASS, line) if kind == "add" else None
        law = law or (begun[1] if begun and not begun[1].startswith(renamed) else "")
        if law:
            law = "" if line == f"end {law};" else law
        elif kind == "add" and line in own and not line.startswith("//"):
            found.append(_marked(old.pop(0) if old else "", line))
        elif kind != "add":
            old = [*old, line] if kind == "del" else []
    return Markup("\n").join(found) if found else None


def _marked(old: str, new: str) -> Markup:
    """Return a line with the differences to an older one marked."""
    before, after = (re.findall(r"[\w.]+|\s+|.", text) for text in (old, new))
    shown = Markup("")
    for kind, _, _, start, stop in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        text = "".join(after[start:stop])
        shown += escape(text) if kind == "equal" or not text else Markup("<mark>{}</mark>").format(text)
    return shown


def diff_text(loop: LoopJson) -> Markup:
    """Return the Modelica diff, each line marked as add, del, hunk or same."""
    line = Markup('<span class="{}">{}\n</span>')
    lines = Markup("").join(line.format(_diff_kind(entry), entry) for entry in loop.diff.splitlines())
    frame = '<pre class="diff" tabindex="0" role="region" aria-label="Difference of the Modelica source">{}</pre>'
    return Markup(frame).format(lines)


def _diff_kind(entry: str) -> str:
    if entry.startswith(("+++", "---", "@@")):
        return "hunk"
    return {"+": "add", "-": "del"}.get(entry[:1], "same")
