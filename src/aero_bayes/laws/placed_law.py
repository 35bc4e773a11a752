"""A law at a port, with the names and numbers that it gets in a model."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.laws.candidates import Candidate, has_reaction
from aero_bayes.laws.law import SIGNAL_DEFAULTS, Law, LawParameter, ParameterAttribute
from aero_bayes.ports import Port

_LIMITS: tuple[tuple[str, ParameterAttribute], ...] = (("min", "minimum"), ("max", "maximum"), ("nominal", "nominal"))


@dataclass(frozen=True)
class PlacedLaw:
    """A law at a port.

    Attributes
    ----------
    instance : str
        Name of the law's component.
    names : mapping
        For each parameter of the law that is fitted, its name in the whole model.
    sizes : mapping
        The port's sizes by the names of the law's partial model (``f_n``, ``v_n``, ...); one where missing.
    values : mapping
        Values by the law's own names; the default, which leaves nothing of the law, where missing.
    neighbour : Port, optional
        Where what is lost may go, or what takes the reaction.
    alias : str
        Another name that it goes by.
    """

    law: Law
    port: Port
    instance: str
    names: Mapping[str, str]
    nominals: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    neighbour: Port | None = None
    alias: str = ""

    @property
    def id(self) -> str:
        """``law@port``, or its alias."""
        return self.alias or f"{self.law.id}@{self.port.id}"

    @property
    def all_nominals(self) -> dict[str, float]:
        """The sizes with the defaults of those that are not given."""
        return {**self.law.nominals, **{k: float(v) for k, v in self.nominals.items() if k in self.law.nominals}}

    @property
    def signal_defaults(self) -> dict[str, float]:
        """What the law is given for signals that the port does not have."""
        own = {
            s: n for s, n in SIGNAL_DEFAULTS.items() if s in self.law.interface.inputs and s not in self.port.signals
        }
        return {signal: self.all_nominals[size] for signal, size in own.items()}

    def parameters(self) -> Iterator[LawParameter]:
        """The fitted parameters; a share for the neighbour only where there is one."""
        return (p for p in self.law.parameters if p.name in self.names)

    def value(self, p: LawParameter) -> float:
        return float(self.values.get(p.name, p.value("default", self.all_nominals)))

    def limits(self, p: LawParameter) -> dict[str, float]:
        """``min``, ``max`` and ``nominal``, those that are given."""
        found = {attribute: p.value(of, self.all_nominals) for attribute, of in _LIMITS}
        return {k: v for k, v in found.items() if math.isfinite(v)}

    def declarations(self) -> Iterator[str]:
        """The fitted parameters as Modelica declares them in the whole model."""
        for p in self.parameters():
            attributes = [f'unit = "{self.unit(p)}"'] if self.unit(p) else []
            attributes += [f"{k} = {v:.6g}" for k, v in self.limits(p).items()]
            given, about = f"({', '.join(attributes)}) = {self.value(p)!r}", f'"{p.description} at {self.port.id}"'
            yield f"parameter Real {self.names[p.name]}{given} {about};"

    def unit(self, p: LawParameter) -> str:
        """Unit of a parameter, from those of the port."""
        signals = {**self.port.units, "h_1": self.port.units.get("h", "")}
        if signals.get("v") and not signals.get("x"):
            signals["x"] = f"s.{signals['v']}"
        of_size = {size: signals.get(signal, "") for size, signal in self.law.interface.nominals.items()}
        return p.unit({**of_size, "t_n": "s", "w_n": "1"})


def place_law(
    law: Law,
    port: Port,
    taken: Collection[str],
    *,
    nominals: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    neighbour: Port | None = None,
    alias: str = "",
) -> PlacedLaw:
    """A law at a port under names that are free: ``F_c``, or ``F_c_v`` where that is taken.

    Parameters
    ----------
    taken : collection of str
        Names that the model has already; paths count by their first part.
    neighbour : Port, optional
        For an exchange, for what overflows and for what acts between two motions; other laws have none.

    Raises
    ------
    InputError
        For an exchange without a neighbour.
    """
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
    names = {p: free(p) for p in fitted}
    # a size is a typical magnitude: three digits of it read well in a written model
    rounded = {k: float(f"{v:.3g}") if k.endswith("_n") else float(v) for k, v in (nominals or {}).items()}
    return PlacedLaw(law, port, free(alias or law.id), names, rounded, dict(values or {}), neighbour, alias)


def place_laws(
    found: Iterable[Candidate], taken: Collection[str], nominals: Mapping[str, Mapping[str, float]]
) -> tuple[PlacedLaw, ...]:
    """Candidates in one model, in the order given, no name twice; ``nominals`` by the port's id."""
    placed_laws: list[PlacedLaw] = []
    used = set(taken)
    for c in found:
        own = nominals.get(c.port.id, {})
        placed_laws.append(place_law(c.law, c.port, used, nominals=own, neighbour=c.neighbour, alias=c.alias))
        used |= {placed_laws[-1].instance, *placed_laws[-1].names.values()}
    return tuple(placed_laws)


def at_same_ports(placed_laws: Sequence[PlacedLaw], ports: Sequence[Port]) -> list[PlacedLaw]:
    """The same laws at the ports of another model, found by their ids.

    Raises
    ------
    CannotFinishError
        If the other model lacks a port.
    """
    there = {p.id: p for p in ports}
    needed = {p.id for placed in placed_laws for p in (placed.port, placed.neighbour) if p is not None}
    if lost := sorted(needed - there.keys()):
        raise CannotFinishError(f"the model with laws in its replaceable models has no port {lost[0]!r} any more")
    return [
        replace(p, port=there[p.port.id], neighbour=there[p.neighbour.id] if p.neighbour else None) for p in placed_laws
    ]


def identifier(path: str) -> str:
    """A path as part of a name: ``rotor.a`` -> ``rotor_a``."""
    return re.sub(r"\W+", "_", path).strip("_")


def describe_law(law: Law, port: Port) -> str:
    """A law and where it acts."""
    about, place = f"{law.description[:1].lower()}{law.description[1:]}", port.replaceable
    if place is None or not place.description:
        return f"{about} at {port.id}"
    return f"{about} ({place.description[:1].lower()}{place.description[1:]})"
