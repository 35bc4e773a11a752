"""Text representations of objects: tables, units, and lists in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields
from html import escape
from typing import Any, Self

from aero_bayes.errors import InputError
from aero_bayes.unknown_names import known_names_hint


def table_html(head: Sequence[str], rows: Sequence[Sequence[object]], caption: str, notes: Sequence[str] = ()) -> str:
    """Return an HTML table with a caption. Cells are escaped; ``notes`` are below it in bold."""
    top = "".join(f'<th scope="col">{escape(title)}</th>' for title in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    below = "".join(f"<p><strong>{escape(note)}</strong></p>" for note in notes)
    return (
        f"<table><caption>{escape(caption)}</caption><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>{below}"
    )


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit, if it has a known one."""
    return text if unit in {"", "1", "-"} else f"{text} {unit}"


def parameter_lines(table: Mapping[str, Any]) -> list[str]:
    """Return parameters as lines of a table: name, value, 90 % interval, unit, and what is to be said of each.

    Entries have ``value``, ``q05``, ``q95``, ``unit``, ``status`` and ``note``; fixed ones are left out."""
    rows = [("parameter", "value", "90 % interval", "unit", "status")]
    for name, entry in table.items():
        status = str(entry.status or "")
        if entry.value is not None and status != "fixed":
            sure = status not in {"unidentified", "at_bound"} and entry.q05 is not None and entry.q95 is not None
            span = f"{entry.q05:.5g} to {entry.q95:.5g}" if sure else "-"
            rows.append((name, f"{entry.value:.5g}", span, entry.unit, "; ".join(filter(None, (status, entry.note)))))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def join_names(names: Sequence[str]) -> str:
    """Return names in a sentence: ``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


class SettingsDisplay:
    """Settings show what was changed from the defaults, and refuse a name that is no setting."""

    def __new__(cls, *args: object, **given: object) -> Self:
        known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        for name in given:
            if name not in known:
                raise InputError(f"{cls.__name__}: no setting {name!r}{known_names_hint(name, known)}")
        return super().__new__(cls)

    def _changed(self) -> list[tuple[str, object]]:
        chosen = ((f.name, getattr(self, f.name), _default(f)) for f in fields(self))  # type: ignore[arg-type]
        return [(name, value) for name, value, default in chosen if value != default]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self._changed())})"

    def _repr_html_(self) -> str:
        changed = {name for name, _ in self._changed()}
        rows = [
            (f.name, repr(getattr(self, f.name)), "chosen" if f.name in changed else "")
            for f in fields(self)  # type: ignore[arg-type]
        ]
        return table_html(("setting", "value", ""), rows, type(self).__name__)


def _default(field: Field[Any]) -> object:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default
