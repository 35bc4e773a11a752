"""Names of formulas in a result: the chosen one at a port is ``formula@port``, whatever number the search gave it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import TypeVar, cast

from aero_bayes.laws.formula import FORMULA, FUNCTION
from aero_bayes.loop.result import LoopResult

T = TypeVar("T")

#: Where a result names terms.
_TOLD = ("sentence", "effects", "smaller", "equivalent", "steps", "separate", "story", "words", "averaged")


def with_plain_names(result: LoopResult) -> LoopResult:
    """Return the result with the first chosen formula at each port as ``formula@port``, in place of that one."""
    names: dict[str, str] = {}
    for effect in result.effects:
        plain = f"{FORMULA}@{effect.id.rpartition('@')[2]}"
        if effect.text and plain not in names:
            names |= {effect.id: plain, plain: effect.id}
    if all(name == new for name, new in names.items()):
        return result

    def renamed(text: str) -> str:
        return re.sub(rf"\b({FORMULA}|{FUNCTION})(_\d+)?@[\w.]*\w", lambda m: names.get(m[0], m[0]), text)

    told = {key: _mapped(getattr(result, key), renamed) for key in _TOLD}
    return replace(result, **told)


def _mapped(value: T, change: Callable[[str], str]) -> T:
    """Return the same value with all its texts changed."""
    found: object = value
    if isinstance(value, str):
        found = change(value)
    elif isinstance(value, tuple):
        found = tuple(_mapped(item, change) for item in value)
    elif isinstance(value, Mapping):
        found = {_mapped(key, change): _mapped(item, change) for key, item in value.items()}
    elif is_dataclass(value) and not isinstance(value, type):
        found = replace(value, **{f.name: _mapped(getattr(value, f.name), change) for f in fields(value) if f.init})
    return cast(T, found)
