"""A law placed at a port, with its names and values in a model."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.structure.balance import Port
from aero_bayes.structure.candidates import Candidate, has_reaction
from aero_bayes.structure.law import SIGNAL_DEFAULTS, Law, LawParameter, ParameterAttribute

_LIMITS: tuple[tuple[str, ParameterAttribute], ...] = (("min", "minimum"), ("max", "maximum"), ("nominal", "nominal"))


@dataclass(frozen=True)
class PlacedLaw:
    """A law at a port."""

    law: Law
    port: Port
    instance: str
    names: Mapping[str, str]
    nominals: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    neighbour: Port | None = None
    alias: str = ""
    moved_input: str = ""

    @property
    def id(self) -> str:
        """The alias, or ``law@port``."""
        return self.alias or f"{self.law.id}@{self.port.id}"

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
        found = {attribute: p.value(of, self.all_nominals) for attribute, of in _LIMITS}
        return {k: v for k, v in found.items() if math.isfinite(v)}

    def declarations(self) -> Iterator[str]:
        """Yield Modelica declarations of the fitted parameters in the model."""
        for p in self.parameters():
            attributes = [f'unit = "{self.unit(p)}"'] if self.unit(p) else []
            attributes += [f"{k} = {v:.6g}" for k, v in self.limits(p).items()]
            given, about = f"({', '.join(attributes)}) = {self.value(p)!r}", f'"{p.description} at {self.port.id}"'
            yield f"parameter Real {self.names[p.name]}{given} {about};"

    def unit(self, p: LawParameter) -> str:
        """Return the unit of a parameter, from the units of the port."""
        signals = {**self.port.units, "h_1": self.port.units.get("h", "")}
        if signals.get("v") and not signals.get("x"):
            signals["x"] = f"s.{signals['v']}"
        units = {nominal: signals.get(signal, "") for nominal, signal in self.law.interface.nominals.items()}
        return p.unit({**units, "t_n": "s", "w_n": "1"})


def place_law(
    law: Law,
    port: Port,
    taken: Collection[str],
    *,
    nominals: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    neighbour: Port | None = None,
    alias: str = "",
    with_starts: bool = False,
) -> PlacedLaw:
    """Place a law at a port, under names that are not in use: ``F_c``, or ``F_c_v`` if that is in use."""
    if law.kind == "exchange" and neighbour is None:
        raise InputError(f"{law.id}@{port.id}: an exchange needs a neighbour")
    neighbour = neighbour if has_reaction(law, port) else None
    used = {n.partition(".")[0] for n in taken}
    suffix = identifier(port.id)

    def free(name: str) -> str:
        candidates = [name, f"{name}_{suffix}", *(f"{name}_{suffix}_{k}" for k in range(2, 100))]
        chosen = next(c for c in candidates if c not in used)
        used.add(chosen)
        return chosen

    fitted = [p.name for p in law.parameters if p.name != "share" or neighbour is not None]
    fitted += [p.name for p in law.starts if with_starts]
    names = {p: free(p) for p in fitted}
    # a nominal value is an order of magnitude: three digits are enough in a written model
    rounded = {k: float(f"{v:.3g}") if k.endswith("_n") else float(v) for k, v in (nominals or {}).items()}
    return PlacedLaw(law, port, free(alias or law.id), names, rounded, dict(values or {}), neighbour, alias)


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
        own = nominals.get(c.port.id, {})
        free = free_starts and c.law.kind == "input"
        placed_laws.append(
            place_law(c.law, c.port, used, nominals=own, neighbour=c.neighbour, alias=c.alias, with_starts=free)
        )
        used |= {placed_laws[-1].instance, *placed_laws[-1].names.values()}
    return tuple(placed_laws)


def with_moved_input(placed: PlacedLaw, recorded: Collection[str]) -> PlacedLaw:
    """Return a delay of an input that is among the recorded ones as a move of that input; other laws as they are."""
    signal = placed.port.signals.get("u", "")
    moved = placed.law.delay and placed.port.attachment == "input" and signal in recorded
    return replace(placed, moved_input=signal) if moved else placed


def at_same_ports(placed_laws: Sequence[PlacedLaw], ports: Sequence[Port]) -> list[PlacedLaw]:
    """Return the same laws at the ports of another model, found by their ids."""
    there = {p.id: p for p in ports}
    needed = {p.id for placed in placed_laws for p in (placed.port, placed.neighbour) if p is not None}
    if lost := sorted(needed - there.keys()):
        raise CannotFinishError(f"the model with laws in its replaceable models has no port {lost[0]!r} any more")
    return [
        replace(p, port=there[p.port.id], neighbour=there[p.neighbour.id] if p.neighbour else None) for p in placed_laws
    ]


def identifier(path: str) -> str:
    """Return a path as an identifier: ``rotor.a`` becomes ``rotor_a``."""
    return re.sub(r"\W+", "_", path).strip("_")


def describe_law(law: Law, port: Port) -> str:
    """Return a phrase about a law and its port."""
    about, place = f"{law.description[:1].lower()}{law.description[1:]}", port.replaceable
    if place is None or not place.description:
        return f"{about} at {port.id}"
    return f"{about} ({place.description[:1].lower()}{place.description[1:]})"


#: Starting points of the parameters of a candidate.
Starts = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class PlacedTerms:
    """The laws that were placed as candidates of a loop, by id. They change while it goes on.

    ``starts`` are starting values of their parameters; ``read`` names the output on which a law acts, by the variable
    that the law reads in its place."""

    placed: dict[str, PlacedLaw] = field(default_factory=dict)
    starts: dict[str, Starts] = field(default_factory=dict)
    read: dict[str, str] = field(default_factory=dict)

    def add(self, placed: PlacedLaw, starts: Starts) -> None:
        """Add a candidate."""
        self.placed[placed.id] = placed
        self.starts[placed.id] = starts
        self.note_outputs(placed)

    def note_outputs(self, placed: PlacedLaw) -> None:
        """Keep the output on which a law acts."""
        if placed.port.attachment == "output":
            self.read[f"{placed.instance}.u"] = placed.port.signals["u"]
