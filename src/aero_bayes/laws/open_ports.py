"""A Modelica model with open ports, exported once."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from xml.etree import ElementTree

from aero_bayes.errors import InputError
from aero_bayes.export.compose import add_input, add_output, attribute_value, replace_uses
from aero_bayes.export.flat import FlatModel
from aero_bayes.language.syntax import Call, Name, parse_reference
from aero_bayes.laws.attach import OpenModel
from aero_bayes.laws.compose import add_to_balance
from aero_bayes.laws.coupled_fmu import BASE, INPUT, STATE, Source, Terms
from aero_bayes.laws.open_replaceables import members, open_replaceables
from aero_bayes.laws.placed_law import PlacedLaw, identifier
from aero_bayes.laws.state_names import state_aliases
from aero_bayes.ports import AliasStructure, Port, alias_structure, defining_equations
from aero_bayes.ports.port import DIFFERENCE
from aero_bayes.simulation import Model

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
            flat = _with_probe(flat, port, probes[port.id])
    read = [given for port in ports.values() for given in port.signals.values()]
    read += [signal for component, found in opened.items() for signal in found.reads_in(component).values()]
    signals = dict.fromkeys(one for given in read for one in given.split(DIFFERENCE))
    rated = dict.fromkeys(p.port.signals["u"] for p in every if p.law.needs_derivative)
    copied = {v.name: k for v in base.outputs if (k := base.copied_state(v.name)) is not None}
    asked = [(SIGNAL, name) for name in signals] + [(RATE, name) for name in rated if name not in copied]
    shown: dict[tuple[str, str], str] = {}
    places, model = _places(base, structure), base
    while missing := [key for key in asked if key not in shown and not _is_known(*key, places, structure)]:
        for kind, name in missing:
            tree = parse_reference(name)
            shown[kind, name] = out = f"{kind}{identifier(name)}"
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


def _with_probe(flat: FlatModel, port: Port, name: str) -> FlatModel:
    """Add an input that is added to a balance, or to a signal wherever it is used."""
    flat = add_input(flat, name, port.unit, f"What laws give at {port.id}")
    if port.defining_equation is None:
        return add_to_balance(flat, port, Name(name), 1.0)
    signal = port.signals["u"]
    changed = Call("+", (parse_reference(signal), Name(name)))
    return replace_uses(flat, signal, changed, defining_equations(flat, port))


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
