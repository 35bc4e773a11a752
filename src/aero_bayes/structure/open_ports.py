"""A Modelica model with open ports, exported once; replaceable models are open ports, too.

A law of a replaceable model reads the potentials of the connectors of its place, the flow into the first one of two in
series, and what is handed to it. It gives the flows out of the others, what is added to the potential and lost of the
flow in series, and what is added to a signal: all zero in the neutral class."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.compose import TRUE_SUFFIX, add_input, add_output, attribute_value, equate
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, map_names
from aero_bayes.simulation.model import Model
from aero_bayes.structure.aliases import AliasStructure, alias_structure
from aero_bayes.structure.balance import CombinationRule, ReplaceableModel, signal_expression, signal_parts
from aero_bayes.structure.candidates import PlacedLaw, identifier, in_sentence
from aero_bayes.structure.compose import LawModels, with_probe
from aero_bayes.structure.coupled_fmu import BASE, INPUT, STATE, UNREAD_SUFFIX, Source, Terms
from aero_bayes.structure.nominal_values import NEGLIGIBLE_TERM
from aero_bayes.structure.redeclare import component_path

ACROSS, LOST, THROUGH = "across", "lost", "through"


@dataclass(frozen=True)
class Terminals:
    """What a law of a replaceable model reads and gives, by the names that it has in the law's FMU."""

    reads: Mapping[str, str]
    passed: Mapping[str, tuple[str, float]]
    definitions: Mapping[str, Expression]

    def reads_in(self, component: str) -> dict[str, str]:
        """Return what a law reads, by the names in the whole model."""
        return {name: f"{component}.{member}" for name, member in self.reads.items()}


def terminals(join: CombinationRule, members: Sequence[FlatVariable]) -> Terminals:
    """Return the terminals of a place from its variables, named from within."""
    reads: dict[str, str] = {}
    passed: dict[str, tuple[str, float]] = {}
    definitions: dict[str, Expression] = {}

    def ends(connector: str) -> tuple[str, str]:
        own = [v for v in members if v.name.rpartition(".")[0] == connector]
        return next(v.name for v in own if not v.flow), next(v.name for v in own if v.flow)

    for connector in join.shared:
        potential, flow = ends(connector)
        reads[identifier(potential)] = potential
        definitions[identifier(flow)] = Name(flow)
    if join.series:
        (potential, flow), (end, out) = map(ends, join.series)
        reads |= {identifier(potential): potential, identifier(flow): flow}
        definitions[ACROSS] = Call("-", (Name(end), Name(potential)))
        definitions[LOST] = Call("+", (Name(flow), Name(out)))
        passed |= {potential: (ACROSS, 1.0), flow: (LOST, -1.0)}
    if join.signal:
        signal, out = join.signal
        reads[signal] = signal
        definitions[THROUGH] = Call("-", (Name(out), Name(signal)))
        passed[signal] = (THROUGH, 1.0)
    constant = {v.name for v in members if v.constant}
    reads |= {name: name for name in join.handed if name not in constant}
    return Terminals(reads, passed, definitions)


def open_replaceables(
    flat: FlatModel, places: Sequence[ReplaceableModel]
) -> tuple[FlatModel, dict[str, str], dict[str, Terminals]]:
    """Return a model with probe inputs in place of what its neutral classes state, their names by
    ``component.terminal``, and the terminals of each component.

    A replaceable model whose neutral class states something else stays as it is."""
    names: dict[str, str] = {}
    opened: dict[str, Terminals] = {}
    for join, components in ((place.combination, place.components) for place in places):
        for component in components if join is not None else ():
            assert join is not None
            found = terminals(join, members(flat, component))
            neutral = [i for i, e in enumerate(flat.equations) if e.component == component and e.origin == "component"]
            if len(neutral) != len(found.definitions):
                continue
            opened[component] = found
            equations = list(flat.equations)
            for i, (terminal, tree) in zip(neutral, found.definitions.items(), strict=True):
                names[f"{component}.{terminal}"] = probe = f"probe_{identifier(component)}_{terminal}"
                whole = map_names(tree, lambda n, at=component: Name(f"{at}.{n.name}", n.subscripts))  # type: ignore[misc]
                equations[i] = FlatEquation(whole, Name(probe), "added", place=equations[i].place)
                flat = add_input(flat, probe)
            flat = replace(flat, equations=tuple(equations))
    return flat, names, opened


def members(flat: FlatModel, component: str) -> list[FlatVariable]:
    """Return the variables of a component, named from within."""
    prefix = f"{component}."
    return [replace(v, name=v.name.removeprefix(prefix)) for v in flat.variables if v.name.startswith(prefix)]


def effect_block(flat: FlatModel, join: CombinationRule) -> FlatModel:
    """Return a law of a replaceable model with its terminals as inputs and outputs."""
    found = terminals(join, flat.variables)
    shown = [v.name for v in flat.variables if v.causality == "output"]
    flat = replace(
        flat, variables=tuple(replace(v, causality="local") if v.name in shown else v for v in flat.variables)
    )
    for name, member in found.reads.items():
        if name != member:
            flat = equate(add_input(flat, name), member, Name(name))
    for name, tree in found.definitions.items():
        flat = add_output(flat, name, tree)
    return flat


@dataclass(frozen=True, eq=False)
class OpenModel:
    """A model with open ports.

    ``inputs`` are its own, ``probes`` the inputs that stand for a law's output by the id of the port, which count
    ``gain`` times. ``signals`` and ``rates`` say where a signal and its derivative are found. ``needs`` has the inputs
    on which outputs depend at once, ``copies`` the states that outputs are as long as no probe acts on them.
    By components of replaceable models, ``terminals`` has what a law reads and gives, ``constants`` parameters."""

    model: Model
    inputs: tuple[str, ...]
    probes: Mapping[str, str]
    signals: Mapping[str, Terms]
    rates: Mapping[str, Terms] = field(default_factory=dict)
    needs: Mapping[Source, frozenset[str]] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    gain: float = 1.0
    copies: Mapping[str, int] = field(default_factory=dict)
    state_names: Sequence[str] = ()
    terminals: Mapping[str, Terminals] = field(default_factory=dict)
    constants: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def output_needs(self, name: str) -> frozenset[str]:
        """Return the inputs on which an output depends at once."""
        return self.needs.get(Source(BASE, self.model.output(name).value_reference), frozenset())


#: Points at which a curve is evaluated.
CURVE_POINTS = 61


@dataclass(frozen=True, eq=False)
class LearnedCurve:
    """What a port gives over a signal: ``x``, ``value`` and its standard deviation ``sd``, shape (n,) each."""

    x: FloatArray
    value: FloatArray
    sd: FloatArray
    x_unit: str
    unit: str


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


def curve_variable(placed: PlacedLaw) -> str:
    """Return the variable over which a curve is learned, for a reader."""
    if placed.port.replaceable is None:
        return placed.port.signals.get(placed.law.curve_input, placed.port.id)
    about = next((c.description for c in placed.law.cls.components() if c.name == placed.law.curve_input), "")
    return in_sentence(about) or placed.port.id


def isolated_curve(placed: PlacedLaw, models: LawModels) -> tuple[PlacedLaw, LawModels]:
    """Take a curve of a replaceable model out of what else its class states; any other is alone already."""
    key = placed.law.kind, placed.law.id
    if placed.port.replaceable is None:
        return placed, models
    x, y, part = placed.law.curve_input, placed.law.interface.output, models[key]
    kept = {x, y, *placed.all_nominals, *(p.name for p in placed.law.parameters)}
    variables = tuple(
        replace(v, causality="input" if v.name == x else "local", binding=Number(0.0) if v.constant else None)
        for v in part.variables
        if v.name in kept
    )
    equations = tuple(e for e in part.equations if isinstance(e.left, Name) and e.left.name == y)
    units = {v.name: v.unit for v in variables}
    port = replace(placed.port, unit=units[y], units={x: units[x]})
    alone = FlatModel(placed.law.id, variables, equations, functions=part.functions)
    return replace(placed, port=port), {key: alone}


def with_curve_inputs(flat: FlatModel, placed_laws: Sequence[PlacedLaw]) -> tuple[FlatModel, dict[str, str]]:
    """Return a model with further outputs, the inputs of curves in its replaceable models, and their names by id."""
    names = {placed.id: f"learned_over_{k}" for k, placed in enumerate(placed_laws)}
    for placed in placed_laws:
        signal = Name(f"{component_path(placed, placed_laws)}.{placed.law.curve_input}")
        flat = add_output(flat, names[placed.id], Call("+", (signal, NEGLIGIBLE_TERM)))
    return flat, names


def state_aliases(model: Model) -> dict[str, str]:
    """Return the state that each variable of an FMU 2.0 is an alias of: both have one value reference."""
    with zipfile.ZipFile(model.path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    states = {str(s.value_reference): s.name for s in model.states}
    variables = [(v.get("name", ""), v.get("valueReference", "")) for v in root.iter("ScalarVariable")]
    return {name: states[reference] for name, reference in variables if reference in states}


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


def open_model(
    base: Model, placed_laws: Iterable[PlacedLaw], flat: FlatModel, export: Callable[[FlatModel], Model]
) -> OpenModel:
    """Return a model with its ports open for some laws. ``base`` is the same model without open ports."""
    every = list(placed_laws)
    ports = {p.id: p for placed in every for p in (placed.port, placed.neighbour) if p is not None}
    inside = [p.replaceable for p in ports.values() if p.replaceable is not None]
    flat, probes, opened = open_replaceables(flat, inside)
    structure = alias_structure(flat)
    for port in ports.values():
        if port.attachment not in ("input", "output", "redeclare"):
            probes[port.id] = f"{PROBE}{identifier(port.id)}"
            flat = with_probe(flat, port, probes[port.id], 1.0)
    read = [given for port in ports.values() for given in port.signals.values()]
    read += [signal for component, found in opened.items() for signal in found.reads_in(component).values()]
    signals = dict.fromkeys(one for given in read for _, one in signal_parts(given))
    rated = dict.fromkeys(p.port.signals["u"] for p in every if p.law.needs_derivative)
    copied = {v.name: k for v in base.outputs if (k := base.copied_state(v.name)) is not None}
    asked = [(SIGNAL, name) for name in signals] + [(RATE, name) for name in rated if name not in copied]
    shown: dict[tuple[str, str], str] = {}
    places, model = _places(base, structure), base
    while missing := [key for key in asked if key not in shown and not _is_known(*key, places, structure)]:
        for kind, name in missing:
            tree, out = signal_expression(name), f"{kind}{identifier(name)}"
            shown[kind, name] = out = f"{out}_{len(shown)}" if out in shown.values() else out
            flat = add_output(flat, out, tree if kind == SIGNAL else Call("der", (tree,)))
        model = export(flat)
        places = _places(model, structure)
    model = export(flat) if model is base else model
    found = _Found(model, _places(model, structure), structure, shown)
    positions = _base_states(base, found.places, structure)
    moving = {name: found.terms(RATE, name) for name in rated if name not in copied}
    moving |= {n: ((Source(BASE, model.derivatives[positions[copied[n]]]), 1.0),) for n in rated if n in copied}
    names = [s.name for s in model.states]
    for k, there in positions.items():
        names[there] = base.states[k].name
    return OpenModel(
        model, tuple(v.name for v in model.inputs if v.name not in probes.values()), probes,
        {name: found.terms(SIGNAL, name) for name in signals}, moving,
        _needs(model), frozenset(shown.values()), copies=_copies(copied, model, positions), state_names=names,
        terminals=opened, constants={component: _constants(flat, component) for component in opened},
    )  # fmt: skip


def _is_known(kind: str, name: str, places: Places, structure: AliasStructure) -> bool:
    """Return whether a signal is a state or an input, and its derivative that of a state."""
    found = places.get(structure.of(name))
    return found is not None and (kind == SIGNAL or found[0].part == STATE)


@dataclass(frozen=True)
class _Found:
    """Where signals and their derivatives are in a model with open ports."""

    model: Model
    places: Places
    structure: AliasStructure
    shown: Mapping[tuple[str, str], str]

    def terms(self, kind: str, name: str) -> Terms:
        if (kind, name) in self.shown:
            reference = self.model.output(self.shown[kind, name]).value_reference
            states = {s.value_reference: k for k, s in enumerate(self.model.states)}
            return ((Source(STATE, states[reference]) if reference in states else Source(BASE, reference), 1.0),)
        source, sign = self.places[self.structure.of(name)]
        gain = float(sign * self.structure.same.get(name, (name, 1))[1])
        return ((Source(BASE, self.model.derivatives[source.reference]) if kind == RATE else source, gain),)


def _base_states(base: Model, there: Places, structure: AliasStructure) -> dict[int, int]:
    """Return the position in a model with open ports of each state of the base."""
    found = {}
    for k, state in enumerate(base.states):
        names = [state.name, *(n for n, s in state_aliases(base).items() if s == state.name)]
        places = [there[structure.of(n)] for n in names if structure.of(n) in there]
        source = next((s for s, sign in places if s.part == STATE and sign > 0), None)
        if source is not None:
            found[k] = source.reference
    return found


def _copies(copied: Mapping[str, int], model: Model, positions: Mapping[int, int]) -> dict[str, int]:
    """Return outputs that are states of the base and are none while a probe acts on them, with the state there."""
    states = {s.value_reference for s in model.states}
    return {n: positions[k] for n, k in copied.items() if model.output(n).value_reference not in states}


def _constants(flat: FlatModel, component: str) -> dict[str, float]:
    """Return values of the parameters of a component, as far as they are numbers."""
    found = {}
    for v in members(flat, component):
        if v.constant and not v.sizes:
            with suppress(InputError):
                found[v.name] = attribute_value(flat, f"{component}.{v.name}", "value")
    return found


def _places(model: Model, structure: AliasStructure) -> Places:
    """Return the classes of equal variables that are a state or an input of a model, and its sign there."""
    index = {s.name: k for k, s in enumerate(model.states)}
    names = [*((s, s) for s in index), *state_aliases(model).items()]
    found = [(name, Source(STATE, index[state])) for name, state in names]
    found += [(v.name, Source(INPUT, k)) for k, v in enumerate(v for v in model.inputs if not v.name.startswith(PROBE))]
    places: dict[str, tuple[Source, int]] = {}
    for name, source in found:
        if name in structure.variables:
            places.setdefault(structure.of(name), (source, structure.same.get(name, (name, 1))[1]))
    return places


def _needs(model: Model) -> Mapping[Source, frozenset[str]]:
    """Return the inputs on which each output depends at once, as the model description says."""
    with zipfile.ZipFile(model.path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    variables = list(root.iterfind("ModelVariables/ScalarVariable"))
    inputs = {str(k): v.get("name", "") for k, v in enumerate(variables, 1) if v.get("causality") == "input"}
    found = {}
    for tag in ("Outputs", "Derivatives"):
        for unknown in root.iterfind(f"ModelStructure/{tag}/Unknown"):
            v = variables[int(unknown.get("index", "1")) - 1]
            given = unknown.get("dependencies")
            on = inputs.values() if given is None else [inputs[k] for k in given.split() if k in inputs]
            found[Source(BASE, int(v.get("valueReference", "0")))] = frozenset(on)
    return found
