"""Laws attached to a model whose ports are open: which value of the one goes where in the other.

The base is exported once, with a probe input at every balance and internal signal and an output for each signal that is
neither a state nor an input. A law is an FMU of its own. A structure couples them (``coupled_fmu.py``), so that it has
the states and parameters of its own terms only."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.laws.balance import Attachment, Signal
from aero_bayes.laws.candidates import PlacedLaw
from aero_bayes.laws.coupled_fmu import (
    BASE,
    INPUT,
    STATE,
    AttachedLaw,
    Coupling,
    LinearSum,
    Relay,
    Setting,
    SignalOperator,
    Source,
)
from aero_bayes.laws.held_step import step_of, with_held_step
from aero_bayes.laws.law import Law
from aero_bayes.laws.law_models import LawModels
from aero_bayes.laws.probed_model import ProbedModel, built_once
from aero_bayes.laws.wiring import Read, WiredLaw, wiring
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.codegen import HELD
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import Node
from aero_bayes.modelica.flat import FlatModel, FlatVariable
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
                name = f"{law.kind}_{law.id}"
                build = partial(export_flat, replace(flat, name=name))
                self._exported[key] = built_once(self.folder, f"law-{name}", repr(flat), build)
            except InputError as error:
                raise AlgebraicLoopError(f"{placed.id}: {error}") from None
        return self._exported[key]

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

    def as_signal(v: FlatVariable) -> FlatVariable:
        if v.name in law.interface.inputs:
            return replace(v, causality="input", binding=None)
        return replace(v, causality="output" if v.name in outputs and "." not in v.name else "local")

    equations = tuple(replace(e, left=without_rates(e.left), right=without_rates(e.right)) for e in flat.equations)
    variables = [*map(as_signal, flat.variables)]
    variables += [FlatVariable(name + RATE_SUFFIX, causality="input") for name in sorted(rated)]
    return replace(flat, name=f"{law.kind}_{law.id}", variables=tuple(variables), equations=equations)


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


def attached(base: ProbedModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks) -> Coupling:
    """Couple a model with laws at its ports. Raises AlgebraicLoopError where they have to be solved together."""
    return _Attaching(base, placed_laws, blocks).coupling()


def _apart(operators: Sequence[SignalOperator], laws: Sequence[AttachedLaw]) -> list[SignalOperator]:
    """Return the operators that share no parameter, as laws at like places do, with a law in the equations."""
    acting = {k for o in operators for k in o.laws}
    inside = {v.name for k, law in enumerate(laws) if k not in acting for v in law.parameters.values()}
    kept = [o for o in operators if inside.isdisjoint(v.name for k in o.laws for v in laws[k].parameters.values())]
    return kept if len(kept) == len(operators) else _apart(kept, laws)


class _Attaching:
    def __init__(self, base: ProbedModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks) -> None:
        self.base, self.placed, self.blocks = base, placed_laws, blocks
        self.wires = {wired.law.instance: wired for wired in wiring(placed_laws)}
        self.parts = {placed.instance: k for k, placed in enumerate(placed_laws, 1)}
        self.acting: dict[str, LinearSum] = {name: ((Source(INPUT, k), 1.0),) for k, name in enumerate(base.inputs)}
        self.changed: dict[Signal, LinearSum] = {}
        self.probed: dict[str, LinearSum] = {}
        self.outputs: dict[Signal, Source] = {}
        self.given: dict[str, LinearSum] = {}
        self.settings: list[Setting] = []

    def coupling(self) -> Coupling:
        here: dict[Attachment, list[WiredLaw]] = {"input": [], "output": []}
        waiting: list[WiredLaw] = []
        for wired in self.wires.values():
            here.get(wired.law.port.attachment, waiting).append(wired)
        for wired in here["input"]:
            self._feed(wired)
            if wired.outermost:
                self.acting[self.base.inputs[self._acted_on(wired).reference]] = ((self._acts(wired.law), 1.0),)
        while waiting:
            ready = next((w for w in waiting if not self._awaits(w, waiting)), None)
            if ready is None:
                raise AlgebraicLoopError(" and ".join(w.law.id for w in waiting))
            waiting.remove(ready)
            self._place(ready)
        self._set_base()
        for wired in here["output"]:
            self._feed(wired)
            self.outputs[wired.law.port.signals["u"]] = self._acts(wired.law)
        outputs = {self._output_behind(signal): source for signal, source in self.outputs.items()}
        for name, k in self.base.copies.items():
            if not self.base.output_needs(name) & self.probed.keys():
                outputs.setdefault(name, Source(STATE, k))
        laws = [self.blocks.attached(placed) for placed in self.placed]
        chains: dict[tuple[Attachment, Signal], list[WiredLaw]] = {}
        for wired in (*here["input"], *here["output"]):
            port = wired.law.port
            chains.setdefault((port.attachment, port.signals["u"]), []).append(wired)
        operators = [o for chain in chains.values() for o in self._operators(chain)]
        base = self.base
        return Coupling(
            base.model, laws, self.settings, base.inputs, outputs, base.hidden, base.state_names,
            _apart(operators, laws), self._relay(),
        )  # fmt: skip

    def _relay(self) -> Relay | None:
        """Return the first law that steps by the sign of a sum of states, and this sum."""
        for k, placed in enumerate(self.placed):
            if all(v.name != HELD for v in self.blocks.model(placed).inputs):
                continue
            step = step_of(self.blocks.models[placed.law.kind, placed.law.id], placed.law)
            terms = self._read(self.wires[placed.instance]).get(step[0].name, ()) if step is not None else ()
            if terms and all(source.part == STATE for source, _ in terms):
                return Relay(k, terms)
        return None

    def _operators(self, chain: Sequence[WiredLaw]) -> Iterator[SignalOperator]:
        """Yield the operator that is the first laws at an input, or the last ones at an output.

        These have no states and read nothing but the signal. One law at an input may remember it instead; before those
        at an output one may delay a state."""
        port, laws = chain[0].law.port, [wired.law for wired in chain]
        parts = tuple(self.parts[placed.instance] - 1 for placed in laws)
        functions, memory = [self._is_function(placed) for placed in laws], laws[0].law.memory
        if port.attachment == "input":
            count = (*functions, False).index(False)
            if count or memory:
                yield SignalOperator(parts[: count or 1], self._acted_on(chain[0]), memory="" if count else memory)
            return
        first = len(laws) - (*functions[::-1], False).index(False)
        terms = self._read(chain[0]).get("u", ())
        source = terms[0][0] if len(terms) == 1 and terms[0][1] == 1.0 else None
        delays = bool(memory) and source is not None and source.part == STATE and first <= 1
        if delays:
            first = 0
        elif first == 0 and (source is None or source.part == INPUT):
            first = 1
        if first < len(laws):
            source = source if first == 0 and source is not None else self._acts(laws[first - 1])
            yield SignalOperator(
                parts[first:], source, self._output_behind(port.signals["u"]), memory if delays else ""
            )

    def _is_function(self, placed: PlacedLaw) -> bool:
        """Return whether a law has no states and reads nothing but the signal on which it acts."""
        model = self.blocks.model(placed)
        return [v.name for v in model.inputs] == ["u"] and not (model.states or model.event_indicators)

    def _acted_on(self, wired: WiredLaw) -> Source:
        """Return the variable that the signal is on which a law acts."""
        ((source, _),) = self.base.signals[wired.law.port.signals["u"]]
        return source

    def _output_behind(self, signal: Signal) -> str:
        """Return the output behind the name of a signal: an FMU's output may be no identifier."""
        outputs = self.base.model.outputs
        if any(v.name == str(signal) for v in outputs):
            return str(signal)
        ((source, _),) = self.base.signals[signal]
        states = self.base.model.states
        reference = states[source.reference].value_reference if source.part == STATE else source.reference
        return next(v.name for v in outputs if v.value_reference == reference)

    def _acts(self, placed: PlacedLaw, output: str = "") -> Source:
        variable = self.blocks.model(placed).output(output or placed.law.interface.output)
        return Source(self.parts[placed.instance], variable.value_reference)

    def _terms(self, signal: Signal, *, raw: bool) -> LinearSum:
        """Return a signal, or the variables that it adds up, by values that are known."""
        if signal in self.changed and not raw:
            return self.changed[signal]
        if signal not in self.base.signals:
            parts = ((sign, self._terms(part, raw=raw)) for sign, part in signal.parts)
            return tuple((source, sign * gain) for sign, terms in parts for source, gain in terms)
        found: list[tuple[Source, float]] = []
        for source, gain in self.base.signals[signal]:
            if source.part == INPUT and not raw:
                acting = self.acting[self.base.inputs[source.reference]]
                found += [(inner, gain * factor) for inner, factor in acting]
            else:
                found.append((source, gain))
        return tuple(found)

    def _value(self, read: Read) -> LinearSum:
        """Return what an input of a law is set to."""
        return self._terms(read.signal, raw=read.raw) if read.after is None else ((self._acts(read.after), 1.0),)

    def _read(self, wired: WiredLaw) -> dict[str, LinearSum]:
        """Return what each input of a law's FMU is set to."""
        inputs = {v.name for v in self.blocks.model(wired.law).inputs}
        found = {}
        for read in wired.reads:
            rate, output = f"{read.input}{RATE_SUFFIX}", str(read.signal)
            if read.input in inputs:
                found[read.input] = self._value(read)
            if rate in inputs:
                changed = output in self.base.copies and self.base.output_needs(output) & self.probed.keys()
                if read.after is not None or changed or read.signal not in self.base.rates:
                    raise AlgebraicLoopError(wired.law.id)
                found[rate] = self.base.rates[read.signal]
        return found

    def _feed(self, wired: WiredLaw) -> None:
        model, part = self.blocks.model(wired.law), self.parts[wired.law.instance]
        for name, terms in self._read(wired).items():
            self.settings.append(Setting(part, model.input(name).value_reference, terms))

    def _awaits(self, wired: WiredLaw, waiting: Sequence[WiredLaw]) -> bool:
        """Return whether a law needs what another law that waits, or itself, gives."""
        sources = [source for terms in self._read(wired).values() for source, _ in terms]
        depends = self.base.model.feedthrough
        needs = frozenset[str]().union(*(depends.get(s.reference, frozenset()) for s in sources if s.part == BASE))
        probes = {self.base.probes[p.id] for other in waiting for p in other.ports}
        return bool(needs & probes) or any(r.after is other.law for r in wired.reads for other in waiting)

    def _place(self, wired: WiredLaw) -> None:
        if any(s.part == BASE for terms in self._read(wired).values() for s, _ in terms):
            self._set_base()
        self._feed(wired)
        for added in wired.added:
            self._probe(added.port.id, ((self._acts(wired.law, added.output), float(added.sign)),))
        if (signal := wired.law.port.acted_on) is not None:
            acts = ((self._acts(wired.law), 1.0),)
            (before,) = (self._value(read) for read in wired.reads if read.input == "u")
            self._probe(wired.law.port.id, (*acts, *((source, -gain) for source, gain in before)))
            self.changed[signal] = acts

    def _probe(self, port: str, terms: LinearSum) -> None:
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
