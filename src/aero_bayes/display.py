"""Text representations of objects: tables, units, and lists in a sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from html import escape
from typing import Any, Self, get_args, get_type_hints

from aero_bayes.arguments import is_of, named_type, shown
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
        status = str(entry.status)
        if math.isfinite(entry.value) and status != "fixed":
            sure = status not in {"unidentified", "at_bound"} and entry.q05 is not None and entry.q95 is not None
            span = f"{entry.q05:.5g} to {entry.q95:.5g}" if sure else "-"
            rows.append((name, f"{entry.value:.5g}", span, entry.unit, "; ".join(filter(None, (status, entry.note)))))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def join_names(names: Sequence[str], last: str = "and") -> str:
    """Return names in a sentence: ``a``, ``a and b``, ``a, b and c``."""
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


class SettingsDisplay:
    """Settings show what was changed from the defaults, and refuse a name that is none, and a value of another type."""

    def __new__(cls, *args: object, **given: object) -> Self:
        known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        types = _types(cls)  # type: ignore[arg-type]
        for name in given:
            if name not in known:
                place = _place(cls, name)
                hint = f"; it is in {place}" if place else known_names_hint(name, known)
                raise InputError(f"{cls.__name__}: no setting {name!r}{hint}")
        for name, value in {**dict(zip(known, args, strict=False)), **given}.items():
            if not is_of(value, types[name]):
                raise InputError(f"{cls.__name__}: {name}: expected {named_type(types[name])}, got {shown(value)}")
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


@cache
def _types(cls: Any) -> dict[str, Any]:
    """Return the types of settings by name."""
    return get_type_hints(cls)


def _place(cls: type, name: str) -> str:
    """Return how a setting that belongs to settings within these is given; empty where there is none."""
    for own, hint in _types(cls).items():
        for kind in (hint, *get_args(hint)):
            if is_dataclass(kind) and isinstance(kind, type):
                inner = f"{name}=..." if name in {f.name for f in fields(kind)} else _place(kind, name)
                if inner:
                    return f"{own}={kind.__name__}({inner})"
    return ""


def _default(field: Field[Any]) -> object:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default
