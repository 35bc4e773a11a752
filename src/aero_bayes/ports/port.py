"""Where a term may be missing in a model."""

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
    """A place in a model where a term may be missing.

    Attributes
    ----------
    id : str
        The input, output or state; at a connection the connector. An output that is a state itself is
        ``output_<name>``, because the name stands for the balance; a drop before a connector that is a node itself
        is ``series_<connector>``.
    kind : str
        What acts there: ``input``, ``output``, ``reading`` (an output whose rate nothing gives), ``motion``,
        ``storage``, ``electrical`` or ``replaceable``.
    via : str
        How a law is tied in: at an ``input``, an ``output`` or a ``signal`` within, as a term in an ``equation``, as an
        element at a ``node`` or in ``series`` in a connection, or by a ``redeclare`` of a replaceable model.
    unit : str
        Of what a law gives there: a force, a flow, a voltage, or the signal itself. Empty where nothing tells.
    units : mapping
        Unit of each signal of a law by its name there, such as ``v`` and ``x``.
    place : SourceLocation, optional
        File and line of the declaration or the equation.
    states : tuple of str
        Names of the states that act there.
    signals : mapping
        What a law is given there by the names of its partial model, as variables of the flat model, or as the
        difference of two (:func:`signal_of`).
    entrance : Entrance, optional
        The equation in which an opposing term enters, and with which factor.
    connectors : tuple of str
        At a connection, the connectors that it joins; the first is the port's own.
    flow, potential : str
        Names of the connectors' flow variable and potential.
    neighbours : tuple of str
        Of a storage the ids of those of the same unit, those first whose balance has a state in common; of a place
        between two motions the other one, whose balance takes the reaction.
    laws : tuple of str
        Ids of the laws that fit.
    given : int, optional
        Of a signal, the equation that gives it, or the connection.
    replaceable : Replaceable, optional
        The replaceable model.
    """

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


#: What stands between the two variables of a difference.
DIFFERENCE = " - "


def signal_expression(given: str) -> Expression:
    """What a law is given: a variable, or the difference of two."""
    one, minus, other = given.partition(DIFFERENCE)
    return Call("-", (parse_reference(one), parse_reference(other))) if minus else parse_reference(one)


def port_table(ports: Sequence[Port]) -> list[dict[str, object]]:
    """The ports as rows for a table or JSON: id, kind, unit, file, line, states, laws."""
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
