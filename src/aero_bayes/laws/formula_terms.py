"""Formulas as terms of a Modelica model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.estimate.calibration import Calibration
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
from aero_bayes.laws.formula_places import STATE_AND_TERM, FormulaPort, formula_ports, near_signals, parameter_ports
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.model_family import (
    DisturbedModel,
    FormulaPlace,
    ProposedFormula,
)
from aero_bayes.laws.placed_law import (
    PlacedLaw,
    place_law,
)
from aero_bayes.laws.write_model import can_be_written
from aero_bayes.simulation.model import Model


@dataclass(frozen=True)
class FormulaTerms(LawPlaces, ABC):
    """Places formulas beside the laws of a model; :class:`ModelicaFamily` describes the fields."""

    _placed: dict[str, PlacedLaw] = field(default_factory=dict, compare=False, repr=False)
    _read: dict[str, str] = field(default_factory=dict, compare=False, repr=False)
    _starts: dict[str, tuple[tuple[float, ...], ...]] = field(default_factory=dict, compare=False, repr=False)
    _formulas: dict[str, Formula] = field(default_factory=dict, compare=False, repr=False)
    _formula_ports: dict[str, FormulaPort] = field(default_factory=dict, compare=False, repr=False)
    _formula_models: dict[tuple[str, str], FlatModel] = field(default_factory=dict, compare=False, repr=False)

    @abstractmethod
    def base_model(self) -> Model:
        """Return the model without any law added."""

    @abstractmethod
    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """Return the calibration of the base model, for a member of the family."""

    @abstractmethod
    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        """Return the model with some laws."""

    @abstractmethod
    def _states_there(self, calibration: Calibration, model: Model) -> Mapping[str, str]:
        """Return the names in a model with laws of the states of a calibration's model."""

    def formula_places(self, free: Collection[str]) -> tuple[FormulaPlace, ...]:
        """Return places at which formulas may act: ports, and those of some free parameters that may be functions."""
        found = [p for p in (*formula_ports(self._placed.values()), *self._parameter_ports(free)) if self._wanted(p)]
        self._formula_ports.clear()
        self._formula_ports.update({p.port.id: p for p in found})
        known = self.formula_signals()
        states = [known[s.name][0] for s in self.base_model().states if s.name in known]
        inputs = [known[v.name][0] for v in self.base_model().inputs if v.name in known]
        places = []
        for p in found:
            own = self._own_signal(p)
            near = near_signals(p, [s for s in (own, *self._read_at(p)) if s], states, inputs)
            places.append(FormulaPlace(p.port.id, near, own, p.port.id if p.parameter else "", p.order))
        return tuple(places)

    def _wanted(self, place: FormulaPort) -> bool:
        id_ = place.port.id
        return self.candidate_filter.accepts(f"{FORMULA}@{id_}", FORMULA, self.port_name(place.port))

    def _parameter_ports(self, free: Collection[str]) -> Iterator[FormulaPort]:
        """Yield parameters that may be functions, and whose uses can be written."""
        for place in parameter_ports(self.flat, free):
            placed = place_law(disturbances()[True], place.port, self._taken())
            if can_be_written(self.sources, self.base, self.flat, placed):
                yield place

    def _own_signal(self, place: FormulaPort) -> str:
        """Return the state of a balance, or the signal at an input or output; empty for a parameter."""
        port = place.port
        if place.at_signal:
            return "" if place.parameter else self._named(port.signals["u"])
        return port.balance.state if port.balance is not None else ""

    def _named(self, variable: str) -> str:
        """Return the variable as others call it that are equal to it."""
        same, sign = self._structure.same.get(variable, (variable, 1))
        return same if sign > 0 else variable

    def _read_at(self, place: FormulaPort) -> list[str]:
        """Further signals that a law at the port reads."""
        return [self._structure.of(s) for s in place.port.signals.values() if s in self._structure.same]

    def formula_signals(self) -> Mapping[str, tuple[str, str]]:
        """Return, for each state, input and output of the base model that formulas read: the variable, and its unit."""
        model, structure = self.base_model(), self._structure
        every = (*(v for v in model.outputs if v.kind == "real"), *model.states)
        names = {v.name: self._named(v.name) for v in every if v.name in structure.same}
        names |= {v.name: v.name for v in model.inputs}
        units = {v.name: v.unit for v in (*every, *model.inputs)}
        return {own: (there, units[own] or structure.units.get(there, "")) for own, there in names.items()}

    def state_sizes(self) -> Mapping[str, float]:
        """Return typical sizes of states of the base model that have a balance."""
        there = {self._structure.of(s.name): s.name for s in self.base_model().states if s.name in self._structure.same}
        found = dict[str, float]()
        for p in self._placed.values():
            state = p.port.balance.state if p.port.balance is not None else ""
            if p.port.kind in STATE_AND_TERM and state in there:
                found.setdefault(there[state], p.nominals.get(STATE_AND_TERM[p.port.kind][0], 1.0))
        return found

    def with_unknown_signals(self, calibration: Calibration, places: Sequence[FormulaPlace]) -> DisturbedModel:
        """Return the base model with an unknown signal at each place."""
        taken, placed_laws = self._taken(), list[PlacedLaw]()
        for place in places:
            p = self._formula_ports[place.port]
            placed_laws.append(place_law(disturbances()[p.at_signal], p.port, taken, neighbour=p.neighbour))
            taken = {*taken, placed_laws[-1].instance}
            self._read.update(outputs_read_by(placed_laws[-1]))
        self._formula_models.update(law_models([*disturbances().values()]))
        model = self._with(placed_laws)
        signals = {p.port.id: f"{p.instance}.{DISTURBANCE}" for p in placed_laws}
        states = {**{s.name: s.name for s in self.base_model().states}, **self._states_there(calibration, model)}
        return DisturbedModel(self.transfer(calibration, model), states, signals)

    def add_formulas(self, proposed: Sequence[ProposedFormula]) -> Mapping[str, Mapping[str, float]]:
        """Place formulas as further candidates. Returns their ids, with values of all parameters to start from."""
        taken = self._taken() | {n for p in self._placed.values() for n in (p.instance, *p.names.values())}
        added: list[PlacedLaw] = []
        for number, one in enumerate(proposed, 1):
            here = self._formula_ports[one.port]
            id_ = f"{FUNCTION if here.parameter else FORMULA}_{number}"
            law, port = formula_law(one.formula, here.port, id_, one.largest, self._own_signal(here))
            local = {given: name for name, given in port.signals.items() if name != "u"}
            sizes = {f"{local.get(s.name, 'u')}_n": s.size for s in one.formula.signals}
            nominals = {"q_n": here.size} | sizes
            added.append(place_law(law, port, taken, nominals=nominals, neighbour=here.neighbour))
            taken |= {added[-1].instance, *added[-1].names.values()}
            self._formulas[added[-1].id] = one.formula
        self._formula_models.update(law_models([p.law for p in added]) if added else {})
        for placed in added:
            self._placed[placed.id] = placed
            self._starts[placed.id] = formula_starts(placed)
            self._read.update(outputs_read_by(placed))
        return {
            p.id: {**one.values, **dict(zip(p.names.values(), (one.coefficient, *one.formula.constants), strict=True))}
            for p, one in zip(added, proposed, strict=True)
        }

    def formula_text(self, id_: str, values: Mapping[str, float]) -> str:
        """Return a formula with its sign and numbers; empty for a listed law."""
        if id_ not in self._formulas:
            return ""
        placed = self._placed[id_]
        k, *constant = (values[name] for name in placed.names.values())
        return told(self._formulas[id_], k, *constant[:1], parameter=placed.port.id)

    def formula_ranges(self, id_: str) -> Mapping[str, tuple[float, float]]:
        """Return the range over which each signal of a formula was seen; empty for a listed law."""
        return {s.name: (s.low, s.high) for s in self._formulas[id_].signals} if id_ in self._formulas else {}


def outputs_read_by(placed: PlacedLaw) -> dict[str, str]:
    """Return the output on which a law acts, by the name of the variable that the law reads instead."""
    return {f"{placed.instance}.u": placed.port.signals["u"]} if placed.port.attachment == "output" else {}
