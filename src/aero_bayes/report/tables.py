"""Tables of the page, and the little drawings within them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from markupsafe import Markup, escape

from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.residual_tests import MIN_CORRELATION
from aero_bayes.report.text import (
    NO_VALUE,
    RoundedValue,
    pretty_unit,
    rounded_value,
    sentence,
    significant,
    symbol,
    tidy,
)

_STATUS_WORDS = {
    "identified": "the data determine it",
    "weak": "it is biased, its interval is not reliable, or little of it is known without the prior or another value",
    "unidentified": "the data do not determine it",
    "fixed": "not fitted",
    "at_bound": "the best value lies on a bound of its range",
    "adequate": "the residual is noise",
    "structured": "the residual is more than noise",
    "noise": f"only noise is left: no correlation above {MIN_CORRELATION:g}",
    "too large": "more than 1.3 times the noise",
}
_RANKS = {status: rank for rank, status in enumerate(("identified", "weak", "at_bound", "unidentified", "fixed"))}


def html_table(
    columns: Sequence[str], rows: Sequence[Sequence[object]], caption: str = "", marked: Sequence[int] = ()
) -> Markup:
    """Return a table that scrolls sideways on a narrow screen; nothing without rows.

    Every cell is escaped unless it is Markup; columns of numbers go to the right."""
    if not rows:
        return Markup("")
    aligned = ["right" if k and _numeric([row[k] for row in rows]) else "left" for k in range(len(columns))]
    head = Markup("").join(
        Markup('<th scope="col" class="{}">{}</th>').format(align, title) if title else Markup("<td></td>")
        for align, title in zip(aligned, columns, strict=True)
    )
    body = Markup("")
    for index, row in enumerate(rows):
        cells = Markup("")
        for k, (align, cell) in enumerate(zip(aligned, row, strict=True)):
            tag, named = "td", Markup(' data-of="{}"').format(Markup(columns[k]).striptags())
            if not k:
                tag, named = "th", Markup(' scope="row"')
            shown = NO_VALUE if cell is None else cell
            cells += Markup('<{0}{1} class="{2}">{3}</{0}>').format(tag, named, align, shown)
        body += Markup('<tr class="marked">{}</tr>' if index in marked else "<tr>{}</tr>").format(cells)
    top = Markup("<thead><tr>{}</tr></thead>").format(head) if any(columns) else Markup("")
    title = Markup("<caption>{}</caption>").format(caption) if caption else Markup("")
    return Markup(
        '<div class="scroll{}" tabindex="0" role="region" aria-label="{}"><table>{}{}<tbody>{}</tbody></table></div>'
    ).format(" wide" if len(columns) > MOST_COLUMNS else "", caption or "table", title, top, body)


#: Columns that a phone shows side by side; of a table with more, the cells of a row stand below each other.
MOST_COLUMNS = 3
#: How a cell begins that holds a number.
_NUMBER = re.compile(r"\s*([<+−]?\s?\d[\d.\u202f]*(?=$|[\s%×…])|–\s*$)")


def _numeric(cells: Sequence[object]) -> bool:
    """Say whether cells of a column hold numbers; one that is not known is no exception."""
    texts = [re.sub("<[^>]*>", " ", NO_VALUE if cell is None else str(cell)) for cell in cells]
    return all(_NUMBER.match(text) for text in texts if text.strip()) and any(text.strip() for text in texts)


def parameter_table(parameters: Mapping[str, Estimate], caption: str = "Estimates") -> Markup:
    """Write value, 90 % interval, unit and status of every parameter.

    What was fixed, ended on a bound, or is not determined by the data never shows an interval."""
    rows: list[tuple[object, ...]] = []
    for name, stated in sorted(parameters.items(), key=lambda item: _RANKS[item[1].status]):
        shown, sure = parameter_quantity(stated)
        ends = Markup(
            '<span class="whole">{}<span class="to">\u00a0…</span></span> <span class="whole">{}</span>'
        ).format(shown.low, shown.high)
        about = Markup("{}<small>{}</small>").format(symbol(name), stated.description)
        own = f"of {stated.recording} alone" if stated.recording else ""
        held = stated.status in {"unidentified", "at_bound"}
        value = Markup('<span class="{}">{}</span><small class="narrow">{}</small>').format(
            "held whole" if held else "whole", shown.value, shown.unit
        )
        rows.append((about, value, ends if sure else NO_VALUE, shown.unit, status_pill(stated.status),
                     "; ".join(filter(None, (stated.note, own)))))  # fmt: skip
    columns = ["parameter", "value", "90 % interval", "unit"]
    columns += ["status", ""]
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    return Markup('<div class="estimates">{}</div>').format(html_table(columns, rows, caption)) if rows else Markup("")


def prior_table(parameters: Mapping[str, Estimate]) -> Markup:
    """Write prior, start and bounds of every parameter that was fitted; None where there is none."""
    rows = []
    for name, stated in parameters.items():
        if stated.status == "fixed":
            continue
        known = stated.prior.replace(f" {stated.unit}", f" {pretty_unit(stated.unit)}") if stated.unit else stated.prior
        numbers = (significant(x) for x in (stated.start, stated.lower, stated.upper))
        rows.append((symbol(name), *numbers, pretty_unit(stated.unit), known))
    columns = ("parameter", "start", "lowest", "highest", "unit", "prior")
    return html_table(columns, rows, "Priors, starts and bounds")


def parameter_quantity(stated: Estimate) -> tuple[RoundedValue, bool]:
    """Return a parameter's texts, and whether it may show an interval at all."""
    low, high = stated.q05, stated.q95
    sure = stated.status not in {"unidentified", "fixed", "at_bound"} and low is not None and high is not None
    if not sure:
        low = high = None
    return rounded_value(stated.value, low, high, stated.unit).apart, sure


def status_pill(status: str) -> Markup:
    """Return a parameter's status or a residual's verdict as a small label with its meaning."""
    if not status:
        return Markup(NO_VALUE)
    known = status.replace(" ", "_") if status in _STATUS_WORDS else "other"
    return Markup('<span class="pill {}" title="{}">{}</span>').format(known, _STATUS_WORDS.get(status, ""), status)


def status_words(parameters: Mapping[str, Estimate]) -> Markup:
    """Say what each of the statuses that parameters have means."""
    found = {entry.status for entry in parameters.values()}
    meant = (Markup("<strong>{}</strong>: {}").format(s, _STATUS_WORDS[s]) for s in _RANKS if s in found)
    return Markup('<p class="lead">{}.</p>').format(Markup("; ").join(meant)) if found else Markup("")


def ratio_glyph(before: float | None, after: float | None) -> Markup:
    """Draw errors before (ring) and after (dot) in multiples of the noise floor (line at 1), on a logarithmic axis."""
    known = {label: ratio for label, ratio in (("before", before), ("after", after)) if ratio is not None and ratio > 0}
    if not known:
        return Markup("")
    least, most = min(0.8, *known.values()), max(4.0, *known.values())

    def at(ratio: float) -> float:
        return 8 + 124 * math.log(ratio / least) / math.log(most / least)

    marks = Markup("")
    if len(known) == 2:
        marks += Markup('<line class="way" x1="{:.1f}" x2="{:.1f}" y1="8" y2="8"/>').format(*map(at, known.values()))
    for label, ratio in known.items():
        marks += Markup('<circle class="{}" cx="{:.1f}" cy="8" r="4.5"/>').format(label, at(ratio))
    told = ", ".join(f"{label} {significant(ratio)}" for label, ratio in known.items())
    words = f"error in multiples of the noise floor: {told}"
    return Markup(
        '<svg class="glyph" viewBox="0 0 140 16" role="img" aria-label="{}">'
        '<line class="floor" x1="{:.1f}" x2="{:.1f}" y1="0" y2="16"/>{}</svg>'
    ).format(words, at(1.0), at(1.0), marks)


def intervals_glyph(name: str, found: Sequence[Estimate | None], colours: Sequence[str]) -> Markup:
    """Draw values with their 90 % intervals one below the other, over a scale of their own."""
    found = [q if q is not None and math.isfinite(q.value) else None for q in found]
    ends = [end for q in found if q is not None for end in (q.q05, q.q95, q.value) if end is not None]
    if not any(q is not None and q.q05 is not None for q in found):
        return Markup("")
    low, spread = min(ends), (max(ends) - min(ends)) or abs(max(ends)) or 1.0
    marks = Markup("")
    for k, q in enumerate(found):
        if q is not None:
            known = (q.value if end is None else end for end in (q.q05, q.value, q.q95))
            first, middle, last = (f"{4 + 92 * (end - low) / spread:.1f}%" for end in known)
            marks += Markup(
                '<g style="stroke:var(--{0})"><line stroke-width="3" x1="{1}" x2="{3}" y1="{4}" y2="{4}"/>'
                '<line stroke-width="7" stroke-linecap="round" x1="{2}" x2="{2}" y1="{4}" y2="{4}"/></g>'
            ).format(colours[k], first, middle, last, 11 * k + 6)
    return Markup(
        '<svg class="forest" height="{}" role="img" aria-label="values and 90 % intervals of {}">{}</svg>'
    ).format(11 * len(found) + 1, name, marks)


def bar(share: float, words: str) -> Markup:
    """Return a horizontal bar, ``share`` of 1 of its column wide."""
    return Markup(
        '<svg class="glyph" viewBox="0 0 140 12" role="img" aria-label="{}">'
        '<rect class="track" x="0" y="5" width="140" height="2"/>'
        '<rect class="bar" x="0" y="1" width="{:.1f}" height="10" rx="1"/></svg>'
    ).format(words, 140 * min(1.0, max(0.0, share)))


def generic_cell(value: object) -> object:
    """Write whatever a run stated as a cell: numbers rounded, lists spelt out."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return tidy(float(value)) if math.isfinite(value) else NO_VALUE
    if isinstance(value, list | tuple):
        return Markup(", ").join(escape(str(generic_cell(item))) for item in value)
    return NO_VALUE if value is None else sentence(value)
