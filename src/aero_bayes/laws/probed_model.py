"""A Modelica model with open ports, exported once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.laws.aliases import AliasStructure, alias_structure
from aero_bayes.laws.balance import Signal
from aero_bayes.laws.candidates import PlacedLaw, identifier
from aero_bayes.laws.coupled_fmu import BASE, INPUT, STATE, UNREAD_SUFFIX, LinearSum, Source
from aero_bayes.laws.law_models import LawModels
from aero_bayes.laws.probes import with_probe
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.compose import TRUE_SUFFIX, add_output
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Call
from aero_bayes.plain import Numbers
from aero_bayes.simulation.model import Model


def built_once(folder: Path, name: str, of: str, build: Callable[[Path], object]) -> Model:
    """Return the FMU in a folder that is built from something, whose hash is part of the file name."""
    out = folder / f"{name}-{hashlib.sha256(of.encode()).hexdigest()[:16]}.fmu"
    if not out.exists():
        folder.mkdir(parents=True, exist_ok=True)
        build(out)
    return Model.load(out)


@dataclass(frozen=True, eq=False)
class ProbedModel:
    """A model with open ports.

    ``inputs`` are its own, ``probes`` the inputs that stand for a law's output by the id of the port, which count
    ``gain`` times. ``signals`` and ``rates`` say where a signal and its derivative are found. ``copies`` has the
    states that outputs are as long as no probe acts on them."""

    model: Model
    inputs: tuple[str, ...]
    probes: Mapping[str, str]
    signals: Mapping[Signal, LinearSum]
    rates: Mapping[Signal, LinearSum] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    gain: float = 1.0
    copies: Mapping[str, int] = field(default_factory=dict)
    state_names: Sequence[str] = ()

    def output_needs(self, name: str) -> frozenset[str]:
        """Return the inputs on which an output depends at once."""
        return self.model.feedthrough.get(self.model.output(name).value_reference, frozenset())


#: Points at which a curve is evaluated.
CURVE_POINTS = 61


@dataclass(frozen=True, eq=False)
class LearnedCurve:
    """What a port gives over a signal: ``x``, ``value`` and its standard deviation ``sd``, shape (n,) each."""

    x: Numbers
    value: Numbers
    sd: Numbers
    x_unit: str = ""
    unit: str = ""


@dataclass(frozen=True, eq=False)
class CurveBasis:
    """Basis functions of a learned curve, which is linear in its heights."""

    x: FloatArray
    x_unit: str
    plain: FloatArray
    rows: FloatArray
    unit: str

    def learned(self, heights: FloatArray, covariance: FloatArray) -> LearnedCurve:
        """Return the curve of some heights (k,), and how sure it is by their covariance (k, k)."""
        sd = np.sqrt(np.maximum(np.einsum("kn,kl,ln->n", self.rows, covariance, self.rows), 0.0))
        return LearnedCurve(self.x, self.plain + heights @ self.rows, sd, self.x_unit, self.unit)


def curve_basis(placed: PlacedLaw, models: LawModels) -> CurveBasis:
    """Return the basis functions of a learned curve, over its nominal input range to both sides."""
    law, nominals = placed.law, placed.all_nominals
    model = causalise(translate(models[law.kind, law.id]))
    b, acts = model.system.builder, model.solved[law.interface.output]
    at = {b.symbol(p.name): p.binding.value for p in model.system.parameters if p.binding and p.binding.op == "const"}
    at |= {b.symbol(name): value for name, value in nominals.items()}
    heights = [b.symbol(p.name) for p in law.parameters]
    size = next(name for name, of in law.interface.nominals.items() if of == law.curve_input and name.endswith("_n"))
    x = nominals.get(f"{size[:-2]}_0", 0.0) + nominals[size] * np.linspace(-1.0, 1.0, CURVE_POINTS)

    def curve(on: int) -> list[float]:
        height = {symbol: float(k == on) for k, symbol in enumerate(heights)}
        return [evaluate_nodes([acts], {**at, **height, b.symbol(law.curve_input): float(value)})[0] for value in x]

    plain = np.array(curve(-1))
    rows = np.array([curve(k) for k in range(len(heights))]) - plain
    return CurveBasis(x, placed.port.units.get(law.curve_input, ""), plain, rows, placed.port.unit)


def states_by_base_name(
    model: Model, structure: AliasStructure, aliases: Mapping[str, str], outputs: Mapping[str, str]
) -> dict[str, str]:
    """Return the states of a model with laws, by names of the base model."""
    found: dict[str, str] = {}
    for s in model.states:
        # the variable that a law at an output reads has the value that the output had without the law
        before_law = s.name.removesuffix(UNREAD_SUFFIX).removesuffix(TRUE_SUFFIX).replace(f"{TRUE_SUFFIX}[", "[")
        base = outputs.get(s.name, before_law if s.name not in aliases else s.name)
        found.setdefault(aliases.get(base, base), s.name)
        if base in structure.variables:
            found.setdefault(structure.of(base), s.name)
    return found


def state_names(base_model: Model, structure: AliasStructure, states: Mapping[str, str]) -> dict[str, str]:
    """Return the name in a model with laws of each state of the base model."""
    known = {s.name: structure.of(s.name) for s in base_model.states if s.name in structure.variables}
    return {s: states.get(s, states.get(same, s)) for s, same in known.items()}


#: What the names of probe inputs, and of outputs that show a signal or its derivative, begin with.
PROBE, SIGNAL, RATE = "probe_", "signal_", "rate_of_"
#: Where classes of equal variables are in a model, and with which sign.
Places = Mapping[str, tuple[Source, int]]


def probed_model(
    base: Model,
    placed_laws: Sequence[PlacedLaw],
    closed: FlatModel,
    export: Callable[[FlatModel], Model],
    *,
    with_rates: bool = True,
) -> ProbedModel:
    """Return a model with its ports open for some laws. ``base`` is the same model without open ports, as ``closed``.

    Where a law acts at once on an output, the derivative of that output is not known: then no ``rates`` are."""
    every = [part for placed in placed_laws for part in placed.parts]
    ports = {p.id: p for part in every for p in (part.port, part.neighbour) if p is not None}
    probes: dict[str, str] = {}
    flat, structure = closed, alias_structure(closed)
    for port in ports.values():
        if port.attachment not in ("input", "output"):
            probes[port.id] = f"{PROBE}{identifier(port.id)}"
            flat = with_probe(flat, port, probes[port.id], 1.0)
    read = [given for port in ports.values() for given in port.signals.values()]
    signals = dict.fromkeys(one for given in read for _, one in given.parts)
    rated = dict.fromkeys(p.port.signals["u"] for p in every if p.law.needs_derivative and with_rates)
    copied = {v.name: k for v in base.outputs if (k := base.copied_state(v.name)) is not None}
    asked = [(SIGNAL, one) for one in signals] + [(RATE, one) for one in rated if str(one) not in copied]
    shown: dict[tuple[str, Signal], str] = {}
    places, model = _places(base, structure), base

    def is_known(kind: str, signal: Signal) -> bool:
        """Return whether a signal is a state or an input, and its derivative that of a state."""
        found = places.get(structure.of(str(signal)))
        return found is not None and (kind == SIGNAL or found[0].part == STATE)

    while missing := [key for key in asked if key not in shown and not is_known(*key)]:
        for kind, one in missing:
            tree, out = one.expression, f"{kind}{identifier(str(one))}"
            shown[kind, one] = out = f"{out}_{len(shown)}" if out in shown.values() else out
            flat = add_output(flat, out, tree if kind == SIGNAL else Call("der", (tree,)))
        try:
            model = export(flat)
        except InputError:
            if not rated:
                raise
            return probed_model(base, placed_laws, closed, export, with_rates=False)
        places = _places(model, structure)
    model = export(flat) if model is base else model
    places = _places(model, structure)
    positions = _base_states(base, places, structure)
    states = {s.value_reference: k for k, s in enumerate(model.states)}

    def found(kind: str, signal: Signal) -> LinearSum:
        name = str(signal)
        if kind == RATE and name in copied:
            return ((Source(BASE, model.derivatives[positions[copied[name]]]), 1.0),)
        if (kind, signal) in shown:
            reference = model.output(shown[kind, signal]).value_reference
            return ((Source(STATE, states[reference]) if reference in states else Source(BASE, reference), 1.0),)
        source, sign = places[structure.of(name)]
        gain = float(sign * structure.same.get(name, (name, 1))[1])
        return ((Source(BASE, model.derivatives[source.reference]) if kind == RATE else source, gain),)

    names = [s.name for s in model.states]
    for k, there in positions.items():
        names[there] = base.states[k].name
    # outputs that are states of the base are none while a probe acts on them
    copies = {n: positions[k] for n, k in copied.items() if model.output(n).value_reference not in states}
    return ProbedModel(
        model, tuple(v.name for v in model.inputs if v.name not in probes.values()), probes,
        {one: found(SIGNAL, one) for one in signals}, {one: found(RATE, one) for one in rated},
        frozenset(shown.values()), copies=copies, state_names=names,
    )  # fmt: skip


def _base_states(base: Model, there: Places, structure: AliasStructure) -> dict[int, int]:
    """Return the position in a model with open ports of each state of the base."""
    found = {}
    aliases = base.state_aliases
    for k, state in enumerate(base.states):
        names = [state.name, *(n for n, s in aliases.items() if s == state.name)]
        places = [there[structure.of(n)] for n in names if structure.of(n) in there]
        source = next((s for s, sign in places if s.part == STATE and sign > 0), None)
        if source is not None:
            found[k] = source.reference
    return found


def _places(model: Model, structure: AliasStructure) -> Places:
    """Return the classes of equal variables that are a state or an input of a model, and its sign there."""
    index = {s.name: k for k, s in enumerate(model.states)}
    names = [*((s, s) for s in index), *model.state_aliases.items()]
    found = [(name, Source(STATE, index[state])) for name, state in names]
    found += [(v.name, Source(INPUT, k)) for k, v in enumerate(v for v in model.inputs if not v.name.startswith(PROBE))]
    places: dict[str, tuple[Source, int]] = {}
    for name, source in found:
        if name in structure.variables:
            places.setdefault(structure.of(name), (source, structure.same.get(name, (name, 1))[1]))
    return places
