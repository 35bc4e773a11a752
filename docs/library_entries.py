"""Entries of the library's reference, written from its docstrings."""

from __future__ import annotations

import inspect
import logging
import re

from docstrings import Public, public

log = logging.getLogger("mkdocs.hooks.reference")


def library() -> str:
    """Write signature, parameters, errors and examples of each public name; members of a class below it."""
    return "\n\n".join(_entry(item) for item in public())


def _entry(item: Public) -> str:
    doc = item.doc
    if not doc.text:
        log.warning("%s has no docstring", item.name)
    head = f"{'###' if item.owner else '##'} {item.name}"
    shown = _signature(item)
    parts = [head, *([f"```python\n{shown}\n```"] if shown else []), _prose(doc.text)]
    for section in ("Parameters", "Returns", "Raises"):
        rows = [_row(section, *entry) for entry in doc.entries(section)]
        if rows:
            parts.append(f"**{section}**\n\n" + "\n".join(rows))
    if "Notes" in doc.sections:
        parts.append(_prose(doc.sections["Notes"]))
    if "Examples" in doc.sections:
        parts.append(f"```pycon\n{doc.sections['Examples']}\n```")
    return "\n\n".join(parts)


def _signature(item: Public) -> str:
    """Return it as it is called; classes whose parameters are fields that the library fills show none."""
    if isinstance(item.thing, property):
        return ""
    if isinstance(item.thing, type):
        return f"class {item.name}" if item.thing.__doc__ else ""
    return f"{item.name.rpartition('.')[2]}{inspect.signature(item.plain)}"  # type: ignore[arg-type]


def _row(section: str, names: tuple[str, ...], kind: str, text: str) -> str:
    """Return a definition: names and type, then the meaning."""
    what = ", ".join(f"`{name}`" for name in names) + (f" : {_prose(kind)}" if kind else "")
    return f"- {what}" + (f"<br>{' '.join(_prose(text).split())}" if text else "")


def _prose(text: str) -> str:
    """Write Sphinx's marks as Markdown has them."""
    return re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text).replace("``", "`")
