"""Results as plain values: what JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator

from aero_bayes.arrays import FloatArray


def number(value: float | None) -> float:
    """Return a number that JSON has, NaN for null."""
    return math.nan if value is None else value


#: A number of a result, which JSON has as null where it is not finite.
Number = Annotated[float, Field(allow_inf_nan=True), BeforeValidator(number)]
#: Numbers of a result, which JSON has as a list.
Numbers = Annotated[FloatArray, PlainValidator(lambda values: np.asarray(values, dtype=np.float64))]
#: Metadata of a field that JSON leaves out, and of a tuple of objects with names that it has as a table by name.
INTERNAL, BY_NAME = {"internal": True}, {"by_name": True}


def named(table: Any) -> Any:
    """Return a table of JSON by name with the name in each row, from which an object that holds it is read."""
    return {name: {"name": name, **row} if isinstance(row, Mapping) else row for name, row in table.items()}


Item = TypeVar("Item")
#: A table by name of objects that hold their name; and such objects in their order, which JSON has as that table.
ByName = Annotated[dict[str, Item], BeforeValidator(named)]
Rows = Annotated[tuple[Item, ...], BeforeValidator(lambda given: list(named(given).values()))]


#: A number of a result, null where it is not finite.
JsonNumber = float | None


class JsonTable(BaseModel):
    """A table of the result. Keys that are not named here are kept."""

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True, allow_inf_nan=False)


def plain(value: Any) -> Any:
    """Convert a value to types that JSON has; of a dataclass the fields, as their metadata say."""
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        told = {f: getattr(value, f.name) for f in fields(value) if "internal" not in f.metadata}
        return {f.name: plain(_by_name(own) if "by_name" in f.metadata else own) for f, own in told.items()}
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


def _by_name(items: Iterable[Any]) -> dict[str, Any]:
    return {item.name: item for item in items}


def picked(table: type[JsonTable], thing: object, **given: object) -> dict[str, Any]:
    """Return the keys of a table as plain values: those given, else attributes of that name where there are any."""
    own = {key: getattr(thing, key) for key in table.model_fields if key not in given and hasattr(thing, key)}
    found: dict[str, Any] = plain(own | given)
    return found
