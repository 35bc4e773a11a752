"""Checks of arguments: one object or several, each of the right type."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import Field

from aero_bayes.errors import InputError

Item = TypeVar("Item")
#: Numbers with a limit, which a file that gives them is held against.
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(gt=0)]
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
    if not is_of(given, kind):
        source = f", as {CONSTRUCTORS[kind.__name__]} gives one" if kind.__name__ in CONSTRUCTORS else ""
        raise InputError(f"{what}: expected {named_type(kind)}{source}; got {shown(given)}")
    return given


def paths_of(given: Paths, what: str) -> tuple[Path, ...]:
    """Return one path or a sequence of paths as a tuple; InputError for another type."""
    items = given if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
    for item in items:
        if not isinstance(item, str | Path):
            raise InputError(f"{what}: expected paths, got {shown(item)}")
    return tuple(map(Path, items))


def names_of(given: str | Sequence[str], what: str) -> tuple[str, ...]:
    """Return one name or a sequence of names as a tuple; InputError for another type."""
    return require_all(given, str, what)


def is_of(given: object, hint: Any) -> bool:
    """Return whether an object may be of an annotated type; what containers hold is not looked at."""
    if get_origin(hint) in (Union, types.UnionType):
        return any(is_of(given, one) for one in get_args(hint))
    if get_origin(hint) is Literal:
        return isinstance(given, str) and given in get_args(hint)
    if hint in (int, float):
        return isinstance(given, Integral if hint is int else Real) and not isinstance(given, bool)
    kind = get_origin(hint) or hint
    if kind in (tuple, list, Sequence):  # one name may stand for several
        return isinstance(given, Sequence) and (not isinstance(given, str) or get_args(hint)[0] is str)
    if kind is Path:
        return isinstance(given, str | Path)
    return given is None if hint is type(None) else not isinstance(kind, type) or isinstance(given, kind)


def named_type(hint: Any) -> str:
    """Return an annotated type as a message names it."""
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(named_type(one) for one in get_args(hint)))
    if get_origin(hint) is Literal:
        return " or ".join(map(repr, get_args(hint)))
    if hint is type(None):
        return "None"
    plain = {int: "a whole number", float: "a number", bool: "True or False", Mapping: "a mapping"}
    kind = get_origin(hint) or hint
    if kind in (tuple, list, Sequence):
        return "names" if get_args(hint)[0] is str else "a sequence"
    return plain.get(kind) or f"a {kind.__name__}"


def shown(given: object) -> str:
    text = repr(given)
    return f"{type(given).__name__} {text}" if len(text) <= 60 else type(given).__name__
