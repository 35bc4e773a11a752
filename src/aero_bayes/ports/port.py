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
    """A place in a model where a term may be missing.

    Attributes
    ----------
    id : str
        Name of the input, output or state; at a connection the name of the connector. If a state has the name of an
        output, the port at the output is ``output_<name>``. If there is a port at the node of a connector, the port in
        series before it is ``series_<connector>``.
    kind : str
        Kind of law: ``input``, ``output``, ``reading`` (an output whose derivative is not known), ``motion``,
        ``storage``, ``electrical`` or ``replaceable``.
    attachment : str
        How a law is attached: at an ``input``, an ``output`` or an internal ``signal``, as a term in an ``equation``,
        as an element at a ``node`` or in ``series``, or by a ``redeclare`` of a replaceable model.
    unit : str
        Unit of a law's output: of a force, a flow, a voltage, or the signal itself. Empty if unknown.
    units : mapping
        Units of the variables of a law, such as ``v`` and ``x``.
    place : SourceLocation, optional
        File and line of the declaration or the equation.
    states : tuple of str
        Names of the states in the equation.
    signals : mapping
        The inputs of a law by the names in its partial model: a variable of the flat model, or the difference of two
        (:func:`signal_expression`).
    balance : Balance, optional
        The balance equation that a term enters.
    connectors : tuple of str
        At a connection, its connectors; the first is the one of the port.
    flow, potential : str
        Local names of the flow variable and the potential of the connectors.
    neighbours : tuple of str
        For a storage, the ids of other storages of the same unit; those come first whose balance has a state in common.
        For a port between two motions, the other motion, on which the reaction acts.
    laws : tuple of str
        Ids of the applicable laws.
    defining_equation : int, optional
        For an internal signal, the index of the equation or connection that defines it.
    replaceable : ReplaceableModel, optional
        The replaceable model.
    counts : bool
        Whether nothing in the balance of a storage depends on its level, which only counts what flows in.
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
