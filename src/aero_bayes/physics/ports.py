"""Where a term may be missing in a model, and which laws can act there."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from aero_bayes.declared import Declaration
from aero_bayes.errors import InputError
from aero_bayes.export.flat import Place
from aero_bayes.export.syntax import Call, Expression, reference
from aero_bayes.physics.entrance import Entrance
from aero_bayes.physics.laws import STANDING, Law, snake_case
from aero_bayes.physics.replaceable import Replaceable

PortKind = Literal["input", "output", "reading", "motion", "storage", "electrical", "replaceable"]
Via = Literal["input", "output", "signal", "equation", "node", "series", "redeclare"]

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
    place : Place, optional
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
    via: Via
    unit: str
    units: Mapping[str, str]
    place: Place | None
    states: tuple[str, ...] = ()
    signals: Mapping[str, str] = field(default_factory=dict)
    entrance: Entrance | None = None
    connectors: tuple[str, ...] = ()
    flow: str = ""
    potential: str = ""
    neighbours: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    given: int | None = None
    replaceable: Replaceable | None = None


#: What stands between the two variables of a difference.
MINUS = " - "


def signal_of(given: str) -> Expression:
    """What a law is given: a variable, or the difference of two."""
    one, minus, other = given.partition(MINUS)
    return Call("-", (reference(one), reference(other))) if minus else reference(one)


def reacts(law: Law, port: Port) -> bool:
    """Whether a law at a port acts on a neighbour, too."""
    return law.kind in ("overflow", "exchange") or port.kind == "motion"


def fits(law: Law, port: Port) -> bool:
    """Whether a law can act at a port: its kind, the signals it needs, the unit that it asks for."""
    if port.replaceable is not None:
        return law.kind == "replaceable" and law in port.replaceable.laws
    if any(_is_unit(unit, other) for other in law.not_for.split() for unit in port.units.values()):
        return False
    # what does not ask for the surroundings is the same whatever they are
    if not port.signals.keys() & STANDING.keys() <= law.uses or (_against(port) and not law.uses):
        return False
    if law.kind in ("overflow", "exchange"):
        return port.kind == "storage" and (law.kind == "overflow" or bool(port.neighbours))
    same = law.kind == port.kind or (port.kind == "reading" and law.kind == "output" and not law.takes_rate)
    if not same or not law.uses - STANDING.keys() <= port.signals.keys():
        return False
    return all(_is_unit(port.units.get(signal, ""), unit) for signal, unit in law.needs_unit.items())


def _against(port: Port) -> bool:
    """Whether a motion is taken against what is fed in, on which nothing reacts."""
    return not port.neighbours and any(MINUS in given for given in port.signals.values())


def _is_unit(unit: str, asked: str) -> bool:
    """Whether a unit is the one asked for; ``K`` asks for any temperature."""
    return unit == asked or (asked == "K" and unit in KELVIN)


@dataclass(frozen=True)
class Candidate:
    """A law that may act at a port; ``neighbour`` is where what is lost may go, or what takes the reaction.

    ``alias`` is another name that it goes by.
    """

    law: Law
    port: Port
    neighbour: Port | None = None
    alias: str = ""

    @property
    def id(self) -> str:
        """``law@port``, or its alias."""
        return self.alias or f"{self.law.id}@{self.port.id}"


def candidates(ports: Sequence[Port], laws: Sequence[Law]) -> tuple[Candidate, ...]:
    """Every law at every port that it fits, port by port.

    An exchange between two storages counts once; it and what overflows go to the first neighbour.
    """
    by_id = {p.id: p for p in ports}
    found: list[Candidate] = []
    joined: set[frozenset[str]] = set()
    for port in ports:
        first = by_id.get(port.neighbours[0]) if port.neighbours else None
        for law in (law for law in laws if fits(law, port)):
            neighbour = first if reacts(law, port) else None
            if law.kind == "exchange":
                pair = frozenset((port.id, *port.neighbours[:1]))
                if pair in joined:
                    continue
                joined.add(pair)
            found.append(Candidate(law, port, neighbour))
    return tuple(found)


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


def replaceable_ports(found: Sequence[Replaceable], names: Mapping[str, str]) -> tuple[Port, ...]:
    """A port for each replaceable model: by the name that it is given, unless several share that, or in snake case."""
    own = [snake_case(one.name) for one in found]
    given = [names.get(name, name) for name in own]
    ids = [to if given.count(to) == 1 else name for name, to in zip(own, given, strict=True)]
    return tuple(
        Port(
            id_, "replaceable", "redeclare", "", {}, one.place, laws=tuple(law.id for law in one.laws), replaceable=one
        )
        for id_, one in zip(ids, found, strict=True)
    )


def listed(found: Sequence[Candidate], declared: Declaration) -> tuple[Candidate, ...]:
    """The effects that a package names, under their names, and learned curves in its replaceable models.

    Raises
    ------
    InputError
        For an effect whose law there is not.
    """
    known = {c.id: c for c in found}
    for name, effect in declared.effects.items():
        if effect.law not in known:
            near = difflib.get_close_matches(effect.law, known, n=1, cutoff=0.0)
            nearest = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"{declared.package}: effects.{name}.law: there is no {effect.law!r}{nearest}")
    named = [replace(known[effect.law], alias=name) for name, effect in declared.effects.items()]
    return (*named, *(c for c in found if c.port.replaceable is not None and c.law.learned))
