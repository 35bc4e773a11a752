"""How a name that does not exist is refused: the message ends with the nearest name that does."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

#: Largest number of known names that a message lists.
MAX_LISTED_NAMES = 20


def closest_name(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str | None:
    """Find the known name that is most similar to another one (Ratcliff and Obershelp, as ``difflib`` has it)."""
    names = list(known)
    alike = difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
    return next(iter(alike or (n for n in names if n.casefold() == name.casefold())), None)


def known_names_hint(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about a name that does not exist: the known names, and the closest of them."""
    names = list(known)
    close = closest_name(name, names)
    hint = f"; did you mean {close}?" if close is not None else ""
    return f", found {', '.join(names[:MAX_LISTED_NAMES])}{', ...' if len(names) > MAX_LISTED_NAMES else ''}{hint}"


def no_such_file(path: Path, what: str = "") -> str:
    """Return the message about a file that does not exist, with the file beside it that is named most like it."""
    beside = sorted(p.name for p in path.parent.iterdir()) if path.parent.is_dir() else []
    close = next((n for n in beside if n.startswith(f"{path.name}.")), None) or closest_name(path.name, beside)
    return f"{path}: no such file{what}" + (f"; did you mean {path.with_name(close)}?" if close is not None else "")
