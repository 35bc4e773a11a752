"""Candidates: the laws that can act at the ports of a model, and laws that are placed there, with names and values."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.laws.balance import KELVIN, LOAD, Port, Signal
from aero_bayes.laws.find import find_ports
from aero_bayes.laws.law import SIGNAL_DEFAULTS, Law, LawParameter
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.units import Dimension, dimension_of_unit
from aero_bayes.unknown_names import closest_name


def ports_with_laws(flat: FlatModel, laws: Sequence[Law] = ()) -> tuple[Port, ...]:
    """Return all ports of a model: inputs, outputs, then balances in the order of their states."""
    known = {v.name for v in flat.variables}
    ports = [replace(p, signals={**_further_signals(p, laws, known), **p.signals}) for p in find_ports(flat)]
    return with_applicable_laws(ports, laws)


def with_applicable_laws(ports: Iterable[Port], laws: Sequence[Law]) -> tuple[Port, ...]:
    """Return the ports with the ids of the laws that are applicable there."""
    return tuple(replace(p, laws=tuple(law.id for law in laws if _is_applicable(law, p))) for p in ports)


def _further_signals(port: Port, laws: Iterable[Law], known: Collection[str]) -> dict[str, Signal]:
    """Return what laws read besides: the variables of these names in the component whose signal the port has."""
    owner = str(next(iter(port.signals.values()))).rpartition(".")[0]
    names = dict.fromkeys(n for law in laws if law.kind == port.kind for n in law.further_inputs)
    there = {n: f"{owner}.{n}" if owner else n for n in names}
    return {n: Signal.of(path) for n, path in there.items() if path in known}


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
    excluded = law.excluded_units.split()
    if "h_s" in port.signals:
        # over recorded surroundings a temperature is a difference, whatever its zero
        excluded = [unit for unit in excluded if KELVIN.get(unit, 0.0) == 0.0]
    if any(_matches_unit(unit, other) for other in excluded for unit in port.units.values()):
        return False
    if port.kind == "storage" and (_is_no_amount(port, law) or (port.counts and law.has_states)):
        return False
    level = str(port.signals.get(law.absolute, ""))
    if law.absolute and level not in port.states and not (port.balance and port.balance.force):
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
    return not port.neighbours and any(len(given.parts) > 1 for name, given in port.signals.items() if name != LOAD)


def _matches_unit(unit: str, asked: str) -> bool:
    """Return whether a unit is the required one. ``K`` stands for any unit of temperature."""
    return unit == asked or (asked == "K" and unit in KELVIN)


@dataclass(frozen=True)
class Candidate:
    """A law that may act at a port.

    ``neighbour`` is the port that receives an exchanged or overflowing quantity, or the reaction of a force.
    ``alias`` is a declared name, ``sizes`` are declared nominal values. ``twins`` are the same law at like places, with
    the same parameters."""

    law: Law
    port: Port
    neighbour: Port | None = None
    alias: str = ""
    twins: tuple[Self, ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """The alias, or ``law@port``; ``law@one+other`` with a twin."""
        return self.alias or f"{self.law.id}@{self.place}"

    @property
    def parts(self) -> tuple[Self, ...]:
        """It and its twins."""
        return (self, *self.twins)

    @property
    def place(self) -> str:
        """The ids of the ports where it acts."""
        return "+".join(c.port.id for c in self.parts)


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


def with_twins(found: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Return the candidates, and each law at once at all like places of a model, as two heaters and their sensors are.

    Places are alike if they have the same kind, units and laws. A curve has too many parameters to share them, and what
    an input was before a recording begins is its own."""
    alike: dict[tuple[object, ...], list[Candidate]] = {}
    for c in found:
        law, port = c.law, c.port
        own = law.kind == "exchange" or law.curve_input or (port.kind == "input" and (law.delay or law.starts))
        if not own:
            units = tuple(sorted(port.units.items()))
            key = (law.id, port.kind, port.attachment, units, port.laws, c.neighbour is None)
            alike.setdefault(key, []).append(c)
    return (*found, *(replace(one, twins=tuple(more)) for one, *more in alike.values() if more))


def declared_candidates(found: Sequence[Candidate], declared: PackageDeclaration) -> tuple[Candidate, ...]:
    """Return the effects that a package declares, under their names: a law at once at all ports that ``law`` names.

    These are ids or names, joined by ``+``; those that the model does not have are left out."""
    known: dict[str, list[Candidate]] = {}
    for c in found:
        for place in {c.port.id, declared.ports.get(c.port.id, c.port.id)}:
            known.setdefault(f"{c.law.id}@{place}", []).append(c)
    named: list[Candidate] = []
    for name, effect in declared.effects.items():
        law, _, places = effect.law.partition("@")
        parts = [c for place in places.split("+") for c in known.get(f"{law}@{place}", ())]
        if not parts:
            close = closest_name(effect.law, known, cutoff=0.0)
            hint = f"; did you mean {close!r}?" if close is not None else ""
            raise InputError(f"{declared.package}: effects.{name}.law: there is no {effect.law!r}{hint}")
        if len({c.law.kind for c in parts}) > 1:
            raise InputError(f"{declared.package}: effects.{name}.law: {effect.law!r} names laws of several kinds")
        named.append(replace(parts[0], alias=name, twins=tuple(parts[1:]), sizes=effect.sizes))
    return tuple(named)


@dataclass(frozen=True)
class PlacedLaw(Candidate):
    """A law at a port, under names in a model."""

    instance: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    nominals: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    moved_input: str = ""
    is_twin: bool = False

    @property
    def has_states(self) -> bool:
        """Whether it adds states to the model."""
        return self.law.has_states and not self.moved_input

    @property
    def all_nominals(self) -> dict[str, float]:
        """The nominal values, with defaults of those that are not given."""
        return {**self.law.nominals, **{k: float(v) for k, v in self.nominals.items() if k in self.law.nominals}}

    @property
    def signal_defaults(self) -> dict[str, float]:
        """Values of inputs of the law that the port does not have."""
        own = {
            s: n for s, n in SIGNAL_DEFAULTS.items() if s in self.law.interface.inputs and s not in self.port.signals
        }
        return {signal: self.all_nominals[nominal] for signal, nominal in own.items()}

    def parameters(self) -> Iterator[LawParameter]:
        """Return the fitted parameters. The share of a neighbour is one of them only if there is a neighbour."""
        return (p for p in (*self.law.parameters, *self.law.starts) if p.name in self.names)

    def value(self, p: LawParameter) -> float:
        return float(self.values.get(p.name, p.value("default", self.all_nominals)))

    def limits(self, p: LawParameter) -> dict[str, float]:
        """Return the attributes ``min``, ``max`` and ``nominal``, as far as they are declared."""
        found = {k: p.value(k, self.all_nominals) for k in ("min", "max", "nominal") if k in p.terms}
        return {k: v for k, v in found.items() if math.isfinite(v)}

    def about(self, p: LawParameter) -> str:
        """Return the description of a parameter in the model."""
        return f"{p.description} at {in_words(self.place)}"

    def declarations(self) -> Iterator[str]:
        """Yield Modelica declarations of the fitted parameters in the model; a twin has those of another law."""
        for p in () if self.is_twin else self.parameters():
            attributes = [f'unit = "{self.unit(p)}"'] if self.unit(p) else []
            attributes += [f"{k} = {v:.6g}" for k, v in self.limits(p).items()]
            given = f"({', '.join(attributes)}) = {self.value(p)!r}"
            yield f'parameter Real {self.names[p.name]}{given} "{self.about(p)}";'

    def unit(self, p: LawParameter) -> str:
        """Return the unit of a parameter, from the units of the port."""
        signals = {**self.port.units, "h_1": self.port.units.get("h", "")}
        if signals.get("v") and not signals.get("x"):
            signals["x"] = f"s.{signals['v']}"
        units = {nominal: signals.get(signal, "") for nominal, signal in self.law.interface.nominals.items()}
        return p.unit({**units, "t_n": "s", "w_n": "1"})


def place_law(
    c: Candidate,
    taken: Collection[str],
    *,
    nominals: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    with_starts: bool = False,
) -> PlacedLaw:
    """Place a law at a port, under names that are not in use: ``F_c``, or ``F_c_v`` if that is in use."""
    law, port = c.law, c.port
    if law.kind == "exchange" and c.neighbour is None:
        raise InputError(f"{law.id}@{port.id}: an exchange needs a neighbour")
    neighbour = c.neighbour if has_reaction(law, port) else None
    used = {n.partition(".")[0] for n in taken}
    alias = identifier(c.alias.partition("@")[0])

    def free(name: str, place: str = alias or c.place) -> str:
        suffix = identifier(place)
        candidates = [name, f"{name}_{suffix}", *(f"{name}_{suffix}_{k}" for k in range(2, 100))]
        chosen = next(c for c in candidates if c not in used)
        used.add(chosen)
        return chosen

    fitted = [p.name for p in law.parameters if p.name != "share" or neighbour is not None]
    fitted += [p.name for p in law.starts if with_starts]
    names = {p: free(p) for p in fitted}
    # a nominal value is an order of magnitude: three digits are enough in a written model
    given = {**(nominals or {}), **c.sizes}
    rounded = {k: float(f"{v:.3g}") if k.endswith("_n") else float(v) for k, v in given.items()}
    own = PlacedLaw(
        law, port, neighbour, c.alias, (), c.sizes, free(alias or law.id), names, rounded, dict(values or {})
    )
    twins = [
        replace(own, port=t.port, neighbour=t.neighbour, instance=free(law.id, t.port.id), is_twin=True)
        for t in c.twins
    ]
    return replace(own, twins=tuple(twins))


def place_laws(
    found: Iterable[Candidate],
    taken: Collection[str],
    nominals: Mapping[str, Mapping[str, float]],
    *,
    free_starts: bool = False,
) -> tuple[PlacedLaw, ...]:
    """Place candidates in one model, in the given order; with ``free_starts`` those at inputs start where the data say.

    What an input was before a recording begins is not known; a state of the model itself is estimated anyway."""
    placed_laws: list[PlacedLaw] = []
    used = set(taken)
    for c in found:
        starts = free_starts and c.law.kind == "input"
        known = [nominals.get(one.port.id, {}) for one in c.parts]
        largest = {k: max(n[k] for n in known if k in n) for k in set().union(*known)}
        placed = place_law(c, used, nominals=largest, with_starts=starts)
        placed_laws.append(placed)
        used |= {*(one.instance for one in placed.parts), *placed.names.values()}
    return tuple(placed_laws)


def with_moved_input(placed: PlacedLaw, recorded: Collection[str]) -> PlacedLaw:
    """Return a delay of an input that is among the recorded ones as a move of that input; other laws as they are."""
    signal = str(placed.port.signals.get("u", ""))
    moved = placed.law.delay and placed.port.attachment == "input" and signal in recorded
    return replace(placed, moved_input=signal) if moved else placed


def identifier(path: str) -> str:
    """Return a path as an identifier: ``rotor.a`` becomes ``rotor_a``."""
    return re.sub(r"\W+", "_", path).strip("_")


def describe_law(law: Law, port: Port, where: str = "") -> str:
    """Return a phrase about a law and its port, or about ``where`` it acts."""
    about = law.description
    return f"{about[:1].lower()}{about[1:]} at {in_words(where or port.id)}"


def in_words(place: str) -> str:
    """Return the ids of ports as they stand within a sentence."""
    return place.replace("+", " and ")
