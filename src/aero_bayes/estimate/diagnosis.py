"""The diagnosis of a fit: which of five causes may be behind a residual that is not noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from aero_bayes.display import table_html

Cause = Literal["data", "solver", "search", "noise", "model"]
#: In this order causes are looked at. The model comes last: it is blamed only where the others are clear.
CAUSES: tuple[Cause, ...] = ("data", "solver", "search", "noise", "model")


@dataclass(frozen=True)
class DiagnosisRow:
    """What was looked at and found of one cause."""

    JSON_KEYS: ClassVar = "cause found what where done more"

    cause: Cause
    found: bool
    what: str
    where: str = ""
    done: str = ""
    explains: bool = False
    more: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The row as text, with its first finding and how many there are beside it."""
        where = f" ({self.where})" if self.where else ""
        return f"{self.what.removesuffix('.')}{where}.{' ' if self.done else ''}{self.done}{more_words(self.more)}"


def more_words(more: Sequence[str]) -> str:
    """Return how many findings a row of a diagnosis has beside its first one."""
    return f" And {len(more)} more, see the diagnosis." if more else ""


@dataclass(frozen=True)
class Diagnosis:
    """The five causes in order, with what was found of each."""

    rows: tuple[DiagnosisRow, ...] = field(default=())

    def __iter__(self) -> Iterator[DiagnosisRow]:
        return iter(self.rows)

    def __getitem__(self, cause: Cause) -> DiagnosisRow:
        return next(row for row in self.rows if row.cause == cause)

    @property
    def first(self) -> DiagnosisRow | None:
        """The first cause that was found; None for a fit without a fault."""
        return next((row for row in self.rows if row.found), None)

    @property
    def explanation(self) -> DiagnosisRow | None:
        """The first cause before the model that may explain a structured residual."""
        return next((row for row in self.rows if row.found and row.explains and row.cause != "model"), None)

    @property
    def line(self) -> str:
        """One line for a terminal: the state of each cause."""
        return "diagnosis: " + ", ".join(f"{row.cause} {'FOUND' if row.found else 'clear'}" for row in self.rows)

    def _repr_html_(self) -> str:
        rows = [
            (r.cause, "found" if r.found else "clear", " ".join((r.what, *r.more)), r.where, r.done) for r in self.rows
        ]
        return table_html(("cause", "", "what", "where", "done"), rows, "Diagnosis")

    def __repr__(self) -> str:
        return f"<{self.line[:1].upper()}{self.line[1:]}>"
