"""Laws around an FMU without source: at its inputs and outputs, and at forces that drive a known speed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.files import write_whole
from aero_bayes.laws.attach import attached
from aero_bayes.laws.balance import Balance, Port, PortKind, Signal, signal_port
from aero_bayes.laws.candidates import Candidate, PlacedLaw, find_candidates, identifier, with_applicable_laws
from aero_bayes.laws.class_with_laws import class_text
from aero_bayes.laws.coupled_fmu import BASE, INPUT, STATE, UNREAD_SUFFIX, LinearSum, Source, couple
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.probed_model import ProbedModel
from aero_bayes.laws.wiring import wiring
from aero_bayes.laws.write_model import WrittenModel
from aero_bayes.loop.modelica_family import ExtendedModel, ModelicaFamily, OpenSimulator, PortNominals
from aero_bayes.loop.nominal_values import (
    fastest_time_scale,
    recorded_inputs,
    relative_change,
    share_visited_twice,
    signal_nominal,
    simulated_signals,
    visited_range,
)
from aero_bayes.modelica.syntax import Number
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable

#: By the unit of a force or torque: the unit of the speed, and units of the position.
_MOTIONS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "N": ("m/s", ("m",)), "N.m": ("rad/s", ("rad", "1", "")),
}  # fmt: skip
#: Suffix of the name under which laws read a state.
INSIDE = "_inside"


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

    def state_signal(self, state: Variable) -> Signal:
        """Return the name under which laws read a state."""
        return Signal.of(f"{self.names[state.name]}{INSIDE}")

    def _outside(self, state: Variable) -> str:
        """Return the name of the output that equals a state, else the name of the state."""
        index = self.inner.states.index(state)
        return next((v.name for v in self.inner.outputs if self.inner.copied_state(v.name) == index), state.name)

    def opened(self) -> ProbedModel:
        """Return the FMU with its inputs, outputs and states under the names by which laws know them."""
        model, signals = self.inner, dict[Signal, LinearSum]()
        states = {s.value_reference: k for k, s in enumerate(model.states)}
        for k, v in enumerate(model.inputs):
            signals[Signal.of(self.names[v.name])] = ((Source(INPUT, k), 1.0),)
        for v in model.outputs:
            state = states.get(v.value_reference)
            source = Source(BASE, v.value_reference) if state is None else Source(STATE, state)
            signals[Signal.of(self.names[v.name])] = ((source, 1.0),)
        for k, s in enumerate(model.states):
            signals[self.state_signal(s)] = ((Source(STATE, k), 1.0),)
        probes = {p.id: model.inputs[p.balance.equation].name for p in self.ports if p.balance is not None}
        return ProbedModel(model, tuple(v.name for v in model.inputs), probes, signals, gain=-1.0)


#: Name of the imported FMU in the Modelica model.
PLANT = "plant"


def _imported_class(inner: Model) -> str:
    """Return the name under which the Modelica model expects the imported FMU."""
    name = identifier(inner.path.stem) or "Model"
    return f"M{name}_fmu" if name[0].isdigit() else f"{name}_fmu"


def wrapper_text(places: FmuPlaces, placed_laws: Sequence[PlacedLaw], values: Mapping[str, float], name: str) -> str:
    """Return the Modelica model of an imported FMU with laws around it."""
    inner, names = places.inner, places.names
    cls = _imported_class(inner)
    lines = [
        "within ;",
        f'model {name} "{inner.path.name} with {" and ".join(u.id for u in placed_laws) or "nothing added"}"',
        f"  // import {inner.path.name} under the name {cls} first (OpenModelica: importFMU, Dymola: File, Import FMU)",
    ]
    lines += [f"  {line}" for placed in placed_laws for line in placed.declarations()]
    shown = [(v, "input") for v in inner.inputs] + [(v, "output") for v in inner.outputs if v.kind == "real"]
    for v, causality in shown:
        unit = f'(unit = "{v.unit}")' if v.unit else ""
        about = f' "{v.description}"' if v.description and '"' not in v.description else ""
        lines.append(f"  {causality} Real {names[v.name]}{unit}{about};")
    given = [f"{_reference(p.name)} = {values[p.name]!r}" for p in inner.parameters if p.name in values]
    lines.append(f"  {cls} {PLANT}{_modifier(given)};")
    for placed in placed_laws:
        bound = [f"{p.name} = {placed.names[p.name]}" for p in placed.parameters()]
        lines.append(f"  {_law_name(placed)} {placed.instance}{_modifier(bound)};")
    for placed in placed_laws:
        lines += [
            f"  {line}" for line in class_text(placed.law, _law_name(placed), nominals=placed.all_nominals, signals={})
        ]
    lines += ["equation", *(f"  {e};" for e in _equations(places, placed_laws))]
    return "\n".join([*lines, f"end {name};", ""])


def _equations(places: FmuPlaces, placed_laws: Sequence[PlacedLaw]) -> Iterator[str]:
    """Yield the equations that wire the FMU and the laws."""
    inner, names, wires = places.inner, places.names, wiring(placed_laws)
    shown = {v.value_reference: v.name for v in inner.outputs}
    inside = {Signal.of(names[v.name]): _in_plant(v.name) for v in inner.outputs}
    inside |= {places.state_signal(s): _in_plant(shown.get(s.value_reference, s.name)) for s in inner.states}
    last = {(w.law.port.attachment, w.law.port.acted_on): _given(w.law) for w in wires if w.outermost}
    for k, v in enumerate(inner.inputs):
        at = ((w, added) for w in wires for added in w.added if added.port.balance and added.port.balance.equation == k)
        terms = (f" {'-' if added.sign > 0 else '+'} {w.law.instance}.{added.output}" for w, added in at)
        acting = last.get(("input", Signal.of(names[v.name])), names[v.name])
        yield f"{_in_plant(v.name)} = {acting}{''.join(terms)}"
    for wired in sorted(wires, key=lambda w: placed_laws.index(w.law)):
        for read in (read for read in wired.reads if read.input in wired.law.law.used_inputs):
            acting = str(read.signal) if read.raw else last.get(("input", read.signal), str(read.signal))
            value = inside.get(read.signal, acting) if read.after is None else _given(read.after)
            yield f"{wired.law.instance}.{read.input} = {value}"
    for v in inner.outputs:
        if v.kind == "real":
            yield f"{names[v.name]} = {last.get(('output', Signal.of(names[v.name])), _in_plant(v.name))}"


def _in_plant(name: str) -> str:
    return f"{PLANT}.{_reference(name)}"


def _given(placed: PlacedLaw) -> str:
    return f"{placed.instance}.{placed.law.interface.output}"


def _modifier(bound: Sequence[str]) -> str:
    return f"({', '.join(bound)})" if bound else ""


def _law_name(placed: PlacedLaw) -> str:
    return "".join(part.capitalize() for part in re.split(r"_+", placed.instance))


def _reference(name: str) -> str:
    """Return the name of a variable in Modelica, in quotes if it is no identifier."""
    return name if re.fullmatch(r"[A-Za-z_]\w*(\[\d+\])?(\.[A-Za-z_]\w*(\[\d+\])?)*", name) else f"'{name}'"


@dataclass(frozen=True)
class FmuFamily(ModelicaFamily):
    """An FMU, the base model, and the same FMU with laws around it."""

    places: FmuPlaces
    _fixed_values: dict[str, float] = field(default_factory=dict, compare=False, repr=False)

    def base_model(self) -> Model:
        """Return the FMU itself."""
        return self.places.inner

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Place the candidates; see the base class."""
        self._fixed_values.clear()
        self._fixed_values.update(calibration.fixed)
        return super().prepare(calibration, fit, open_simulator)

    def _nominals(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> PortNominals:
        """Compute nominal values from the fit. Those of a force are from its recording, or its nominal attribute."""
        inner = self.places.inner
        names = {v.name for v in inner.outputs if v.kind == "real"}
        states = [s.name for s in inner.states]
        found = simulated_signals(calibration, sorted({*names, *states}), fit, open_simulator)
        seen = {name: signal_nominal(parts) or 1.0 for name, parts in found.items()}
        given = {
            v.name: signal_nominal([s.values for s in recorded_inputs(calibration.data, v.name)]) or v.nominal or 1.0
            for v in inner.inputs
        }
        time = fastest_time_scale(calibration.data)
        nominals: dict[str, Mapping[str, float]] = {}
        for port in self.places.ports:
            if port.kind == "motion":
                assert port.balance is not None
                force = given[inner.inputs[port.balance.equation].name]
                speed, *position = (seen[s] for s in port.states)
                place = (*position, speed * time)[0]
                read = zip(("v", "x"), port.states, strict=False)
                twice = {f"{signal}_twice": share_visited_twice(found[s]) for signal, s in read}
                nominals[port.id] = {"f_n": force, "v_n": speed, "x_n": place, "x_w": place, "t_n": time, **twice}
            elif port.kind == "input":
                nominals[port.id] = {
                    "u_n": given[port.id],
                    "w_n": relative_change(recorded_inputs(calibration.data, port.id), time),
                    "t_n": time,
                }
            else:
                reading = port.id.removeprefix("output_")
                nominals[port.id] = {
                    "u_n": seen[reading],
                    **visited_range("u", found[reading]),
                    "u_twice": share_visited_twice(found[reading]),
                    "t_n": time,
                }
        return nominals

    def _opened(self) -> ProbedModel:
        return self.places.opened()

    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        return self._attached(placed_laws)

    def _sharper(self, placed_laws: Sequence[PlacedLaw], model: Model) -> Model | None:
        return None  # what is inside an FMU is not known

    def with_fitted(
        self, written: ExtendedModel, values: Mapping[str, float], added: Sequence[Parameter]
    ) -> ExtendedModel:
        """Write text and FMU again: both hold values."""
        own = {old: values[new] for pairs in written.names.values() for old, new in pairs if new in values}
        return self.extend(list(written.names), {**values, **own}, written.path.parent)

    def _write(
        self, placed_laws: Sequence[PlacedLaw], values: Mapping[str, float], folder: Path
    ) -> tuple[WrittenModel, Model]:
        """Write ``NAME.mo`` for other tools, and ``NAME.fmu``."""
        name = "_".join([self.places.title, *(u.instance for u in placed_laws)])
        values = {**self._fixed_values, **values}
        text = wrapper_text(self.places, placed_laws, values, name)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.mo"
        write_whole(path, text)
        couple(attached(self._opened(), placed_laws, self.blocks), folder / f"{name}.fmu")
        before = wrapper_text(self.places, (), values, name)
        written = WrittenModel(name, path, text, before, f"{self.places.title}.mo")
        return written, Model.load(folder / f"{name}.fmu")

    def _states_there(self, base: Model, model: Model) -> Mapping[str, str]:
        """Return names in a coupled model of states that are outputs, which may have others there."""
        there = {s.name for s in model.states}
        return {s.name: f"{s.name}{UNREAD_SUFFIX}" for s in self.places.inner.states if s.name not in there}
