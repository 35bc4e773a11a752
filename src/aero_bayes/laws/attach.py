"""Laws attached to a model whose ports are open: which value of the one goes where in the other.

The base is exported once, with a probe input at every balance and internal signal and an output for each signal that is
neither a state nor an input. A law is an FMU of its own. A structure couples them (``coupled_fmu.py``), so that it has
the states and parameters of its own terms only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.laws.coupled_fmu import BASE, INPUT, Coupling, Setting, Source, Terms
from aero_bayes.laws.law_blocks import RATE_SUFFIX, LawBlocks
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.ports.port import DIFFERENCE, Port
from aero_bayes.simulation import Model


class AlgebraicLoopError(Exception):
    """What a law reads depends at once on what it gives back, so that it cannot be attached."""


@dataclass(frozen=True, eq=False)
class OpenModel:
    """A model with open ports.

    ``inputs`` are its own, ``probes`` the inputs that stand for a law's output by the id of the port, which count
    ``gain`` times. ``signals`` and ``rates`` say where a signal and its derivative are found. ``needs`` has the inputs
    on which outputs depend at once."""

    model: Model
    inputs: tuple[str, ...]
    probes: Mapping[str, str]
    signals: Mapping[str, Terms]
    rates: Mapping[str, Terms] = field(default_factory=dict)
    needs: Mapping[Source, frozenset[str]] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    gain: float = 1.0


def attached(base: OpenModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks) -> Coupling:
    """Couple a model with laws at its ports. Raises AlgebraicLoopError where they have to be solved together.

    Of several laws at one input the first one acts last, of those at one output the last one."""
    return _Attaching(base, placed_laws, blocks).coupling()


class _Attaching:
    def __init__(self, base: OpenModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks) -> None:
        self.base, self.blocks = base, blocks
        self.placed = list(placed_laws)
        self.part = {id(placed): k for k, placed in enumerate(self.placed, 1)}
        self.acting: dict[str, Terms] = {name: ((Source(INPUT, k), 1.0),) for k, name in enumerate(base.inputs)}
        self.changed: dict[str, Terms] = {}
        self.probed: dict[str, Terms] = {}
        self.outputs: dict[str, Source] = {}
        self.settings: list[Setting] = []

    def coupling(self) -> Coupling:
        here = {"input": [], "output": []}  # type: dict[str, list[PlacedLaw]]
        inside: list[PlacedLaw] = []
        for placed in self.placed:
            here.get(placed.port.attachment, inside).append(placed)
        for placed in reversed(here["input"]):
            self._feed(placed)
            self.acting[self._own_input(placed.port)] = ((self._acts(placed), 1.0),)
        waiting = list(reversed(inside))
        while waiting:
            ready = next((p for p in waiting if not self._awaits(p, waiting)), None)
            if ready is None:
                raise AlgebraicLoopError(" and ".join(p.id for p in waiting))
            waiting.remove(ready)
            self._place(ready)
        self._set_base()
        for placed in here["output"]:
            self._feed(placed)
            self.outputs[placed.port.signals["u"]] = self._acts(placed)
        laws = [self.blocks.attached(placed) for placed in self.placed]
        own = {v.name: v.name for v in self.base.model.outputs}
        outputs = {self._output_name(name, own): source for name, source in self.outputs.items()}
        return Coupling(self.base.model, laws, self.settings, self.base.inputs, outputs, self.base.hidden)

    def _output_name(self, signal: str, own: Mapping[str, str]) -> str:
        """Return the output behind the name of a signal: an FMU's output may be no identifier."""
        if signal in own:
            return signal
        ((source, _),) = self.base.signals[signal]
        reference = self.base.model.states[source.reference].value_reference if source.part < 0 else source.reference
        return next(v.name for v in self.base.model.outputs if v.value_reference == reference)

    def _own_input(self, port: Port) -> str:
        ((source, _),) = self.base.signals[port.signals["u"]]
        return self.base.inputs[source.reference]

    def _acts(self, placed: PlacedLaw, output: str = "") -> Source:
        model = self.blocks.model(placed.law)
        return Source(self.part[id(placed)], model.output(output or placed.law.interface.output).value_reference)

    def _terms(self, signal: str) -> Terms:
        """Return a signal, the difference of two variables maybe, by values that are known; inputs as they act."""
        one, minus, other = signal.partition(DIFFERENCE)
        if minus:
            return (*self._terms(one), *((source, -gain) for source, gain in self._terms(other)))
        if signal in self.changed:
            return self.changed[signal]
        found: list[tuple[Source, float]] = []
        for source, gain in self.base.signals[signal]:
            if source.part == INPUT:
                acting = self.acting[self.base.inputs[source.reference]]
                found += [(inner, gain * factor) for inner, factor in acting]
            else:
                found.append((source, gain))
        return tuple(found)

    def _given(self, placed: PlacedLaw) -> dict[str, str]:
        """Return the signal of the model that each input of a law is."""
        given = dict(placed.port.signals)
        if placed.law.kind == "exchange" and placed.neighbour is not None:
            given = {"h_1": placed.port.signals["h"], "h_2": placed.neighbour.signals["h"]}
        inputs = {v.name for v in self.blocks.model(placed.law).inputs}
        return {name: signal for name, signal in given.items() if name in inputs or f"{name}{RATE_SUFFIX}" in inputs}

    def _read(self, placed: PlacedLaw) -> dict[str, Terms]:
        """Return what each input of a law is set to."""
        inputs = {v.name for v in self.blocks.model(placed.law).inputs}
        given = self._given(placed)
        found = {}
        for name, signal in given.items():
            if name in inputs:
                outer = self.outputs.get(signal) if placed.port.attachment == "output" else None
                found[name] = self._terms(signal) if outer is None else ((outer, 1.0),)
            if f"{name}{RATE_SUFFIX}" in inputs:
                if signal not in self.base.rates or signal in self.outputs:
                    raise AlgebraicLoopError(placed.id)
                found[f"{name}{RATE_SUFFIX}"] = self.base.rates[signal]
        return found

    def _feed(self, placed: PlacedLaw) -> None:
        model, part = self.blocks.model(placed.law), self.part[id(placed)]
        terms = self._read(placed)
        self.settings += [Setting(part, model.input(name).value_reference, own) for name, own in terms.items()]

    def _needs(self, placed: PlacedLaw) -> frozenset[str]:
        """Return the inputs of the base on which what a law reads depends at once."""
        sources = [source for terms in self._read(placed).values() for source, _ in terms]
        return frozenset[str]().union(*(self.base.needs.get(s, frozenset()) for s in sources if s.part == BASE))

    def _probes_of(self, placed: PlacedLaw) -> set[str]:
        ports = [placed.port, *([placed.neighbour] if placed.neighbour is not None else [])]
        return {self.base.probes[p.id] for p in ports}

    def _awaits(self, placed: PlacedLaw, waiting: Sequence[PlacedLaw]) -> bool:
        """Return whether a law needs what another law that waits, or itself, gives."""
        needs = self._needs(placed)
        return any(needs & self._probes_of(other) for other in waiting)

    def _place(self, placed: PlacedLaw) -> None:
        if any(s.part == BASE for terms in self._read(placed).values() for s, _ in terms):
            self._set_base()
        self._feed(placed)
        port, acts = placed.port, self._acts(placed)
        if port.defining_equation is not None:
            before = self._terms(port.signals["u"])
            self._probe(port, ((acts, 1.0), *((source, -gain) for source, gain in before)))
            self.changed[port.signals["u"]] = ((acts, 1.0),)
            return
        self._probe(port, ((acts, 1.0),))
        if placed.neighbour is not None:
            other = self._acts(placed, "q_2") if placed.law.kind == "overflow" else acts
            self._probe(placed.neighbour, ((other, -1.0),))

    def _probe(self, port: Port, terms: Terms) -> None:
        name = self.base.probes[port.id]
        self.probed[name] = self.probed.get(name, ()) + tuple((s, self.base.gain * gain) for s, gain in terms)

    def _set_base(self) -> None:
        """Set the inputs of the base as far as they are known."""
        model = self.base.model
        names = [*self.base.inputs, *(name for name in self.probed if name not in self.base.inputs)]
        for name in names:
            terms = self.acting.get(name, ()) + self.probed.get(name, ())
            self.settings.append(Setting(BASE, model.input(name).value_reference, terms))
