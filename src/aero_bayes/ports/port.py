"""A port: a place in a model where a term may be missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from aero_bayes.language.syntax import Call, Expression, parse_reference
from aero_bayes.language.tokens import SourceLocation
from aero_bayes.ports.balance import Balance
from aero_bayes.ports.replaceable import ReplaceableModel

PortKind = Literal["input", "output", "reading", "motion", "storage", "electrical", "replaceable"]
Attachment = Literal["input", "output", "signal", "equation", "node", "series", "redeclare"]

#: Units of a temperature, with the absolute zero in each.
KELVIN: Mapping[str, float] = {"K": 0.0, "degC": -273.15, "Cel": -273.15}


@dataclass(frozen=True)
class Port:
    """A place in a model where a term may be missing."""

    id: str
    kind: PortKind
    attachment: Attachment
    unit: str
    units: Mapping[str, str]
    place: SourceLocation | None
    states: tuple[str, ...] = ()
    signals: Mapping[str, str] = field(default_factory=dict)
    balance: Balance | None = None
    connectors: tuple[str, ...] = ()
    flow: str = ""
    potential: str = ""
    neighbours: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    defining_equation: int | None = None
    replaceable: ReplaceableModel | None = None
    counts: bool = False


#: Separates the two variables of a difference.
DIFFERENCE = " - "


def signal_expression(given: str) -> Expression:
    """Return the expression of a variable, or of the difference of two."""
    one, minus, other = given.partition(DIFFERENCE)
    return Call("-", (parse_reference(one), parse_reference(other))) if minus else parse_reference(one)


def port_table(ports: Sequence[Port]) -> list[dict[str, object]]:
    """Return the ports as rows for a table or JSON: id, kind, unit, file, line, states, laws."""
    return [
        {
            "id": p.id,
            "kind": p.kind,
            "unit": p.unit,
            "file": p.place.file if p.place else "",
            "line": p.place.line if p.place else 0,
            "states": list(p.states),
            "laws": list(p.laws),
        }
        for p in ports
    ]
