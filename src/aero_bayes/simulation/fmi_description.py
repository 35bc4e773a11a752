"""The model description of an FMU: of FMI 2.0 as it is written, of FMI 3.0 as FMPy reads it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aero_bayes.errors import InputError
from aero_bayes.simulation.model_description import (
    OWN_EXPORTER,
    Kind,
    ModelDescription,
    Variable,
    outputs_named_by_states,
)


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


def checked_identifier(path: Path, interface: Element) -> str:
    """Return the name of the binary."""
    identifier = interface.get("modelIdentifier", "")
    if not identifier or "/" in identifier or "\\" in identifier:
        raise InputError(f"{path}: the model identifier {identifier!r} is not a file name")
    return identifier


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


def refuse_selected_states(path: Path, states: Sequence[Variable]) -> None:
    """InputError where a state belongs to a set that the model selects while it runs."""
    for state in states:
        if _STATE_SET.match(state.name):
            raise InputError(
                f"{path}: {state.name!r} is selected while the model runs (dynamic state selection), which is not "
                "supported: choose the states in the source, with stateSelect = StateSelect.always or .prefer"
            )


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


def sha256(path: Path) -> str:
    """Checksum of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _number(element: Element, key: str) -> float | None:
    text = element.get(key)
    if text is None:
        return None
    if text in ("true", "false"):
        return float(text == "true")
    return float(text)


def _variables(root: Element) -> list[tuple[Element, Element | None, Variable]]:
    types: dict[str, Element] = {}
    for simple in root.iterfind("TypeDefinitions/SimpleType"):
        for inner in simple:
            types[simple.get("name", "")] = inner
    found = []
    for scalar in root.iterfind("ModelVariables/ScalarVariable"):
        own: Element | None = None
        kind: Kind = "real"
        for tag, name in (("Real", "real"), ("Integer", "integer"), ("Boolean", "boolean"), ("Enumeration", "integer")):
            own = scalar.find(tag)
            if own is not None:
                kind = name  # type: ignore[assignment]
                break
        declared = types.get(own.get("declaredType", "")) if own is not None else None

        def value(key: str, own: Element | None = own, declared: Element | None = declared) -> float | None:
            here = _number(own, key) if own is not None else None
            return here if here is not None or declared is None else _number(declared, key)

        unit = (own.get("unit") if own is not None else None) or (declared.get("unit") if declared is not None else "")
        found.append(
            (
                scalar,
                own,
                Variable(
                    name=scalar.get("name", ""),
                    unit=unit or "",
                    description=scalar.get("description", ""),
                    start=value("start"),
                    minimum=value("min"),
                    maximum=value("max"),
                    nominal=value("nominal"),
                    value_reference=int(scalar.get("valueReference", "0")),
                    kind=kind,
                    settable_start=_settable(scalar, own),
                    discrete=scalar.get("variability") == "discrete",
                ),
            )
        )
    return found


def _settable(scalar: Element, own: Element | None) -> bool:
    if own is None:
        return False
    initial = scalar.get("initial")
    if initial is None:
        return own.get("start") is not None
    return initial in ("exact", "approx")


def read_fmi2_description(path: Path, root: Element) -> ModelDescription:
    """Return the model description of a checked archive, from the root element of its XML."""
    exchange = root.find("ModelExchange")
    if exchange is None and root.find("CoSimulation") is None:
        raise InputError(f"{path}: has neither Model Exchange nor Co-Simulation")
    try:
        return _description(path, root, exchange)
    except (ValueError, IndexError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: modelDescription.xml contradicts FMI 2.0: {error}") from error


def _description(path: Path, root: Element, exchange: Element | None) -> ModelDescription:
    variables = _variables(root)
    check_variables(path, [variable for _, _, variable in variables])
    interface = exchange if exchange is not None else root.find("CoSimulation")
    assert interface is not None
    identifier = checked_identifier(path, interface)
    states: list[Variable] = []
    derivatives: list[int] = []
    position: dict[int, int] = {}
    depends: list[set[int] | None] = []
    for unknown in root.iterfind("ModelStructure/Derivatives/Unknown") if exchange is not None else ():
        _, own, variable = variables[_position(unknown.get("index"), variables, "a derivative")]
        if own is None or own.get("derivative") is None:
            raise InputError(f"{path}: {variable.name!r} is listed as a derivative but names no state")
        at = _position(own.get("derivative"), variables, f"the state of {variable.name!r}")
        state = variables[at][2]
        if state.kind != "real" or state is variable or at in position:
            raise InputError(f"{path}: {variable.name!r} cannot be the derivative of {state.name!r}")
        position[at] = len(states)
        states.append(state)
        derivatives.append(variable.value_reference)
        known = unknown.get("dependencies")
        depends.append(None if known is None else {int(i) - 1 for i in known.split()})
    refuse_selected_states(path, states)
    pick = {"parameter": [], "input": [], "output": []}  # type: dict[str, list[Variable]]
    for scalar, own, variable in variables:
        causality = scalar.get("causality", "local")
        if own is None or causality not in pick:
            continue
        if causality != "output" and variable.kind != "real":
            continue
        if causality == "parameter" and scalar.get("variability", "continuous") not in ("fixed", "tunable"):
            continue
        pick[causality].append(variable)
    return ModelDescription(
        path=path,
        sha256=sha256(path),
        name=root.get("modelName", identifier),
        guid=root.get("guid", ""),
        identifier=identifier,
        parameters=tuple(pick["parameter"]),
        inputs=tuple(pick["input"]),
        outputs=tuple(pick["output"]),
        states=tuple(states),
        event_indicators=int(root.get("numberOfEventIndicators", "0")) if exchange is not None else 0,
        has_directional_derivatives=exchange is not None and is_true(exchange, "providesDirectionalDerivative"),
        needs_instance_per_process=is_true(interface, "canBeInstantiatedOnlyOncePerProcess"),
        derivatives=tuple(derivatives),
        jacobian_pattern=jacobian_pattern(depends, position),
        wants_step_callback=not is_true(interface, "completedIntegratorStepNotNeeded")
        and root.get("generationTool") != OWN_EXPORTER,
        candidate_copies=candidate_copies(_outputs(root, variables), position, states),
        interface="co-simulation" if exchange is None else "model exchange",
        takes_any_step=exchange is not None or is_true(interface, "canHandleVariableCommunicationStepSize"),
        interpolates_inputs=exchange is None and is_true(interface, "canInterpolateInputs"),
        step_size=step_size(root, interface),
    )


def _position(number: str | None, variables: Sequence[object], what: str) -> int:
    """Index of a variable in the list, by its number in the description, which counts from 1."""
    if number is None or not 1 <= int(number) <= len(variables):
        raise ValueError(f"{what} is said to be variable {number} of {len(variables)}")
    return int(number) - 1


def _outputs(
    root: Element, variables: Sequence[tuple[Element, Element | None, Variable]]
) -> list[tuple[Variable, list[int] | None]]:
    """Outputs with the positions of what they depend on, None where that is not said."""
    found = []
    for unknown in root.iterfind("ModelStructure/Outputs/Unknown"):
        known = unknown.get("dependencies")
        depends = None if known is None else [int(i) - 1 for i in known.split()]
        found.append((variables[_position(unknown.get("index"), variables, "an output")][2], depends))
    return found


_KINDS: dict[str, Kind] = {"Float64": "real", "Int32": "integer", "Boolean": "boolean"}


def read_fmi3_description(path: Path, root: Element) -> ModelDescription:
    """Return the model description of a checked archive, from the root element of its XML.

    Variables that are arrays, or of types other than 64-bit reals, 32-bit integers and Booleans, are left out."""
    from fmpy import read_model_description

    interface = root.find("ModelExchange")
    only_steps = interface is None
    if interface is None:
        interface = root.find("CoSimulation")
    if interface is None:
        raise InputError(f"{path}: has neither Model Exchange nor Co-Simulation")
    try:
        found = read_model_description(str(path), validate=False)
        return _fmi3_description(path, root, interface, found, only_steps)
    except InputError:
        raise
    except Exception as error:  # FMPy's own errors have no common class
        why = " ".join(str(error).split())
        raise InputError(f"{path}: modelDescription.xml contradicts FMI 3.0: {why}") from error


def _fmi3_description(path: Path, root: Element, interface: Element, found: Any, only_steps: bool) -> ModelDescription:
    check_variables(path, [_variable(v) for v in found.modelVariables if v.type in _KINDS and not v.dimensions])
    pick: dict[str, list[Variable]] = {"parameter": [], "input": [], "output": []}
    for variable in found.modelVariables:
        if variable.type == "Clock" and variable.causality == "input":
            raise InputError(f"{path}: {variable.name!r} is an input clock, which is not supported")
        if variable.type not in _KINDS or variable.dimensions or variable.causality not in pick:
            continue
        if variable.causality != "output" and variable.type != "Float64":
            continue
        if variable.causality == "parameter" and variable.variability not in ("fixed", "tunable"):
            continue
        pick[variable.causality].append(_variable(variable))
    unknowns = [] if only_steps else found.derivatives
    states = [unknown.variable.derivative for unknown in unknowns]
    for state in states:
        if state is None or state.type != "Float64" or state.dimensions:
            name = "a derivative" if state is None else repr(state.name)
            raise InputError(f"{path}: {name} is an array or no 64-bit real state, which is not supported")
    for k, (unknown, state) in enumerate(zip(unknowns, states, strict=True)):
        if state is unknown.variable or state in states[:k]:
            raise InputError(f"{path}: {unknown.variable.name!r} cannot be the derivative of {state.name!r}")
    variables = [_variable(state) for state in states]
    refuse_selected_states(path, variables)
    position = {state.valueReference: i for i, state in enumerate(states)}
    depends = [None if u.dependencies is None else {v.valueReference for v in u.dependencies} for u in unknowns]
    outputs = [
        (_variable(u.variable), None if u.dependencies is None else [v.valueReference for v in u.dependencies])
        for u in ([] if only_steps else found.outputs)
        if u.variable.type == "Float64" and not u.variable.dimensions
    ]
    return ModelDescription(
        path=path,
        sha256=sha256(path),
        name=root.get("modelName", ""),
        guid=root.get("instantiationToken", ""),
        identifier=checked_identifier(path, interface),
        parameters=tuple(pick["parameter"]),
        inputs=tuple(pick["input"]),
        outputs=tuple(pick["output"]),
        states=tuple(variables),
        event_indicators=0 if only_steps else int(found.numberOfEventIndicators),
        has_directional_derivatives=not only_steps and is_true(interface, "providesDirectionalDerivatives"),
        needs_instance_per_process=is_true(interface, "canBeInstantiatedOnlyOncePerProcess"),
        derivatives=tuple(unknown.variable.valueReference for unknown in unknowns),
        jacobian_pattern=jacobian_pattern(depends, position),
        wants_step_callback=is_true(interface, "needsCompletedIntegratorStep") and found.generationTool != OWN_EXPORTER,
        candidate_copies=candidate_copies(outputs, position, variables),
        fmi_version=3,
        interface="co-simulation" if only_steps else "model exchange",
        takes_any_step=not only_steps or is_true(interface, "canHandleVariableCommunicationStepSize"),
        step_size=step_size(root, interface),
    )


def _fmi3_number(value: Any) -> float | None:
    if value is None:
        return None
    if value in ("true", "false", True, False):
        return float(value in ("true", True))
    return float(value)


def _variable(variable: Any) -> Variable:
    declared = variable.declaredType

    def own_or_declared(key: str) -> Any:
        own = getattr(variable, key)
        return own if own is not None or declared is None else getattr(declared, key, None)

    return Variable(
        name=variable.name,
        unit=own_or_declared("unit") or "",
        description=variable.description or "",
        start=_fmi3_number(variable.start),
        minimum=_fmi3_number(own_or_declared("min")),
        maximum=_fmi3_number(own_or_declared("max")),
        nominal=_fmi3_number(own_or_declared("nominal")),
        value_reference=int(variable.valueReference),
        kind=_KINDS[variable.type],
        settable_start=variable.initial in ("exact", "approx"),
        discrete=variable.variability == "discrete",
    )
