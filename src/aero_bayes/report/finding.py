"""Head of a loop's page: what is missing, how we know, how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from aero_bayes.loop.sentences import claimed, cross_validated, growing, in_words
from aero_bayes.loop.sentences import place as where
from aero_bayes.report import words
from aero_bayes.report.drawing import Plate
from aero_bayes.report.loop_figures import changed_equations, curve_plate
from aero_bayes.report.schema_run import EffectJson, LoopJson, RecordingErrorJson, RunJson
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import signed, symbol

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
    none: str
    equations: Markup | None
    values: list[str]
    bars: list[tuple[Markup, list[Bar]]]
    known: list[str]
    sure: list[str]
    rivals: list[Markup]
    curves: list[Plate]


def finding(result: RunJson) -> Finding | None:
    """Return the head of a loop's page; None for other runs."""
    loop = result.loop
    if loop is None:
        return None
    effects, name = loop.effects, "it" if len(loop.effects) == 1 else ""
    units = {e.output: result.unit(e.output) for e in loop.errors}
    named = [(e.id, _named(e), place(e)) for e in effects]
    nothing = "Nothing that the recordings show"
    if loop.outcome == "unexplained":
        nothing = "Not known: no effect that was tried explains what is left"
    known = [text for e in effects if (text := cross_validated(e, name or e.id))]
    known += [f"{text[:1].upper()}{text[1:]}." for text in (growing(loop.errors, units) if effects else [])]
    sure = [text for e in effects if (text := claimed(e, name or e.id, "those listed below"))]
    sure += [words.limit(one) for one in loop.limits[:MOST_LIMITS]] if loop.outcome == "adequate" else []
    rivals = [table for e in effects if (table := rivals_table(e))]
    return Finding(
        named, "" if named else nothing, changed_equations(loop), [text for e in effects if (text := words.values(e))],
        [_bars(result, error) for error in _shown(loop)], known, sure, rivals,
        [p for e in effects if (p := curve_plate(e))],
    )  # fmt: skip


def _named(effect: EffectJson) -> str:
    """Return what an effect is, and of how many the data do not tell it."""
    what = in_words(effect) or (f"a curve over {effect.over}" if effect.over else "")
    return f"perhaps {what}" if effect.claim in ("place", "one of") and what else what


def place(effect: EffectJson) -> str:
    """Return where in the model an effect acts."""
    return "" if " at " in effect.summary else f"at {effect.port}"


def _shown(loop: LoopJson) -> list[RecordingErrorJson]:
    """Return the errors to draw: those that an effect changes or that are not noise, those that fall most first."""
    errors = words.judged(loop, "test") or words.judged(loop, "train")
    ranked = sorted(errors, key=lambda e: (e.after or 0.0) / e.before if e.before else 1.0)
    told = [e for e in ranked if e.verdict != "noise" or (e.before and abs((e.after or 0.0) / e.before - 1.0) > 0.05)]
    return (told or ranked)[:MOST_BARS]


def _bars(result: RunJson, error: RecordingErrorJson) -> tuple[Markup, list[Bar]]:
    unit = result.unit(error.output)
    extended = result.loop is not None and bool(result.loop.effects)
    sizes = [
        ("before", "before", error.before if extended else None),
        ("after" if extended else "error", "after", error.after),
        ("noise" if error.noise_known else "of the fit", "noise", error.noise),
    ]
    most = max((value for *_, value in sizes if value is not None), default=1.0) or 1.0
    bars = [Bar(label, 100.0 * v / most, words.size(v, unit), css) for label, css, v in sizes if v is not None]
    return Markup("error of {} on {}").format(symbol(error.output), where(error)), bars


def rivals_table(effect: EffectJson) -> Markup | None:
    """List what the data do not tell from an effect; None where there is nothing."""
    rows = [
        (Markup("<code>{}</code>").format(other.id), _more(other.error_ratio))
        for other in effect.alternatives if other.id != effect.id
    ]  # fmt: skip
    caption = f"{'Other forms of' if effect.claim == 'law' else 'Not told from'} {effect.id}"
    return html_table(("effect", Column("left-out error", "right")), rows, caption) if rows else None


def _more(ratio: float | None) -> str:
    """Return how much larger an error is; the same where less than half a per cent."""
    change = 0.0 if ratio is None else 100.0 * (ratio - 1.0)
    return f"{signed(change, 0)}\u00a0%" if abs(change) >= 0.5 else "the same"
