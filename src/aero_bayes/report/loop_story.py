"""The closed loop as a story: what was left, where it acts, which effect it is, what was added, what it gained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from aero_bayes.report.effect_names import effect_words
from aero_bayes.report.run_directory import RunDirectory, mapping, number, table, texts
from aero_bayes.report.series_figures import unit_of
from aero_bayes.report.tables import (
    Column,
    bar,
    generic_cell,
    html_table,
    parameter_quantity,
    ratio_glyph,
)
from aero_bayes.report.text import NOTHING, count, minus, pretty_unit, role_words, signed, significant, symbol, tidy

_SHOWN_CANDIDATES = 8
_OUTCOMES = {
    "adequate": "nothing missing: the residual is noise",
    "extended": "the model was extended",
    "unexplained": "something is missing and remains unexplained",
}


@dataclass(frozen=True)
class Effect:
    """An effect that the loop added."""

    name: str
    meaning: str
    port: str
    kind: str
    parameters: Markup | None
    evidence: Markup


@dataclass(frozen=True)
class Round:
    """One round of the search."""

    title: str
    why: str
    ports: Markup | None
    candidates: Markup | None
    others: Markup | None


def outcome(run: RunDirectory) -> str:
    """How the loop ended, in words."""
    stated = str(mapping(run.result, "loop").get("outcome", ""))
    return _OUTCOMES.get(stated, stated)


def story(run: RunDirectory) -> list[str]:
    """The run's own sentences."""
    return texts(run.result, "loop", "story")


def effects(run: RunDirectory) -> list[Effect]:
    """The effects that were added, with their parameters."""
    return [
        Effect(
            str(entry.get("id", NOTHING)), effect_words(str(entry.get("id"))), str(entry.get("port", NOTHING)),
            "learned shape" if entry.get("kind") == "free_form" else "from the catalogue",
            _effect_parameters(entry), Markup(generic_cell(entry.get("evidence") or {})),
        )
        for entry in table(run.result, "loop", "effects")
    ]  # fmt: skip


def rounds(run: RunDirectory) -> list[Round]:
    """The rounds of the search with port scores and the ranking of candidates."""
    return [
        Round(
            f"Round {step.get('round', index + 1)}", " ".join(texts(step, "why")), _port_table(step),
            *_candidate_tables(run, step),
        )
        for index, step in enumerate(table(run.result, "loop", "steps"))
    ]  # fmt: skip


def error_table(run: RunDirectory) -> Markup | None:
    """RMS error before and after, on training and on unseen recordings, against the noise floor."""
    before, after = mapping(run.result, "loop", "before"), mapping(run.result, "loop", "after")
    rows = []
    for split in dict.fromkeys((*before, *after)):
        for output in dict.fromkeys((*mapping(before, split), *mapping(after, split))):
            old, new = number(mapping(before, split).get(output)), number(mapping(after, split).get(output))
            floor = _floor(run, split, output)
            ratios = [x / floor if x is not None and floor else None for x in (old, new)]
            change = None if old is None or new is None or not old else 100 * (new / old - 1)
            rows.append((
                role_words(split), symbol(output), significant(old),
                significant(new), significant(floor), pretty_unit(unit_of(run, output)),
                NOTHING if change is None else f"{signed(change, 0)} %", ratio_glyph(*ratios),
            ))  # fmt: skip
    if not rows:
        return None
    columns = (
        "recordings", "output", Column("before", "right"), Column("after", "right"), Column("noise floor", "right"),
        "unit", Column("change", "right"), Column("floor │ ○ before  ● after", "centre"),
    )  # fmt: skip
    return html_table(columns, rows, "RMS error before and after")


def shift_table(run: RunDirectory) -> Markup | None:
    """How far the base parameters moved once the missing effect was in: the bias that it had caused."""
    old = mapping(run.result, "loop", "parameters_before")
    new = mapping(run.result, "parameters")
    rows = []
    for name, entry in old.items():
        if name not in new or mapping(entry).get("status") in {"fixed", "unidentified"}:
            continue
        (was, _), (now, _) = parameter_quantity(mapping(entry)), parameter_quantity(mapping(new[name]))
        values = number(mapping(entry).get("value")), number(mapping(new[name]).get("value"))
        sd = number(mapping(new[name]).get("sd"))
        moved = None if None in values else values[1] - values[0]  # type: ignore[operator]
        share = None if moved is None or not values[0] else 100 * moved / abs(values[0])
        rows.append((
            symbol(name), _spaced(was.value, was.unit), _spaced(now.value, now.unit),
            NOTHING if share is None else f"{signed(share, 1)} %",
            NOTHING if moved is None or not sd else signed(moved / sd, 1),
        ))  # fmt: skip
    if not rows:
        return None
    columns = (
        "parameter", Column("before", "right"), Column("after", "right"), Column("moved", "right"),
        Column("in standard deviations", "right"),
    )  # fmt: skip
    return html_table(columns, rows, "How far the base parameters moved")


def equivalents(run: RunDirectory) -> list[list[str]]:
    """Groups of effects that this data cannot tell apart."""
    groups = mapping(run.result, "loop").get("equivalent")
    return (
        [[str(name) for name in group] for group in groups if isinstance(group, list)]
        if isinstance(groups, list)
        else []
    )


def diff_lines(run: RunDirectory) -> list[tuple[str, str]]:
    """Lines of the Modelica diff with their kind: add, del, hunk or same."""
    text = mapping(run.result, "loop").get("diff")
    if not isinstance(text, str):
        return []
    return [(_diff_kind(entry), entry) for entry in text.splitlines()]


def _diff_kind(entry: str) -> str:
    if entry.startswith(("+++", "---", "@@")):
        return "hunk"
    return {"+": "add", "-": "del"}.get(entry[:1], "same")


def _effect_parameters(entry: Mapping[str, Any]) -> Markup | None:
    rows = []
    for name, stated in mapping(entry, "parameters").items():
        known = mapping(stated) if isinstance(stated, Mapping) else {"value": stated}
        shown, sure = parameter_quantity(known)
        rows.append((symbol(name), shown.value, f"{shown.low} … {shown.high}" if sure else NOTHING, shown.unit))
    columns = ("parameter", Column("value", "right"), Column("90 % interval", "right"), "unit")
    return html_table(columns, rows, f"Parameters of {entry.get('id', 'the effect')}") if rows else None


def _port_table(step: Mapping[str, Any]) -> Markup | None:
    scores = {port: score for port, x in mapping(step, "port_scores").items() if (score := _score(x)) is not None}
    if not scores:
        return None
    most = max(map(abs, scores.values())) or 1.0
    ranked = sorted(scores.items(), key=lambda item: -item[1])
    rows = [(port, bar(score / most, f"score of port {port}"), tidy(score, 3)) for port, score in ranked]
    return html_table(
        ("port", "", Column("score", "right")), rows, "How well an unknown signal at each port explains all outputs"
    )


def _score(stated: object) -> float | None:
    return number(stated.get("score")) if isinstance(stated, Mapping) else number(stated)


def _candidate_tables(run: RunDirectory, step: Mapping[str, Any]) -> tuple[Markup | None, Markup | None]:
    ranked = sorted(table(step, "candidates"), key=lambda row: -(number(row.get("delta_evidence")) or float("-inf")))
    if not ranked:
        return None, None
    gains = [number(row.get("delta_evidence")) for row in ranked]
    most = max((gain for gain in gains if gain is not None), default=0.0)
    chosen = step.get("chosen")
    same = {name for group in equivalents(run) if chosen in group for name in group}
    shows_errors = any(row.get("rms_after") is not None for row in ranked)
    rows = []
    for row, gain in zip(ranked, gains, strict=True):
        name = str(row.get("id", NOTHING))
        note = "chosen" if name == chosen else "cannot be told apart from the chosen" if name in same else ""
        label = Markup("<code>{}</code><small>{}</small>").format(name, effect_words(name))
        share = gain / most if gain is not None and most > 0 else 0.0
        words = f"evidence gained by {name}: {significant(gain)}"
        after = row.get("rms_after")
        gained = NOTHING if row.get("refitted") is False else _gain(gain)
        note = note or ("gains too little to be refitted" if row.get("refitted") is False else "")
        errors = [generic_cell(after, 3)] if shows_errors else []
        rows.append((label, row.get("port", NOTHING), bar(share, words), gained, *errors, note))
    marked = [index for index, row in enumerate(ranked) if chosen is not None and row.get("id") == chosen]
    errors_head = [Column("RMS after", "right")] if shows_errors else []
    columns: tuple[Column | str, ...] = ("candidate", "port", "", Column("evidence gained", "right"), *errors_head, "")
    first = html_table(columns, rows[:_SHOWN_CANDIDATES], "Candidates, each refitted with all parameters free", marked)
    rest = rows[_SHOWN_CANDIDATES:]
    return first, html_table(columns, rest, "The other candidates") if rest else None


def _gain(value: float | None) -> str:
    return NOTHING if value is None else count(value) if abs(value) >= 1000 else minus(f"{value:.1f}")


def _floor(run: RunDirectory, split: str, output: str) -> float | None:
    stated = mapping(run.result, "loop", "noise_floor").get(output)
    if (given := number(stated)) is not None:
        return given
    rows = [row for row in table(run.result, "recordings") if row.get("role", "train") == split]
    floors = [floor for row in rows or table(run.result, "recordings")
              if (floor := number(mapping(row, "noise_floor").get(output))) is not None]  # fmt: skip
    return (sum(floor**2 for floor in floors) / len(floors)) ** 0.5 if floors else None


def _spaced(value: str, unit: str) -> str:
    return f"{value} {unit}".strip()
