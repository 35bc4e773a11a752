"""Checks of arguments: one object or several, each of the right type."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from aero_bayes.errors import InputError

Item = TypeVar("Item")
#: By type, what returns an object of it.
CONSTRUCTORS = {
    "Fit": "aero_bayes.fit",
    "Model": "aero_bayes.load_model",
    "Recording": "aero_bayes.read_recording or Recording.from_frame",
}
#: One path, or several.
Paths = str | Path | Sequence[str | Path]


def require_all(given: Item | Sequence[Item], kind: type[Item], what: str) -> tuple[Item, ...]:
    """Check the type of one object or of each of a sequence."""
    items = given if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
    return tuple(require_type(item, kind, what) for item in items)


def require_type(given: Item, kind: type[Item], what: str) -> Item:
    """Return the object, if it is of the type; else InputError."""
    if not isinstance(given, kind):
        source = f", as {CONSTRUCTORS[kind.__name__]} gives one" if kind.__name__ in CONSTRUCTORS else ""
        raise InputError(f"{what}: expected a {kind.__name__}{source}; got {_shown(given)}")
    return given


def paths_of(given: Paths, what: str) -> tuple[Path, ...]:
    """Return one path or a sequence of paths as a tuple; InputError for another type."""
    items = given if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
    for item in items:
        if not isinstance(item, str | Path):
            raise InputError(f"{what}: expected paths, got {_shown(item)}")
    return tuple(map(Path, items))


def names_of(given: str | Sequence[str], what: str) -> tuple[str, ...]:
    """Return one name or a sequence of names as a tuple; InputError for another type."""
    return require_all(given, str, what)


def _shown(given: object) -> str:
    text = repr(given)
    return f"{type(given).__name__} {text}" if len(text) <= 60 else type(given).__name__
