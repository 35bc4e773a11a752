"""Names and what they stand for, in an equation or in the body of a function."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from aero_bayes.export import arrays
from aero_bayes.export.arrays import Record, Value


class NameTable:
    """Values by name, and the records whose fields are variables of their own."""

    def __init__(self, values: dict[str, Value], records: Mapping[str, tuple[str, ...]]) -> None:
        self.values = values
        self.records = records
        self._families: dict[str, list[str]] | None = None

    def named(self, name: str) -> Value:
        """Return the value of a name: a variable, a record, a field of one, or that field of an array of records."""
        if name in self.values:
            return self.values[name]
        if name in self.records:
            return Record(self.records[name], [self.named(f"{name}.{f}") for f in self.records[name]])
        owner, dot, last = name.rpartition(".")
        if dot and isinstance(whole := self.values.get(owner), Record) and last in whole.names:
            return whole.field(last)
        members = self._family(name)
        if members:
            return [self.named(m) for m in members]
        raise KeyError(name)

    def _family(self, name: str) -> list[str]:
        """Return names such as ``r[1].v``, ``r[2].v`` that ``r.v`` stands for, in order."""
        if self._families is None:
            self._families = {}
            for n in self.values:
                plain = re.sub(r"\[\d+\]", "", n, count=1)
                if plain != n:
                    self._families.setdefault(plain, []).append(n)
        return self._families.get(name, [])

    def assign(self, name: str, indices: Sequence[int], value: Value) -> None:
        """Give a name, or the element at `indices` of an array, another value."""
        owner, dot, last = name.rpartition(".")
        if dot and isinstance(whole := self.values.get(owner), Record) and not indices:
            at = whole.names.index(last)
            self.values[owner] = Record(whole.names, [value if i == at else v for i, v in enumerate(whole)])
            return
        self.values[name] = arrays.replaced(self.values[name], indices, value) if indices else value
