"""Tables of the closed loop: added effects, errors, and changes of the parameters."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from difflib import SequenceMatcher

from markupsafe import Markup, escape

from aero_bayes.report.figure import Plate
from aero_bayes.report.loop_figures import curve_plate, fall_text
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import Column, html_table, parameter_quantity, ratio_glyph
from aero_bayes.report.text import NO_VALUE, pretty_unit, role_words, signed, significant, symbol
from aero_bayes.schema import EffectJson, LoopJson, QuantilesJson

#: What begins a part of a class that holds no equations; the text of a documentation is none either.
NO_EQUATIONS = ("end ", "public", "protected", "algorithm", "annotation")


@dataclass(frozen=True)
class EffectSection:
    """An effect that the loop added."""

    name: str
    meaning: str
    where: str
    evidence: str
    parameters: Markup | None
    figure: Plate | None


def effects(loop: LoopJson, stated: Collection[str]) -> list[EffectSection]:
    """Return the effects that were added; with their parameters, but for those that the page states elsewhere."""
    return [_effect(entry, stated) for entry in loop.effects]


def _effect(entry: EffectJson, elsewhere: Collection[str]) -> EffectSection:
    kind = "a curve learned from the data" if entry.kind == "free_form" else ""
    evidence = f"error on left-out readings lower by {fall_text(entry)}"
    if entry.looks_like:
        evidence += f", looks like {entry.looks_like}"
    rows = []
    for name, stated in entry.parameters.items():
        if name in elsewhere:
            continue
        shown, sure = parameter_quantity(stated)
        interval = f"{shown.low} … {shown.high}" if sure else NO_VALUE
        rows.append((symbol(name), shown.value, interval, shown.unit, stated.description))
    columns = ("parameter", Column("value", "right"), Column("90 % interval", "right"), "unit", "")
    where = f"port {entry.port}" + (f", as a function of {entry.over}" if entry.over else "")
    table = html_table(columns, rows, f"Parameters of {entry.id}") if rows else None
    return EffectSection(entry.id, entry.summary or kind, where, evidence, table, curve_plate(entry))


def before_after_table(run: RunDirectory, loop: LoopJson) -> Markup | None:
    """Return RMS error before and after, on training and on unseen recordings, against the noise floor."""
    rows = []
    for split in dict.fromkeys((*loop.before, *loop.after)):
        before, after = loop.before.get(split, {}), loop.after.get(split, {})
        for output in dict.fromkeys((*before, *after)):
            old, new, floor = before.get(output), after.get(output), _floor(run, loop, split, output)
            ratios = [x / floor if x is not None and floor else None for x in (old, new)]
            change = None if old is None or new is None or not old else 100 * (new / old - 1)
            rows.append((
                role_words(split), symbol(output), significant(old),
                significant(new), significant(floor), pretty_unit(run.result.unit(output)),
                NO_VALUE if change is None else f"{signed(change, 0)} %", ratio_glyph(*ratios),
            ))  # fmt: skip
    if not rows:
        return None
    columns = (
        "data", "output", Column("before", "right"), Column("after", "right"), Column("noise floor", "right"),
        "unit", Column("change", "right"), Column("floor │ ○ before  ● after", "centre"),
    )  # fmt: skip
    return html_table(columns, rows, "RMS error before and after")


def shift_table(run: RunDirectory, loop: LoopJson) -> Markup | None:
    """Return how far the base parameters moved once the missing effect was in: the bias that it had caused."""
    rows = []
    for name, moved in loop.shifts.items():
        stated = run.result.parameters.get(name)
        was, now = (
            parameter_quantity(_spread(value, sd, stated.unit if stated else ""))[0]
            for value, sd in ((moved.before, moved.before_sd), (moved.after, moved.after_sd))
        )
        share = None
        if moved.before and moved.after is not None:
            share = 100 * (moved.after - moved.before) / abs(moved.before)
        rows.append((
            Markup("{}<small>{}</small>").format(symbol(name), stated.description if stated else ""),
            f"{was.value} {was.unit}".strip(), f"{now.value} {now.unit}".strip(),
            NO_VALUE if share is None else f"{signed(share, 1)} %",
            significant(moved.in_sd, 2),
        ))  # fmt: skip
    if not rows:
        return None
    columns = (
        "parameter", Column("before", "right"), Column("after", "right"), Column("change", "right"),
        Column("in standard deviations", "right"),
    )  # fmt: skip
    return html_table(columns, rows, "Change of the parameters of the base model")


def changed_equations(loop: LoopJson) -> Markup | None:
    """Equations of the extended model that the base model has not, with what is new in them marked; None if there are
    none.
    """
    section, own = False, set()
    for text in loop.modelica_source.splitlines():
        head = text.strip().removeprefix("initial ")
        section = (section or head == "equation") and not head.startswith(NO_EQUATIONS)
        own |= {head} if section and head != "equation" else set()
    old: list[str] = []
    found = []
    for text in loop.diff.splitlines():
        kind, line = _diff_kind(text), text[1:].strip()
        if kind == "add" and line in own and not line.startswith("//"):
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


def new_values(loop: LoopJson) -> Markup:
    """Return name, value and interval of each parameter that was added, in a line."""
    texts = []
    for name, stated in ((n, p) for effect in loop.effects for n, p in effect.parameters.items()):
        shown, sure = parameter_quantity(stated)
        interval = f" ({shown.low} … {shown.high})" if sure else ""
        texts.append(Markup("{} = {}{} {}").format(symbol(name), shown.value, interval, shown.unit))
    return Markup("; ").join(texts)


def diff_lines(loop: LoopJson) -> list[tuple[str, str]]:
    """Return lines of the Modelica diff with their kind: add, del, hunk or same."""
    return [(_diff_kind(entry), entry) for entry in loop.diff.splitlines()]


def _diff_kind(entry: str) -> str:
    if entry.startswith(("+++", "---", "@@")):
        return "hunk"
    return {"+": "add", "-": "del"}.get(entry[:1], "same")


def _spread(value: float | None, sd: float | None, unit: str) -> QuantilesJson:
    """Return a value with its standard deviation as an interval, for rounding."""
    if value is None or sd is None:
        return QuantilesJson(value=value, unit=unit)
    return QuantilesJson(value=value, q05=value - sd, q95=value + sd, unit=unit)


def _floor(run: RunDirectory, loop: LoopJson, split: str, output: str) -> float | None:
    if (given := loop.noise_floor.get(output)) is not None:
        return given
    rows = [row for row in run.result.recordings if row.role == split] or run.result.recordings
    floors = [floor for row in rows if (floor := row.noise_floor.get(output)) is not None]
    return (sum(floor**2 for floor in floors) / len(floors)) ** 0.5 if floors else None
