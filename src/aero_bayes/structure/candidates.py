"""Candidates: the laws that can act at the ports of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.units import Dimension, dimension_of_unit
from aero_bayes.structure.balance import DIFFERENCE, KELVIN, Port
from aero_bayes.structure.find import find_ports
from aero_bayes.structure.law import SIGNAL_DEFAULTS, Law
from aero_bayes.unknown_names import closest_name


def ports_with_laws(flat: FlatModel, laws: Sequence[Law] = ()) -> tuple[Port, ...]:
    """Return all ports of a model: inputs, outputs, then balances in the order of their states."""
    return with_applicable_laws(find_ports(flat), laws)


def with_applicable_laws(ports: Iterable[Port], laws: Sequence[Law]) -> tuple[Port, ...]:
    """Return the ports with the ids of the laws that are applicable there."""
    return tuple(replace(p, laws=tuple(law.id for law in laws if _is_applicable(law, p))) for p in ports)


#: What cannot be stored: a speed, an angle, their rates, a force, a torque, a current. A first-order lag of such a
#: quantity has the form of a storage, but nothing leaks from it or spills.
NO_AMOUNTS: tuple[Dimension, ...] = (
    {"m": 1.0, "s": -1.0}, {"rad": 1.0, "s": -1.0}, {"rad": 1.0}, {"m": 1.0, "s": -2.0}, {"rad": 1.0, "s": -2.0},
    {"kg": 1.0, "m": 1.0, "s": -2.0}, {"kg": 1.0, "m": 2.0, "s": -2.0}, {"A": 1.0},
)  # fmt: skip
#: Share of a signal's largest magnitude by which it must pass zero to count as having a sign: readings have noise.
MIN_SIGN_SHARE = 0.05
#: Share of a signal's range that must be visited twice for a curve over it: over a signal that never comes back a curve
#: is one over time, and explains whatever a moment needs.
MIN_SHARE_VISITED_TWICE = 0.5


def has_reaction(law: Law, port: Port) -> bool:
    """Return whether a law at a port acts on the neighbour of the port as well."""
    return law.kind in ("overflow", "exchange") or port.kind == "motion"


def _is_applicable(law: Law, port: Port) -> bool:
    """Return whether a law can act at a port, by its kind, the signals that it reads and the units that it needs."""
    if port.replaceable is not None:
        return law.kind == "replaceable" and law.constraint == port.replaceable.constraint
    excluded = law.excluded_units.split()
    if "h_s" in port.signals:
        # over recorded surroundings a temperature is a difference, whatever its zero
        excluded = [unit for unit in excluded if KELVIN.get(unit, 0.0) == 0.0]
    if any(_matches_unit(unit, other) for other in excluded for unit in port.units.values()):
        return False
    if port.kind == "storage" and (_is_no_amount(port, law) or (port.counts and law.has_states)):
        return False
    if law.absolute and port.signals.get(law.absolute) not in port.states and not (port.balance and port.balance.force):
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


def _is_no_amount(port: Port, law: Law) -> bool:
    """Return whether the level at a port cannot be stored, so that no law of a storage depends on it."""
    reads_level = bool(law.used_inputs - SIGNAL_DEFAULTS.keys()) and not law.curve_input
    return reads_level and dimension_of_unit(port.units.get("h", "")) in NO_AMOUNTS


def is_possible(law: Law, nominals: Mapping[str, float]) -> bool:
    """Return whether a law can be, and be seen, in the range that the signals of a port visit."""
    if law.curve_input and nominals.get(f"{law.curve_input}_twice", 1.0) < MIN_SHARE_VISITED_TWICE:
        return False
    for signal, wanted in ((law.both_signs, "both"), (law.nonnegative, "one")):
        if not signal or f"{signal}_low" not in nominals:
            continue
        low, high = nominals[f"{signal}_low"], nominals[f"{signal}_high"]
        passed = MIN_SIGN_SHARE * max(abs(low), abs(high))
        if (low < -passed) is not (wanted == "both") or (wanted == "both" and high <= passed):
            return False
    return True


def _is_against_input(port: Port) -> bool:
    """Return whether a motion is relative to an input, such as the wind, on which no reaction acts."""
    return not port.neighbours and any(DIFFERENCE in given for given in port.signals.values())


def _matches_unit(unit: str, asked: str) -> bool:
    """Return whether a unit is the required one. ``K`` stands for any unit of temperature."""
    return unit == asked or (asked == "K" and unit in KELVIN)


@dataclass(frozen=True)
class Candidate:
    """A law that may act at a port.

    ``neighbour`` is the port that receives an exchanged or overflowing quantity, or the reaction of a force.
    ``alias`` is a declared name."""

    law: Law
    port: Port
    neighbour: Port | None = None
    alias: str = ""

    @property
    def id(self) -> str:
        """The alias, or ``law@port``."""
        return self.alias or f"{self.law.id}@{self.port.id}"


def find_candidates(ports: Sequence[Port], laws: Sequence[Law]) -> tuple[Candidate, ...]:
    """Return every applicable law at every port, port by port.

    An exchange between two storages is listed once. It and an overflow go to the first neighbour."""
    by_id = {p.id: p for p in ports}
    found: list[Candidate] = []
    joined: set[frozenset[str]] = set()
    for port in ports:
        first = by_id.get(port.neighbours[0]) if port.neighbours else None
        for law in (law for law in laws if _is_applicable(law, port)):
            neighbour = first if has_reaction(law, port) else None
            if law.kind == "exchange":
                pair = frozenset((port.id, *port.neighbours[:1]))
                if pair in joined:
                    continue
                joined.add(pair)
            found.append(Candidate(law, port, neighbour))
    return tuple(found)


def declared_candidates(found: Sequence[Candidate], declared: PackageDeclaration) -> tuple[Candidate, ...]:
    """Return the effects that a package declares, under their names, and learned curves in its replaceable models."""
    known = {c.id: c for c in found}
    for name, effect in declared.effects.items():
        if effect.law not in known:
            close = closest_name(effect.law, known, cutoff=0.0)
            hint = f"; did you mean {close!r}?" if close is not None else ""
            raise InputError(f"{declared.package}: effects.{name}.law: there is no {effect.law!r}{hint}")
    named = [replace(known[effect.law], alias=name) for name, effect in declared.effects.items()]
    return (*named, *(c for c in found if c.port.replaceable is not None and c.law.curve_input))
