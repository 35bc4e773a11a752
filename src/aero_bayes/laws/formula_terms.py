"""Formulas as terms of a Modelica model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.export.flat import FlatModel
from aero_bayes.laws.compose import law_models
from aero_bayes.laws.formula import (
    DISTURBANCE,
    FORMULA,
    FUNCTION,
    Formula,
    disturbances,
    formula_law,
    formula_starts,
    told,
)
from aero_bayes.laws.formula_places import (
    STATE_AND_TERM,
    FormulaPlace,
    FormulaPort,
    formula_ports,
    near_signals,
    parameter_ports,
)
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.placed_law import PlacedLaw, place_law
from aero_bayes.laws.write_model import can_be_written
from aero_bayes.simulation.model import Model

#: Starting points of the parameters of a candidate.
Starts = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class PlacedTerms:
    """The candidates of a loop: laws and formulas that were placed, by id. They change while it goes on.

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


@dataclass(frozen=True)
class ProposedFormula:
    """A formula at a port.

    ``largest`` is the largest magnitude of its product over what was visited, ``coefficient`` what the filter found,
    and ``values`` are those of the first model's parameters beside it."""

    port: str
    formula: Formula
    largest: float
    coefficient: float
    values: Mapping[str, float]


class FormulaSignals(ABC):
    """Which variables formulas may read, and at which parameters of the model they may be."""

    @abstractmethod
    def variables(self) -> Mapping[str, tuple[str, str]]:
        """Return, for each state, input and output of the base model that formulas read: the variable, and its unit."""

    @abstractmethod
    def of_place(self, place: FormulaPort) -> str:
        """Return the state of a balance, or the signal at an input or output; empty for a parameter."""

    @abstractmethod
    def read_at(self, place: FormulaPort) -> list[str]:
        """Return further signals that a law at the port reads."""

    @abstractmethod
    def parameter_ports(self, free: Collection[str]) -> Iterator[FormulaPort]:
        """Yield parameters that may be functions."""

    @abstractmethod
    def state_sizes(self, placed_laws: Iterable[PlacedLaw]) -> Mapping[str, float]:
        """Return typical sizes of states of the base model, as far as they are known."""

    def for_readers(self, text: str) -> str:
        """Return the name of a variable, or a formula, as the user knows it."""
        return text


@dataclass(frozen=True)
class ModelicaSignals(FormulaSignals):
    """Variables of a Modelica model that formulas may read."""

    places: LawPlaces
    base_model: Callable[[], Model]

    def variables(self) -> Mapping[str, tuple[str, str]]:
        model, structure = self.base_model(), self.places.structure
        every = (*(v for v in model.outputs if v.kind == "real"), *model.states)
        names = {v.name: self._named(v.name) for v in every if v.name in structure.same}
        names |= {v.name: v.name for v in model.inputs}
        units = {v.name: v.unit for v in (*every, *model.inputs)}
        return {own: (there, units[own] or structure.units.get(there, "")) for own, there in names.items()}

    def _named(self, variable: str) -> str:
        """Return the variable as others call it that are equal to it."""
        same, sign = self.places.structure.same.get(variable, (variable, 1))
        return same if sign > 0 else variable

    def of_place(self, place: FormulaPort) -> str:
        port = place.port
        if place.at_signal:
            return "" if place.parameter else self._named(port.signals["u"])
        return port.balance.state if port.balance is not None else ""

    def read_at(self, place: FormulaPort) -> list[str]:
        structure = self.places.structure
        return [structure.of(s) for s in place.port.signals.values() if s in structure.same]

    def parameter_ports(self, free: Collection[str]) -> Iterator[FormulaPort]:
        """Yield parameters that may be functions, and whose uses can be written."""
        places = self.places
        for place in parameter_ports(places.flat, free):
            placed = place_law(disturbances()[True], place.port, places.taken_names())
            if can_be_written(places.sources, places.base, places.flat, placed):
                yield place

    def state_sizes(self, placed_laws: Iterable[PlacedLaw]) -> Mapping[str, float]:
        """Return typical sizes of states of the base model that have a balance."""
        structure = self.places.structure
        there = {structure.of(s.name): s.name for s in self.base_model().states if s.name in structure.same}
        found = dict[str, float]()
        for p in placed_laws:
            state = p.port.balance.state if p.port.balance is not None else ""
            if p.port.kind in STATE_AND_TERM and state in there:
                found.setdefault(there[state], p.nominals.get(STATE_AND_TERM[p.port.kind][0], 1.0))
        return found


@dataclass(frozen=True)
class FormulaTerms:
    """Places formulas beside the laws of a model."""

    law_places: LawPlaces
    terms: PlacedTerms
    signals: FormulaSignals
    base_model: Callable[[], Model]
    models: dict[tuple[str, str], FlatModel] = field(default_factory=dict)
    _formulas: dict[str, Formula] = field(default_factory=dict)
    _ports: dict[str, FormulaPort] = field(default_factory=dict)

    def clear(self) -> None:
        """Forget all formulas."""
        self._formulas.clear()

    def places(self, free: Collection[str]) -> tuple[FormulaPlace, ...]:
        """Return places at which formulas may act: ports, and those of some free parameters that may be functions."""
        every = (*formula_ports(self.terms.placed.values()), *self.signals.parameter_ports(free))
        found = [p for p in every if self._wanted(p)]
        self._ports.clear()
        self._ports.update({p.port.id: p for p in found})
        known, base = self.signals.variables(), self.base_model()
        states, inputs = ([known[v.name][0] for v in part if v.name in known] for part in (base.states, base.inputs))
        places = []
        for p in found:
            own = self.signals.of_place(p)
            near = near_signals(p, [s for s in (own, *self.signals.read_at(p)) if s], states, inputs)
            places.append(FormulaPlace(p.port.id, near, own, p.port.id if p.parameter else "", p.order))
        return tuple(places)

    def _wanted(self, place: FormulaPort) -> bool:
        id_, places = place.port.id, self.law_places
        return places.candidate_filter.accepts(f"{FORMULA}@{id_}", FORMULA, places.port_name(place.port))

    def state_sizes(self) -> Mapping[str, float]:
        """Return typical sizes of states of the base model, as far as they are known."""
        return self.signals.state_sizes(self.terms.placed.values())

    def unknown_signals(self, places: Sequence[FormulaPlace]) -> tuple[list[PlacedLaw], dict[str, str]]:
        """Place an unknown signal at each place. Returns the laws, and the states that are the signals, by port."""
        taken, placed_laws = self.law_places.taken_names(), list[PlacedLaw]()
        for place in places:
            p = self._ports[place.port]
            placed_laws.append(place_law(disturbances()[p.at_signal], p.port, taken, neighbour=p.neighbour))
            taken = {*taken, placed_laws[-1].instance}
            self.terms.note_outputs(placed_laws[-1])
        self.models.update(law_models([*disturbances().values()]))
        return placed_laws, {p.port.id: f"{p.instance}.{DISTURBANCE}" for p in placed_laws}

    def add(self, proposed: Sequence[ProposedFormula]) -> Mapping[str, Mapping[str, float]]:
        """Place formulas as further candidates. Returns their ids, with values of all parameters to start from."""
        taken = self.law_places.taken_names()
        taken |= {n for p in self.terms.placed.values() for n in (p.instance, *p.names.values())}
        added: list[PlacedLaw] = []
        for number, one in enumerate(proposed, 1):
            here = self._ports[one.port]
            id_ = f"{FUNCTION if here.parameter else FORMULA}_{number}"
            law, port = formula_law(one.formula, here.port, id_, one.largest, self.signals.of_place(here))
            local = {given: name for name, given in port.signals.items() if name != "u"}
            sizes = {f"{local.get(s.name, 'u')}_n": s.size for s in one.formula.signals}
            nominals = {"q_n": here.size} | sizes
            added.append(place_law(law, port, taken, nominals=nominals, neighbour=here.neighbour))
            taken |= {added[-1].instance, *added[-1].names.values()}
            self._formulas[added[-1].id] = one.formula
        self.models.update(law_models([p.law for p in added]) if added else {})
        for placed in added:
            self.terms.add(placed, formula_starts(placed))
        return {
            p.id: {**one.values, **dict(zip(p.names.values(), (one.coefficient, *one.formula.constants), strict=True))}
            for p, one in zip(added, proposed, strict=True)
        }

    def text(self, id_: str, values: Mapping[str, float]) -> str:
        """Return a formula with its sign and numbers, such as ``+ 0.31*x*y``; empty for a listed law.

        ``values`` go by the names of the model with candidates."""
        if id_ not in self._formulas:
            return ""
        placed = self.terms.placed[id_]
        k, *constant = (values[name] for name in placed.names.values())
        return self.signals.for_readers(told(self._formulas[id_], k, *constant[:1], parameter=placed.port.id))

    def ranges(self, id_: str) -> Mapping[str, tuple[float, float]]:
        """Return the range over which each signal of a formula was seen; empty for a listed law."""
        signals = self._formulas[id_].signals if id_ in self._formulas else ()
        return {self.signals.for_readers(s.name): (s.low, s.high) for s in signals}
