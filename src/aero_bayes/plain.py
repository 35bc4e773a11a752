"""Results as plain values: what JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field


def number(value: float | None) -> float:
    """Return a number that JSON has, not a number where that is null."""
    return math.nan if value is None else value


#: A number of a result, which JSON has as null where it is not finite.
Number = Annotated[float, Field(allow_inf_nan=True), BeforeValidator(number)]


def named(table: Any) -> Any:
    """Return a table of JSON by name with the name in each row, from which an object that holds it is read."""
    return {name: {"name": name, **row} if isinstance(row, Mapping) else row for name, row in table.items()}


Item = TypeVar("Item")
#: A table by name of objects that hold their name.
ByName = Annotated[dict[str, Item], BeforeValidator(named)]


def plain(value: Any) -> Any:
    """Convert a value to types that JSON has; of a dataclass its fields, or the attributes that ``JSON_KEYS`` names."""
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        keys = value.JSON_KEYS.split() if hasattr(value, "JSON_KEYS") else [field.name for field in fields(value)]
        return {key: plain(getattr(value, key)) for key in keys}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return value.name
    return value


def picked(thing: object, names: str, **more: object) -> dict[str, Any]:
    """Return some attributes of an object by name, as plain values; and ``more``."""
    found: dict[str, Any] = plain({name: getattr(thing, name) for name in names.split()} | more)
    return found
