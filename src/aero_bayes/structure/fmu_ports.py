"""Where laws may act around an FMU: at its inputs and outputs, and at forces that drive a known speed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.modelica.compose import add_input, add_output
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Name, Number
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable
from aero_bayes.structure.balance import Balance, Port, PortKind, signal_port
from aero_bayes.structure.candidates import Candidate, PlacedLaw, find_candidates, identifier, with_applicable_laws
from aero_bayes.structure.compose import compose_laws
from aero_bayes.structure.coupled_fmu import BASE, INPUT, STATE, Source, Terms
from aero_bayes.structure.law import Law
from aero_bayes.structure.law_places import LawPlaces
from aero_bayes.structure.open_ports import OpenModel

#: By the unit of a force or torque: the unit of the speed, and units of the position.
_MOTIONS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "N": ("m/s", ("m",)), "N.m": ("rad/s", ("rad", "1", "")),
}  # fmt: skip
#: Suffix of the name under which laws read a state.
INSIDE = "_inside"


@dataclass(frozen=True)
class LawCoupling:
    """How the variables of an FMU are connected with those of a flat model of laws."""

    flat: FlatModel
    inputs: tuple[tuple[Variable, str, str], ...]
    outputs: tuple[tuple[Variable, str, str], ...]
    states: tuple[tuple[Variable, str], ...]


@dataclass(frozen=True)
class FmuPlaces(LawPlaces):
    """An FMU, its ports, and the laws that may act around it."""

    fmu: Path = Path()

    @cached_property
    def inner(self) -> Model:
        return Model.load(self.fmu)

    @cached_property
    def declared(self) -> PackageDeclaration:
        """An empty declaration: ports and laws around an FMU are found, not declared."""
        return PackageDeclaration()

    @cached_property
    def replaceable_laws(self) -> tuple[Law, ...]:
        """Empty: an FMU has no replaceable models."""
        return ()

    def check(self) -> None:
        """Raise InputError for an FMU without Model Exchange, and as for any model."""
        if self.inner.interface != "model exchange":
            raise InputError(f"{self.fmu}: the loop needs Model Exchange; this FMU has co-simulation only")
        super().check()

    def taken_names(self) -> set[str]:
        inner = self.inner
        every = (*inner.parameters, *inner.inputs, *inner.outputs, *inner.states)
        return {v.name for v in every} | set(self.names.values())

    def candidates_for(self, data: MeasuredData) -> Sequence[Candidate]:
        """Return all candidates. At an input that no recording has, only an offset."""
        driven = {s.name for e in data.experiments for s in e.inputs}
        return [
            c
            for c in find_candidates(self.ports, self.laws)
            if c.port.kind != "input" or c.port.id in driven or c.law.id == "offset"
        ]

    @cached_property
    def names(self) -> Mapping[str, str]:
        """A Modelica identifier for every input, output and state."""
        found: dict[str, str] = {}
        for v in (*self.inner.inputs, *self.inner.outputs, *self.inner.states):
            if v.name not in found:
                plain = name = identifier(v.name) or "signal"
                count = 1
                while name in found.values() or name[0].isdigit():
                    count += 1
                    name = f"{plain}_{count}" if not plain[0].isdigit() else f"v{plain}_{count}"
                found[v.name] = name
        return found

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        """Ports at all inputs and outputs, and at forces and torques with a speed among the states."""
        motions = list(self._motions())
        taken = {p.id for p in motions}
        plain = [
            *(self._signal(v, "input", v.name) for v in self.inner.inputs),
            *(self._signal(v, "reading", f"output_{v.name}" if v.name in taken else v.name)
              for v in self.inner.outputs if v.kind == "real"),
        ]  # fmt: skip
        return with_applicable_laws([*plain, *motions], self.laws)

    def _signal(self, v: Variable, kind: PortKind, id_: str) -> Port:
        port = signal_port(kind, "input" if kind == "input" else "output", self.names[v.name], v.unit, None)
        return replace(port, id=id_)

    def _motions(self) -> Iterator[Port]:
        """Yield ports for forces. They read states, so that no algebraic loop arises."""
        driving = [(k, v) for k, v in enumerate(self.inner.inputs) if v.unit in _MOTIONS]
        for k, force in driving:
            speed_unit, position_units = _MOTIONS[force.unit]
            speeds = [s for s in self.inner.states if s.unit == speed_unit]
            positions = [s for s in self.inner.states if s.unit in position_units]
            alone = sum(v.unit == force.unit for _, v in driving) == 1
            for speed in speeds:
                signals, units = {"v": self.state_signal(speed)}, {"f": force.unit, "v": speed_unit}
                if len(speeds) == len(positions) == 1:
                    signals["x"], units["x"] = self.state_signal(positions[0]), positions[0].unit
                own = self._outside(speed)
                yield Port(
                    own if alone else f"{force.name}.{own}", "motion", "equation", force.unit, units, None,
                    tuple(s.name for s in (speed, *positions[: "x" in signals])), signals,
                    Balance(k, Number(1.0), force.unit),
                )  # fmt: skip

    def state_signal(self, state: Variable) -> str:
        """Return the name under which laws read a state."""
        return f"{self.names[state.name]}{INSIDE}"

    def _outside(self, state: Variable) -> str:
        """Return the name of the output that equals a state, else the name of the state."""
        index = self.inner.states.index(state)
        return next((v.name for v in self.inner.outputs if self.inner.copied_state(v.name) == index), state.name)

    def opened(self) -> OpenModel:
        """Return the FMU with its inputs, outputs and states under the names by which laws know them."""
        model, signals = self.inner, dict[str, Terms]()
        states = {s.value_reference: k for k, s in enumerate(model.states)}
        for k, v in enumerate(model.inputs):
            signals[self.names[v.name]] = ((Source(INPUT, k), 1.0),)
        for v in model.outputs:
            state = states.get(v.value_reference)
            source = Source(BASE, v.value_reference) if state is None else Source(STATE, state)
            signals[self.names[v.name]] = ((source, 1.0),)
        for k, s in enumerate(model.states):
            signals[self.state_signal(s)] = ((Source(STATE, k), 1.0),)
        probes = {p.id: model.inputs[p.balance.equation].name for p in self.ports if p.balance is not None}
        return OpenModel(model, tuple(v.name for v in model.inputs), probes, signals, gain=-1.0)

    def coupling(self, placed_laws: Sequence[PlacedLaw]) -> LawCoupling:
        """Return the flat model of laws at ports of this FMU, with only those signals of the FMU that they need."""
        read = {name for placed in placed_laws for name in placed.port.signals.values()}
        flat = FlatModel(f"{self.inner.name} laws")
        inputs, outputs, states = [], [], []
        for v in self.inner.inputs:
            name = self.names[v.name]
            inputs.append((v, name, f"{name}_acts"))
            flat = add_input(flat, name, v.unit, v.description, v.start or 0.0)
            flat = add_output(flat, f"{name}_acts", Name(name), v.unit)
        for v in self.inner.outputs:
            name = self.names[v.name]
            if v.kind == "real" and name in read:
                outputs.append((v, f"{name}_unread", name))
                flat = add_input(flat, f"{name}_unread", v.unit, v.description, v.start or 0.0)
                flat = add_output(flat, name, Name(f"{name}_unread"), v.unit)
        for v in self.inner.states:
            if self.state_signal(v) in read:
                states.append((v, self.state_signal(v)))
                flat = add_input(flat, self.state_signal(v), v.unit, v.description, v.start or 0.0)
        return LawCoupling(
            compose_laws(flat, placed_laws, self.law_models), tuple(inputs), tuple(outputs), tuple(states)
        )
