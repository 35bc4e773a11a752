"""Head of the page (what is missing, how we know, how sure it is; warnings), and its end (provenance)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from aero_bayes.estimate.error_sentences import growing, told_first
from aero_bayes.estimate.error_sentences import place as where
from aero_bayes.estimate.residual_tests import RecordingError
from aero_bayes.loop.extend import FoundEffect
from aero_bayes.loop.result import LoopJson
from aero_bayes.loop.sentences import beside, claimed, cross_validated, in_words, larger, places
from aero_bayes.plain import number
from aero_bayes.report import words
from aero_bayes.report.curves import role_of
from aero_bayes.report.drawing import Plate
from aero_bayes.report.loop_figures import changed_equations, curve_plate
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.tables import generic_cell, html_table
from aero_bayes.report.text import count, duration, symbol, tidy

#: Outputs whose bars are drawn, those whose error falls most; the table of errors has all.
MOST_BARS = 3
#: Limits of laws that are named where nothing was found.
MOST_LIMITS = 4
_HASH_SHOWN = 16


@dataclass(frozen=True)
class Finding:
    """The three parts of the head, each with its heading, and the curves that were learned, for below."""

    columns: list[tuple[str, list[Markup | str]]]
    curves: list[list[Plate]]


def finding(result: RunJson) -> Finding | None:
    """Return the head of a loop's page; None for other runs."""
    loop = result.loop
    if loop is None:
        return None
    effects, name = loop.effects, "it" if len(loop.effects) == 1 else ""
    units = {e.output: result.unit(e.output) for e in loop.errors}
    nothing = "Nothing that the recordings show"
    if loop.outcome == "unexplained":
        nothing = "Not known: no effect that was tried explains what is left"
    named = [_named(e) for e in effects] or [Markup('<p class="named">{}</p>').format(nothing)]
    equations = changed_equations(loop)
    frame = Markup('<pre tabindex="0" role="region" aria-label="Equations with the added term">{}</pre>')
    sizes = [words.values(e, result.parameters) for e in effects]
    missing = [*named, frame.format(equations) if equations else "", *sizes]
    bars = [_bars(result, error) for error in _shown(loop)]
    known = [*bars, *(cross_validated(e, name or e.id, beside(effects, e)) for e in effects)]
    known += [f"{text[:1].upper()}{text[1:]}." for text in (growing(loop.errors, units) if effects else [])]
    sure = [claimed(e, name or e.id, "those listed below") for e in effects]
    sure += [words.limit(one) for one in loop.limits[:MOST_LIMITS]] if loop.outcome == "adequate" else []
    sure += [rivals_table(e) for e in effects]
    columns = {"What is missing": missing, "How we know": known, "How sure": sure}
    kept = [(heading, [part for part in parts if part]) for heading, parts in columns.items()]
    drawn = [p for e in effects if (p := curve_plate(e))]
    return Finding([(h, parts) for h, parts in kept if parts] if effects or bars else [], [drawn] if drawn else [])


def _named(effect: FoundEffect) -> Markup:
    """Return what an effect is, whether the data tell it from others, and where it acts."""
    what = in_words(effect) or (f"a curve over {effect.over}" if effect.over else "")
    what = f"perhaps {what}" if effect.claim in ("place", "one of") and what else what
    line = Markup('<p class="named">{} {} <code>{}</code></p>')
    acts = places(effect) if effect.claim == "mechanism" else place(effect)
    return line.format(what[:1].upper() + what[1:], acts, effect.id)


def place(effect: FoundEffect) -> str:
    """Return where in the model an effect acts."""
    return "" if " at " in effect.summary else f"at {effect.port}"


def _shown(loop: LoopJson) -> list[RecordingError]:
    """Return the errors to draw: those that an effect changes or that are not noise, those that fall most first."""
    errors = told_first(loop.errors)
    ranked = sorted(errors, key=lambda e: e.change if e.before else 1.0)
    told = [e for e in ranked if e.verdict != "noise" or abs(e.change - 1.0) > 0.05]
    return (told or ranked)[:MOST_BARS]


def _bars(result: RunJson, error: RecordingError) -> Markup:
    """Draw an error before and after beside the noise, each as a bar."""
    unit = result.unit(error.output)
    extended = result.loop is not None and bool(result.loop.effects)
    named = [
        ("before", "before", number(error.before if extended else None)),
        ("after" if extended else "error", "after", error.after),
        ("noise" if error.noise_known else "of the fit", "noise", error.noise),
    ]
    sizes = [size for size in named if math.isfinite(size[-1])]
    most = max((value for *_, value in sizes), default=1.0) or 1.0
    bar = Markup('<dt>{}</dt><dd><i class="{}" style="width:{:.1f}%"></i> {}</dd>')
    drawn = (bar.format(label, css, 62 * v / most, words.size(v, unit)) for label, css, v in sizes)
    head = Markup('<p class="label">error of {} on {}</p><dl class="bars">{}</dl>')
    return head.format(symbol(error.output), where(error), Markup("").join(drawn))


def rivals_table(effect: FoundEffect) -> Markup:
    """List what the data do not tell from an effect; None where there is nothing."""
    rows = [
        (Markup("<code>{}</code>").format(other.id), larger(other.error_ratio).replace(" %", "\u00a0%"))
        for other in effect.alternatives if other.id != effect.id
    ]  # fmt: skip
    caption = f"{'The same law in other forms:' if effect.claim == 'law' else 'Not told from'} {effect.id}"
    return html_table(("effect", "error, left out and validation"), rows, caption)


def warnings(result: RunJson) -> list[str]:
    """Return warnings of the run without those in the verdict, and one on parameters on a bound."""
    found = list(result.warnings)
    reason = result.mcmc.reason if result.mcmc is not None and not result.mcmc.converged else ""
    if reason and reason in words.verdict(result).text:  # said already
        found = [text for text in found if reason not in text]
    bounds = [f"`{name}`" for name, entry in result.parameters.items() if entry.status == "at_bound"]
    if bounds:
        found.append(
            f"{', '.join(bounds)}: the best value lies on a bound of the search range, so there is no interval."
        )
    return list(dict.fromkeys(found))


def provenance(result: RunJson) -> list[Markup]:
    """Return tables of provenance: data, model, software and computing effort."""
    tables = []
    files = [
        (row.file, count(row.rows), tidy(row.rate_hz), _hash(row.sha256)) for row in result.data
    ]  # fmt: skip
    if files:
        heads = ("file", "rows", "rate (Hz)", "SHA-256 (first digits)")
        tables.append(html_table(heads, files, "Data"))
    if result.recordings:
        used = [
            (row.name, role_of(result, row.name), count(row.rows), duration(row.duration_s), _signals(row.inputs),
             _signals(row.outputs))
            for row in result.recordings
        ]  # fmt: skip
        columns = ("recording", "role", "rows", "length", "inputs", "outputs")
        tables.append(html_table(columns, used, "Recordings"))
    model = {key: value for key, value in result.model.model_dump().items() if value}
    for title, node in (
        ("Model", model),
        ("Run", {"command": result.command, "seed": result.seed}),
        ("Versions", result.versions),
        ("Simulations", result.failures | ({"time": duration(result.seconds)} if result.seconds is not None else {})),
    ):
        if node:
            rows = [(key.replace("_", " ") if node is model else key, _exact(value)) for key, value in node.items()]
            tables.append(html_table(("", ""), rows, title))
    return tables


def _signals(names: Sequence[str]) -> Markup:
    return Markup(", ").join(symbol(name) for name in names)


def _exact(value: object) -> object:
    """Keep whole numbers such as a seed as they are."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return _hash(value) if isinstance(value, str) and len(value) == 64 else generic_cell(value)


def _hash(digits: str) -> Markup:
    return Markup('<code class="hash" title="{}">{}</code>').format(digits, digits[:_HASH_SHOWN])
