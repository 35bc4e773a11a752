"""The model description of an FMU, of FMI 2.0 or 3.0, as plain typed values."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from aero_bayes.errors import InputError
from aero_bayes.simulation.model_description import (
    OWN_EXPORTER,
    DescribedOperator,
    DescribedRelay,
    Kind,
    ModelDescription,
    Variable,
    memory_named,
    outputs_named_by_states,
)

#: Where our own FMUs list laws that act on signals of inputs or outputs, one that may be held on a side, and states
#: whose start the model fixes.
_RELAY = "VendorAnnotations/Tool[@name='aero-bayes']/Laws/Relay"
_OPERATORS = "VendorAnnotations/Tool[@name='aero-bayes']/Laws/Operator"
_FIXED_STARTS = "VendorAnnotations/Tool[@name='aero-bayes']/FixedStarts/FixedStart"


class _DoctypeError(Exception):
    """The document declares a document type."""


class _Builder(ElementTree.TreeBuilder):
    """Builds elements and stops at a document type, in whatever encoding it is written."""

    def doctype(self, *_: object) -> None:
        raise _DoctypeError


def parse_description(path: Path, text: bytes) -> Element:
    """Return the root of a model description; InputError for what is no XML or declares entities."""
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(text)
        root: Element = parser.close()
        return root
    except _DoctypeError:
        raise InputError(f"{path}: modelDescription.xml declares a document type, which no FMU needs") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: modelDescription.xml is not valid XML: {error}") from error


def is_true(element: Element, key: str) -> bool:
    """Return a Boolean attribute, false where it is missing."""
    return element.get(key, "false") in ("true", "1")


def step_size(root: Element, interface: Element) -> float | None:
    """Return the communication step in s that an FMU names: its internal one, or that of its default experiment."""
    experiment = root.find("DefaultExperiment")
    named = interface.get("fixedInternalStepSize") or (experiment.get("stepSize") if experiment is not None else None)
    return float(named) if named and float(named) > 0.0 else None


_STATE_SET = re.compile(r"(?:\$|_D_)STATESET")


def check_variables(path: Path, variables: Sequence[Variable]) -> None:
    """Raise InputError for what cannot be true of the variables of one model."""
    names = set[str]()
    for variable in variables:
        if variable.name in names:
            raise InputError(f"{path}: two variables have the name {variable.name!r}")
        names.add(variable.name)
        if not 0 <= variable.value_reference < 1 << 32:
            raise InputError(
                f"{path}: the value reference {variable.value_reference} of {variable.name!r} is not within 0..2^32-1"
            )
        if variable.minimum is not None and variable.maximum is not None and variable.minimum > variable.maximum:
            raise InputError(
                f"{path}: {variable.name!r} has the minimum {variable.minimum:g} above its maximum {variable.maximum:g}"
            )


def jacobian_pattern(
    depends: Sequence[set[int] | None], position: Mapping[int, int]
) -> tuple[tuple[int, ...], ...] | None:
    """Return, for each state the states whose derivative depends on it, from the knowns of each derivative."""
    if not depends or any(d is None for d in depends):
        return None
    rows = [{position[k] for k in d if k in position} for d in depends if d is not None]
    return tuple(tuple(i for i, row in enumerate(rows) if j in row) for j in range(len(rows)))


def candidate_copies(
    outputs: Sequence[tuple[Variable, list[int] | None]], position: Mapping[int, int], states: Sequence[Variable]
) -> tuple[tuple[str, int], ...]:
    """Outputs that depend on one state and nothing else, or after which a state is named."""
    named = outputs_named_by_states(states)
    references = {state.value_reference for state in states}
    found = {}
    for variable, depends in outputs:
        if variable.kind != "real" or variable.value_reference in references:
            continue
        if variable.name in named:
            found[variable.name] = named[variable.name]
        elif depends is not None and len(depends) == 1 and depends[0] in position:
            found[variable.name] = position[depends[0]]
    return tuple(found.items())


def _number(element: Element, key: str) -> float | None:
    text = element.get(key)
    if text is None:
        return None
    if text in ("true", "false"):
        return float(text == "true")
    return float(text)


#: Kinds of variables by their elements; others, and arrays, are left out.
_KINDS: dict[str, Kind] = {
    "Real": "real", "Integer": "integer", "Boolean": "boolean", "Enumeration": "integer", "Float64": "real",
    "Int32": "integer",
}  # fmt: skip
_OTHER_TYPES = frozenset(
    {"Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "String", "Binary", "Clock"}
)


@dataclass(frozen=True)
class _Row:
    """A variable as it is written: what all have, and what its type has; None where its type is left out."""

    scalar: Element
    own: Element | None
    variable: Variable


def _variables(root: Element, three: bool) -> list[_Row]:
    types: dict[str, Element] = {}
    for given in root.iterfind("TypeDefinitions/*"):
        types[given.get("name", "")] = given if three else next(iter(given), given)
    found = []
    for scalar in root.iterfind("ModelVariables/*"):
        if three:
            if scalar.tag not in _OTHER_TYPES and (scalar.tag not in _KINDS or scalar.tag in ("Real", "Integer")):
                raise ValueError(f"{scalar.tag} is no type of a variable")
            known = ("Float64", "Int32", "Boolean", *(["Enumeration"] if scalar.get("causality") == "input" else []))
            plain = scalar.tag in known and scalar.find("Dimension") is None
            own = scalar if plain else None
        else:
            own = next((inner for inner in scalar if inner.tag in _KINDS), None)
        found.append(_Row(scalar, own, _variable(scalar, own, types, three)))
    return found


def _variable(scalar: Element, own: Element | None, types: Mapping[str, Element], three: bool) -> Variable:
    declared = types.get(own.get("declaredType", "")) if own is not None else None
    written = [one for one in (own, declared) if one is not None]

    def value(key: str) -> float | None:
        return next((x for one in written if (x := _number(one, key)) is not None), None)

    kind: Kind = _KINDS[own.tag] if own is not None else "real"
    items: tuple[tuple[str, float], ...] = ()
    if own is not None and own.tag == "Enumeration":
        kind = "enumeration" if three else "integer"
        given = declared.iterfind("Item") if declared is not None else ()
        items = tuple((item.get("name", ""), float(item.get("value", "0"))) for item in given)
    usual = "discrete" if kind != "real" else "continuous"
    initial = scalar.get("initial", "exact" if not three and own is not None and own.get("start") is not None else "")
    return Variable(
        name=scalar.get("name", ""),
        unit=next((unit for one in written if (unit := one.get("unit"))), ""),
        description=scalar.get("description", ""),
        start=value("start"),
        minimum=value("min"),
        maximum=value("max"),
        nominal=value("nominal"),
        value_reference=int(scalar.get("valueReference", "0")),
        kind=kind,
        settable_start=own is not None and initial in ("exact", "approx"),
        discrete=scalar.get("variability", usual) == "discrete" or (kind != "real" and own is not None),
        items=items,
    )


def read_description(path: Path, root: Element) -> ModelDescription:
    """Return the model description of a checked archive, of FMI 2.0 or 3.0, from the root element of its XML.

    Variables that are arrays, or of types other than 64-bit reals, 32-bit integers and Booleans, are left out."""
    three = root.get("fmiVersion", "").startswith("3.")
    exchange = root.find("ModelExchange")
    interface = exchange if exchange is not None else root.find("CoSimulation")
    if interface is None:
        raise InputError(f"{path}: has neither Model Exchange nor Co-Simulation")
    try:
        return _description(path, root, interface, three)
    except (ValueError, IndexError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        version = "3.0" if three else "2.0"
        raise InputError(f"{path}: modelDescription.xml contradicts FMI {version}: {error}") from error


#: A variable, and the places of those that it depends on; None where that is not said.
_Unknown = tuple[_Row, list[int] | None]


class _Structure:
    """The variables of a model, and the places in their list of what its structure names.

    FMI 2.0 names a variable by its number in the list, which counts from 1, FMI 3.0 by its value reference."""

    def __init__(self, root: Element, three: bool) -> None:
        self.root, self.three, self.rows = root, three, _variables(root, three)
        numbers = (row.variable.value_reference if three else k + 1 for k, row in enumerate(self.rows))
        self.places = {number: k for k, number in enumerate(numbers)}

    def place(self, number: str | None, what: str) -> int:
        """Return the place of a variable in the list."""
        if number is None or int(number) not in self.places:
            raise ValueError(f"{what} is said to be variable {number} of {len(self.rows)}")
        return self.places[int(number)]

    def unknowns(self, two: str, three: str) -> list[_Unknown]:
        """Return variables of one part of the structure, and what they depend on, None where that is not said."""
        found = []
        for unknown in self.root.iterfind(f"ModelStructure/{three}" if self.three else f"ModelStructure/{two}/Unknown"):
            known = unknown.get("dependencies")
            depends = None if known is None else [self.places.get(int(i), -1) for i in known.split()]
            number = unknown.get("valueReference" if self.three else "index")
            found.append((self.rows[self.place(number, "an unknown")], depends))
        return found


def _states(
    path: Path, structure: _Structure, rates: Sequence[_Unknown]
) -> tuple[dict[int, Variable], list[int], list[set[int] | None]]:
    """Return states by their places, value references of their derivatives, and what these depend on."""
    states: dict[int, Variable] = {}
    derivatives: list[int] = []
    depends: list[set[int] | None] = []
    for row, known in rates:
        variable = row.variable
        if row.own is None or row.own.get("derivative") is None:
            raise InputError(f"{path}: {variable.name!r} is listed as a derivative but names no state")
        at = structure.place(row.own.get("derivative"), f"the state of {variable.name!r}")
        state = structure.rows[at]
        if state.own is None:
            raise InputError(f"{path}: {state.variable.name!r} is an array or no 64-bit real, which no state may be")
        if state.variable.kind != "real" or state is row or at in states:
            raise InputError(f"{path}: {variable.name!r} cannot be the derivative of {state.variable.name!r}")
        states[at] = state.variable
        derivatives.append(variable.value_reference)
        depends.append(None if known is None else set(known))
    for chosen in states.values():
        if _STATE_SET.match(chosen.name):
            raise InputError(
                f"{path}: {chosen.name!r} is selected while the model runs (dynamic state selection), which is not "
                "supported: choose the states in the source, with stateSelect = StateSelect.always or .prefer"
            )
    return states, derivatives, depends


def _picked(path: Path, structure: _Structure) -> dict[str, tuple[Variable, ...]]:
    """Return parameters, inputs and outputs."""
    pick: dict[str, list[Variable]] = {"parameter": [], "input": [], "output": []}
    for row in structure.rows:
        causality = row.scalar.get("causality", "local")
        if row.scalar.tag == "Clock" and causality == "input":
            raise InputError(f"{path}: {row.variable.name!r} is an input clock, which is not supported")
        varies = row.scalar.get("variability", "fixed" if structure.three else "continuous")
        if row.own is None or causality not in pick or (causality == "parameter" and row.variable.kind != "real"):
            continue
        if causality != "parameter" or varies in ("fixed", "tunable"):
            pick[causality].append(row.variable)
    return {causality: tuple(variables) for causality, variables in pick.items()}


def _description(path: Path, root: Element, interface: Element, three: bool) -> ModelDescription:
    structure, exchange = _Structure(root, three), interface.tag == "ModelExchange"
    variables = [row.variable for row in structure.rows]
    check_variables(path, variables)
    identifier = interface.get("modelIdentifier", "")
    if not identifier or "/" in identifier or "\\" in identifier:
        raise InputError(f"{path}: the model identifier {identifier!r} is not a file name")
    rates = structure.unknowns("Derivatives", "ContinuousStateDerivative") if exchange else []
    states, derivatives, depends = _states(path, structure, rates)
    position, named = {at: k for k, at in enumerate(states)}, {s.value_reference: s.name for s in states.values()}
    pick = _picked(path, structure)
    given = structure.unknowns("Outputs", "Output")
    outputs = [(row.variable, on) for row, on in given if row.own is not None]
    if three:
        indicators = len(structure.unknowns("", "EventIndicator"))
        asks = is_true(interface, "needsCompletedIntegratorStep")
    else:
        indicators = int(root.get("numberOfEventIndicators", "0"))
        asks = not is_true(interface, "completedIntegratorStepNotNeeded")
    return ModelDescription(
        path=path,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        name=root.get("modelName", identifier),
        guid=root.get("instantiationToken" if three else "guid", ""),
        identifier=identifier,
        parameters=pick["parameter"],
        inputs=pick["input"],
        outputs=pick["output"],
        states=tuple(states.values()),
        event_indicators=indicators if exchange else 0,
        has_directional_derivatives=exchange and is_true(interface, f"providesDirectionalDerivative{'s' * three}"),
        needs_instance_per_process=is_true(interface, "canBeInstantiatedOnlyOncePerProcess"),
        derivatives=tuple(derivatives),
        jacobian_pattern=jacobian_pattern(depends, position),
        wants_step_callback=asks and root.get("generationTool") != OWN_EXPORTER,
        candidate_copies=candidate_copies(outputs, position, tuple(states.values())),
        fmi_version=3 if three else 2,
        interface="model exchange" if exchange else "co-simulation",
        takes_any_step=exchange or is_true(interface, "canHandleVariableCommunicationStepSize"),
        interpolates_inputs=not exchange and is_true(interface, "canInterpolateInputs"),
        step_size=step_size(root, interface),
        execution_tool=root.get("generationTool", "its tool") if is_true(interface, "needsExecutionTool") else "",
        operators=tuple(
            DescribedOperator(
                o.get("signal", ""),
                tuple(o.get("parameters", "").split()),
                int(o.get("raw", "")) if "raw" in o.attrib else None,
                memory_named(o.get("memory", "")),
                tuple(map(int, o.get("states", "").split())),
            )
            for o in root.iterfind(_OPERATORS)
        ),
        relay=next(map(_relay, root.iterfind(_RELAY)), None),
        fixed_starts=tuple(o.get("state", "") for o in root.iterfind(_FIXED_STARTS)),
        state_aliases={v.name: named[v.value_reference] for v in variables if v.value_reference in named},
        feedthrough=_feedthrough(structure, [*given, *rates]),
    )


def _feedthrough(structure: _Structure, unknowns: Sequence[_Unknown]) -> dict[int, frozenset[str]]:
    """Return the inputs on which outputs and derivatives depend at once, all where that is not said."""
    inputs = {k: r.variable.name for k, r in enumerate(structure.rows) if r.scalar.get("causality") == "input"}
    return {
        row.variable.value_reference: frozenset(inputs[k] for k in (inputs if on is None else on) if k in inputs)
        for row, on in unknowns
    }


def _relay(e: Element) -> DescribedRelay:
    states, gains = (e.get(key, "").split() for key in ("states", "gains"))
    speed = tuple((int(s), float(gain)) for s, gain in zip(states, gains, strict=True))
    return DescribedRelay(int(e.get("held", "")), int(e.get("direction", "")), speed)


def add_annotations(root: Element, operators: Sequence[DescribedOperator], relay: DescribedRelay | None) -> None:
    """Add operators on signals and a law that may be held to a description, where other tools look past them."""
    if not operators and relay is None:
        return
    tool = SubElement(SubElement(root, "VendorAnnotations"), "Tool", name="aero-bayes")
    laws = SubElement(tool, "Laws")  # a tool may have one element
    for o in operators:
        element = SubElement(laws, "Operator", signal=o.signal, parameters=" ".join(o.parameters))
        if o.raw is not None:
            element.set("raw", str(o.raw))
        if o.memory:
            element.set("memory", o.memory)
            element.set("states", " ".join(map(str, o.states)))
    if relay is not None:
        states, gains = (" ".join(map(str, part)) for part in zip(*relay.speed, strict=True))
        SubElement(laws, "Relay", held=str(relay.held), direction=str(relay.direction), states=states, gains=gains)
