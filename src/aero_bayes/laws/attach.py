"""Laws attached to a model whose ports are open: which value of the one goes where in the other.

The base is exported once, with a probe input at every balance and internal signal and an output for each signal that is
neither a state nor an input. A law is an FMU of its own. A structure couples them (``coupled_fmu.py``), so that it has
the states and parameters of its own terms only."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.laws.balance import Port, signal_parts
from aero_bayes.laws.candidates import PlacedLaw
from aero_bayes.laws.coupled_fmu import (
    BASE,
    INPUT,
    STATE,
    AttachedLaw,
    Coupling,
    Relay,
    Setting,
    SignalOperator,
    Source,
    Terms,
)
from aero_bayes.laws.held_step import step_of, with_held_step
from aero_bayes.laws.law import Law
from aero_bayes.laws.law_models import LawModels
from aero_bayes.laws.open_ports import OpenModel
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.codegen import HELD
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import Node
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, map_children
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable

#: Suffix of the input that is the derivative of another input.
RATE_SUFFIX = "_rate"


class AlgebraicLoopError(Exception):
    """A law and the model have to be solved together, so that it cannot be attached."""


@dataclass(frozen=True, eq=False)
class LawBlocks:
    """The FMUs of laws: inputs are what a law reads, parameters its sizes and what is fitted."""

    models: LawModels
    folder: Path
    _exported: dict[tuple[str, str], Model] = field(default_factory=dict, repr=False)

    def model(self, placed: PlacedLaw) -> Model:
        """Return the FMU of a law. Raises AlgebraicLoopError where it cannot be solved for what it gives."""
        law = placed.law
        key = (law.kind, law.id)
        if key not in self._exported:
            try:
                flat = _simplified(with_held_step(_with_fitted(_block(law, self.models[key]), law), law))
                self._exported[key] = self._export(flat, f"{law.kind}_{law.id}")
            except InputError as error:
                raise AlgebraicLoopError(f"{placed.id}: {error}") from None
        return self._exported[key]

    def step_input(self, placed: PlacedLaw) -> str | None:
        """Return the input of a law's FMU by whose sign it steps, if its step may be held."""
        if all(v.name != HELD for v in self.model(placed).inputs):
            return None
        step = step_of(self.models[placed.law.kind, placed.law.id], placed.law)
        assert step is not None
        return step[0].name

    def attached(self, placed: PlacedLaw) -> AttachedLaw:
        """Return the FMU of a placed law, with its parameters and sizes."""
        model, sizes = self.model(placed), placed.all_nominals
        shown = {}
        for p in placed.parameters():
            limits = placed.limits(p)
            shown[p.name] = Variable(
                placed.names[p.name], placed.unit(p), f"{p.description} at {placed.port.id}", placed.value(p),
                limits.get("min"), limits.get("max"), limits.get("nominal"), 0,
            )  # fmt: skip
        own = {v.name for v in (*model.parameters, *model.inputs)}
        values = {**sizes, **placed.signal_defaults, **{p.name: placed.value(p) for p in placed.parameters()}}
        given = {name: x for name, x in values.items() if name in own}
        flat = self.models[placed.law.kind, placed.law.id]
        nominals = tuple(attribute_value(flat, s.name, "nominal", sizes) for s in model.states)
        return AttachedLaw(placed.instance, model, shown, given, nominals)

    def _export(self, flat: FlatModel, name: str) -> Model:
        key = hashlib.sha256(repr(flat).encode()).hexdigest()[:16]
        out = self.folder / f"law-{name}-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            export_flat(replace(flat, name=name), out)
        return Model.load(out)


def can_be_attached(placed: PlacedLaw) -> bool:
    """Return whether a law can be an FMU of its own: not one that gives a force by the acceleration."""
    return not placed.law.needs_derivative or placed.port.attachment == "output"


def _block(law: Law, flat: FlatModel) -> FlatModel:
    """Return a law as a model with inputs and outputs. The derivative of an input is a further input."""
    rated = law.differentiated & set(law.interface.inputs)
    outputs = {law.interface.output, *(v.name for v in flat.variables if v.causality == "output")}

    def without_rates(tree: Expression) -> Expression:
        match tree:
            case Call("der", (Name(name, ()),)) if name in rated:
                return Name(name + RATE_SUFFIX)
        return map_children(tree, without_rates)

    equations = tuple(_changed(e, without_rates) for e in flat.equations)
    variables = [_as_signal(v, law, outputs) for v in flat.variables]
    variables += [FlatVariable(name + RATE_SUFFIX, causality="input") for name in sorted(rated)]
    return replace(flat, name=f"{law.kind}_{law.id}", variables=tuple(variables), equations=equations)


def _changed(e: FlatEquation, change: Callable[[Expression], Expression]) -> FlatEquation:
    return replace(e, left=change(e.left), right=change(e.right))


def _as_signal(v: FlatVariable, law: Law, outputs: set[str]) -> FlatVariable:
    if v.name in law.interface.inputs:
        return replace(v, causality="input", binding=None)
    return replace(v, causality="output" if v.name in outputs and "." not in v.name else "local")


def _with_fitted(flat: FlatModel, law: Law) -> FlatModel:
    """Return a law with values of its fitted parameters that do not depend on the sizes."""
    nominals = {**law.nominals, "h_z": 0.0}
    values = {p.name: Number(p.value("default", nominals)) for p in (*law.parameters, *law.starts)}
    variables = (replace(v, binding=values[v.name], attributes={}) if v.name in values else v for v in flat.variables)
    return replace(flat, variables=tuple(variables))


def _simplified(flat: FlatModel) -> FlatModel:
    """Return a law without inputs that change nothing and outputs that are zero."""
    solved = causalise(translate(flat))
    b = solved.system.builder
    acts = {v.name: solved.solved.get(v.name, b.symbol(v.name)) for v in flat.variables if v.causality == "output"}
    nodes = (*solved.rates, *solved.starts, *acts.values(), *solved.loop_and_event_expressions)
    used = frozenset[Node]().union(*(b.symbols(node) for node in nodes))

    def kept(v: FlatVariable) -> FlatVariable:
        if v.causality == "input" and b.symbol(v.name) not in used:
            return replace(v, causality="local", variability="constant", binding=Number(0.0))
        return replace(v, causality="local") if v.causality == "output" and acts[v.name] is b.zero else v

    return replace(flat, variables=tuple(map(kept, flat.variables)))


def attached(base: OpenModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks) -> Coupling:
    """Couple a model with laws at its ports. Raises AlgebraicLoopError where they have to be solved together.

    Of several laws at one input the first one acts last, of those at one output the last one."""
    return _Attaching(base, placed_laws, blocks).coupling()


def _apart(operators: Sequence[SignalOperator], laws: Sequence[AttachedLaw]) -> list[SignalOperator]:
    """Return the operators that share no parameter, as laws at like places do, with a law in the equations."""
    acting = {k for o in operators for k in o.laws}
    inside = {v.name for k, law in enumerate(laws) if k not in acting for v in law.parameters.values()}
    kept = [o for o in operators if inside.isdisjoint(v.name for k in o.laws for v in laws[k].parameters.values())]
    return kept if len(kept) == len(operators) else _apart(kept, laws)


class _Attaching:
    #: What a law at an input acts on.
    SIGNAL = "u"

    def __init__(self, base: OpenModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks) -> None:
        self.base, self.placed, self.blocks = base, placed_laws, blocks
        self.acting: dict[str, Terms] = {name: ((Source(INPUT, k), 1.0),) for k, name in enumerate(base.inputs)}
        self.changed: dict[str, Terms] = {}
        self.probed: dict[str, Terms] = {}
        self.outputs: dict[str, Source] = {}
        self.given: dict[str, Terms] = {}
        self.settings: list[Setting] = []

    def coupling(self) -> Coupling:
        here: dict[str, list[PlacedLaw]] = {"input": [], "output": []}
        inside: list[PlacedLaw] = []
        for placed in self.placed:
            here.get(placed.port.attachment, inside).append(placed)
        operators: dict[str, SignalOperator] = {}
        for placed in reversed(here["input"]):
            self._feed(placed)
            self._note_operator(placed, operators)
            self.acting[self._own_input(placed.port)] = ((self._acts(placed), 1.0),)
        waiting = inside[::-1]
        while waiting:
            ready = next((p for p in waiting if not self._awaits(p, waiting)), None)
            if ready is None:
                raise AlgebraicLoopError(" and ".join(p.id for p in waiting))
            waiting.remove(ready)
            self._place(ready)
        self._set_base()
        behind: dict[str, SignalOperator] = {}
        for placed in here["output"]:
            self._feed(placed)
            self._note_output_operator(placed, behind)
            self.outputs[placed.port.signals["u"]] = self._acts(placed)
        outputs = {self._output_behind(name): source for name, source in self.outputs.items()}
        for name, k in self.base.copies.items():
            if not self.base.output_needs(name) & self.probed.keys():
                outputs.setdefault(name, Source(STATE, k))
        laws = [self.blocks.attached(placed) for placed in self.placed]
        base = self.base
        return Coupling(
            base.model, laws, self.settings, base.inputs, outputs, base.hidden, base.state_names,
            _apart([*operators.values(), *behind.values()], laws),
            self._relay(),
        )  # fmt: skip

    def _relay(self) -> Relay | None:
        """Return the first law that steps by the sign of a sum of states, and this sum."""
        for k, placed in enumerate(self.placed):
            name = self.blocks.step_input(placed)
            terms = self._read(placed).get(name, ()) if name is not None else ()
            if terms and all(source.part == STATE for source, _ in terms):
                return Relay(k, terms)
        return None

    def _is_function(self, placed: PlacedLaw) -> bool:
        """Return whether a law has no states and reads nothing but the signal on which it acts."""
        model = self.blocks.model(placed)
        return [v.name for v in model.inputs] == [self.SIGNAL] and not (model.states or model.event_indicators)

    def _note_output_operator(self, placed: PlacedLaw, operators: dict[str, SignalOperator]) -> None:
        """Note a law that delays a state, or is a function of what is read or of what such laws make of it."""
        signal = placed.port.signals[self.SIGNAL]
        before = operators.pop(signal, None)
        terms = self._read(placed).get(self.SIGNAL, ())
        if len(terms) != 1 or terms[0][1] != 1.0:
            return
        own, source, memory = self._part(placed) - 1, terms[0][0], placed.law.memory
        if memory and before is None and source.part == STATE:
            operators[signal] = SignalOperator((own,), source, self._output_behind(signal), memory)
        elif not self._is_function(placed):
            return
        elif before is not None:
            operators[signal] = replace(before, laws=(*before.laws, own))
        elif source.part != INPUT:
            operators[signal] = SignalOperator((own,), source, self._output_behind(signal))

    def _note_operator(self, placed: PlacedLaw, operators: dict[str, SignalOperator]) -> None:
        """Note a law that acts on a recorded signal alone: one that remembers it, or one without states, which may also
        act on what such laws make of it."""
        own = self._own_input(placed.port)
        k = self.base.inputs.index(own)
        before = operators[own].laws if own in operators else ()
        source = self._acts(self.placed[before[-1]]) if before else Source(INPUT, k)
        if self.acting[own] != ((source, 1.0),):
            return
        if self._is_function(placed) and not (before and operators[own].memory):
            operators[own] = SignalOperator((*before, self._part(placed) - 1), Source(INPUT, k))
        elif not before and placed.law.memory:
            operators[own] = SignalOperator((self._part(placed) - 1,), Source(INPUT, k), memory=placed.law.memory)

    def _output_behind(self, signal: str) -> str:
        """Return the output behind the name of a signal: an FMU's output may be no identifier."""
        if any(v.name == signal for v in self.base.model.outputs):
            return signal
        ((source, _),) = self.base.signals[signal]
        states = self.base.model.states
        reference = states[source.reference].value_reference if source.part == STATE else source.reference
        return next(v.name for v in self.base.model.outputs if v.value_reference == reference)

    def _own_input(self, port: Port) -> str:
        ((source, _),) = self.base.signals[port.signals["u"]]
        return self.base.inputs[source.reference]

    def _part(self, placed: PlacedLaw) -> int:
        return 1 + next(k for k, other in enumerate(self.placed) if other is placed)

    def _acts(self, placed: PlacedLaw, output: str = "") -> Source:
        model = self.blocks.model(placed)
        return Source(self._part(placed), model.output(output or placed.law.interface.output).value_reference)

    def _terms(self, signal: str) -> Terms:
        """Return a signal, or the variables that it adds up, by values that are known; inputs as they act."""
        if signal in self.changed:
            return self.changed[signal]
        if signal not in self.base.signals:
            return tuple(
                (source, sign * gain) for sign, part in signal_parts(signal) for source, gain in self._terms(part)
            )
        found: list[tuple[Source, float]] = []
        for source, gain in self.base.signals[signal]:
            if source.part == INPUT:
                acting = self.acting[self.base.inputs[source.reference]]
                found += [(inner, gain * factor) for inner, factor in acting]
            else:
                found.append((source, gain))
        return tuple(found)

    def _read(self, placed: PlacedLaw) -> dict[str, Terms]:
        """Return what each input of a law is set to."""
        inputs = {v.name for v in self.blocks.model(placed).inputs}
        found = {}
        for name, signal in placed.read.items():
            if name in inputs:
                outer = self.outputs.get(signal) if placed.port.attachment == "output" else None
                found[name] = self._terms(signal) if outer is None else ((outer, 1.0),)
            if f"{name}{RATE_SUFFIX}" in inputs:
                changed = signal in self.outputs or (
                    signal in self.base.copies and self.base.output_needs(signal) & self.probed.keys()
                )
                if changed or signal not in self.base.rates:
                    raise AlgebraicLoopError(placed.id)
                found[f"{name}{RATE_SUFFIX}"] = self.base.rates[signal]
        return found

    def _feed(self, placed: PlacedLaw) -> None:
        model, part = self.blocks.model(placed), self._part(placed)
        terms = self._read(placed)
        self.settings += [Setting(part, model.input(name).value_reference, own) for name, own in terms.items()]

    def _needs(self, placed: PlacedLaw) -> frozenset[str]:
        """Return the inputs of the base on which what a law reads depends at once."""
        sources = [source for terms in self._read(placed).values() for source, _ in terms]
        return frozenset[str]().union(*(self.base.needs.get(s, frozenset()) for s in sources if s.part == BASE))

    def _probes_of(self, placed: PlacedLaw) -> set[str]:
        return {self.base.probes[port.id] for port, _, _ in placed.terms}

    def _awaits(self, placed: PlacedLaw, waiting: Sequence[PlacedLaw]) -> bool:
        """Return whether a law needs what another law that waits, or itself, gives."""
        needs = self._needs(placed)
        return any(needs & self._probes_of(other) for other in waiting)

    def _place(self, placed: PlacedLaw) -> None:
        if any(s.part == BASE for terms in self._read(placed).values() for s, _ in terms):
            self._set_base()
        self._feed(placed)
        port, signals = placed.port, placed.port.signals
        if port.defining_equation is not None:
            before, acts = self._terms(signals["u"]), self._acts(placed)
            self._probe(port.id, ((acts, 1.0), *((source, -gain) for source, gain in before)))
            self.changed[signals["u"]] = ((acts, 1.0),)
            return
        for balance, output, sign in placed.terms:
            self._probe(balance.id, ((self._acts(placed, output), float(sign)),))

    def _probe(self, port: str, terms: Terms) -> None:
        name = self.base.probes[port]
        self.probed[name] = self.probed.get(name, ()) + tuple((s, self.base.gain * gain) for s, gain in terms)

    def _set_base(self) -> None:
        """Set the inputs of the base as far as they are known."""
        model = self.base.model
        names = [*self.base.inputs, *(name for name in self.probed if name not in self.base.inputs)]
        for name in names:
            terms = self.acting.get(name, ()) + self.probed.get(name, ())
            if self.given.get(name) != terms:
                self.given[name] = terms
                self.settings.append(Setting(BASE, model.input(name).value_reference, terms))
