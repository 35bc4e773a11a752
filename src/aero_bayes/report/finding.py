"""Head of a loop's page: what is missing, how we know, how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from aero_bayes.report import words
from aero_bayes.report.drawing import Plate
from aero_bayes.report.loop_figures import curve_plate
from aero_bayes.report.loop_story import changed_equations
from aero_bayes.report.schema_loop import EffectJson, LoopJson, RecordingErrorJson
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import significant, symbol

#: Outputs whose bars are drawn, those whose error falls most; the table of errors has all.
MOST_BARS = 3
#: Limits of laws that are named where nothing was found.
MOST_LIMITS = 4


@dataclass(frozen=True)
class Bar:
    """One bar: its label, how long it is (% of the longest), its value in words, and its class."""

    label: str
    length: float
    value: str
    css: str


@dataclass(frozen=True)
class Finding:
    """The three parts of the head."""

    named: list[tuple[str, str, str]]
    equations: Markup | None
    values: list[str]
    bars: list[tuple[Markup, list[Bar]]]
    known: list[str]
    sure: list[str]
    rivals: Markup | None
    curves: list[Plate]


def finding(result: RunJson) -> Finding | None:
    """Return the head of a loop's page; None for other runs."""
    loop = result.loop
    if loop is None:
        return None
    named = [(e.id, e.summary or ("a curve over " + e.over if e.over else ""), place(e)) for e in loop.effects]
    sure = [text for e in loop.effects if (text := words.claim(e, loop.equivalent))]
    sure += [text for e in loop.effects for name, p in e.parameters.items() if (text := words.interval(name, p))]
    sure += [words.limit(one) for one in loop.limits[:MOST_LIMITS]] if not loop.effects else []
    return Finding(
        named, changed_equations(loop), [text for e in loop.effects if (text := words.values(e))],
        [_bars(result, error) for error in _shown(loop)], list(words.gain(result, loop))[-len(loop.effects) :]
        if loop.effects else [], sure, rivals_table(loop), [p for e in loop.effects if (p := curve_plate(e))],
    )  # fmt: skip


def place(effect: EffectJson) -> str:
    """Return where in the model an effect acts."""
    return "" if " at " in effect.summary else f"at {effect.port}"


def _shown(loop: LoopJson) -> list[RecordingErrorJson]:
    errors = words.judged(loop, "test") or words.judged(loop, "train")
    ranked = sorted(errors, key=lambda e: (e.after or 0.0) / e.before if e.before else 1.0)
    return ranked[:MOST_BARS]


def _bars(result: RunJson, error: RecordingErrorJson) -> tuple[Markup, list[Bar]]:
    unit = result.unit(error.output)
    sizes = [("before", error.before), ("after", error.after), ("noise", error.noise)]
    sizes = [(label, value) for label, value in sizes if value is not None]
    if not result.loop or not result.loop.effects:
        sizes = [("error" if label == "after" else label, value) for label, value in sizes if label != "before"]
    most = max((value for _, value in sizes if value is not None), default=1.0) or 1.0
    bars = [Bar(label, 100.0 * (value or 0.0) / most, words.size(value, unit), label) for label, value in sizes]
    return Markup("error of {} on {}").format(symbol(error.output), words.place(error)), bars


def rivals_table(loop: LoopJson) -> Markup | None:
    """List what does about as well in the place of each effect, and what helps beside them; None where nothing does."""
    rows = [
        (Markup("<code>{}</code>").format(other.id), other.port,
         "about as well" if other.error_ratio is None else f"{significant(other.error_ratio)} times the error")
        for effect in loop.effects for other in effect.alternatives if other.id != effect.id
    ]  # fmt: skip
    return (
        html_table(("instead", "port", Column("left-out error", "right")), rows, "Does about as well") if rows else None
    )
