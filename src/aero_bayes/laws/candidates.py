"""Candidates: the laws that can act at the ports of a model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.export.flat import FlatModel
from aero_bayes.laws.law import SIGNAL_DEFAULTS, Law
from aero_bayes.ports import DIFFERENCE, KELVIN, Port, find_ports
from aero_bayes.unknown_names import closest_name


def ports_with_laws(flat: FlatModel, laws: Sequence[Law] = ()) -> tuple[Port, ...]:
    """All ports of a model: inputs, outputs, then balances in the order of their states.

    Parameters
    ----------
    flat : FlatModel
        The model. See :func:`~aero_bayes.ports.find.find_ports`.
    laws : sequence of Law
        Laws that :attr:`Port.laws` may name.
    """
    return with_applicable_laws(find_ports(flat), laws)


def with_applicable_laws(ports: Iterable[Port], laws: Sequence[Law]) -> tuple[Port, ...]:
    """The ports with the ids of the laws that are applicable there."""
    return tuple(replace(p, laws=tuple(law.id for law in laws if is_applicable(law, p))) for p in ports)


def has_reaction(law: Law, port: Port) -> bool:
    """Whether a law at a port acts on the neighbour of the port as well."""
    return law.kind in ("overflow", "exchange") or port.kind == "motion"


def is_applicable(law: Law, port: Port) -> bool:
    """Whether a law can act at a port, by its kind, the signals that it reads and the units that it needs."""
    if port.replaceable is not None:
        return law.kind == "replaceable" and law.constraint == port.replaceable.constraint
    if any(_matches_unit(unit, other) for other in law.excluded_units.split() for unit in port.units.values()):
        return False
    # a law that does not read the ambient value would be the same law at the port without it
    if not port.signals.keys() & SIGNAL_DEFAULTS.keys() <= law.used_inputs or (
        _is_against_input(port) and not law.used_inputs
    ):
        return False
    if law.kind in ("overflow", "exchange"):
        return port.kind == "storage" and (law.kind == "overflow" or bool(port.neighbours))
    same = law.kind == port.kind or (port.kind == "reading" and law.kind == "output" and not law.needs_derivative)
    if not same or not law.used_inputs - SIGNAL_DEFAULTS.keys() <= port.signals.keys():
        return False
    return all(_matches_unit(port.units.get(signal, ""), unit) for signal, unit in law.required_units.items())


def _is_against_input(port: Port) -> bool:
    """Whether a motion is relative to an input, such as the wind, on which no reaction acts."""
    return not port.neighbours and any(DIFFERENCE in given for given in port.signals.values())


def _matches_unit(unit: str, asked: str) -> bool:
    """Whether a unit is the required one. ``K`` stands for any unit of temperature."""
    return unit == asked or (asked == "K" and unit in KELVIN)


@dataclass(frozen=True)
class Candidate:
    """A law that may act at a port.

    ``neighbour`` is the port that receives an exchanged or overflowing quantity, or the reaction of a force.
    ``alias`` is a declared name.
    """

    law: Law
    port: Port
    neighbour: Port | None = None
    alias: str = ""

    @property
    def id(self) -> str:
        """The alias, or ``law@port``."""
        return self.alias or f"{self.law.id}@{self.port.id}"


def find_candidates(ports: Sequence[Port], laws: Sequence[Law]) -> tuple[Candidate, ...]:
    """Every applicable law at every port, port by port.

    An exchange between two storages is listed once. It and an overflow go to the first neighbour.
    """
    by_id = {p.id: p for p in ports}
    found: list[Candidate] = []
    joined: set[frozenset[str]] = set()
    for port in ports:
        first = by_id.get(port.neighbours[0]) if port.neighbours else None
        for law in (law for law in laws if is_applicable(law, port)):
            neighbour = first if has_reaction(law, port) else None
            if law.kind == "exchange":
                pair = frozenset((port.id, *port.neighbours[:1]))
                if pair in joined:
                    continue
                joined.add(pair)
            found.append(Candidate(law, port, neighbour))
    return tuple(found)


def declared_candidates(found: Sequence[Candidate], declared: PackageDeclaration) -> tuple[Candidate, ...]:
    """The effects that a package declares, under their names, and learned curves in its replaceable models.

    Raises
    ------
    InputError
        For an effect with a law that is not among the candidates.
    """
    known = {c.id: c for c in found}
    for name, effect in declared.effects.items():
        if effect.law not in known:
            close = closest_name(effect.law, known, cutoff=0.0)
            hint = f"; did you mean {close!r}?" if close is not None else ""
            raise InputError(f"{declared.package}: effects.{name}.law: there is no {effect.law!r}{hint}")
    named = [replace(known[effect.law], alias=name) for name, effect in declared.effects.items()]
    return (*named, *(c for c in found if c.port.replaceable is not None and c.law.curve_input))
