"""The model description of an FMI 3.0 FMU, read by FMPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from aero_bayes.errors import InputError
from aero_bayes.simulation.fmi2_description import (
    candidate_copies,
    check_variables,
    checked_identifier,
    is_true,
    jacobian_pattern,
    refuse_selected_states,
    sha256,
    step_size,
)
from aero_bayes.simulation.model_description import OWN_EXPORTER, Kind, ModelDescription, Variable

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
        return _description(path, root, interface, found, only_steps)
    except InputError:
        raise
    except Exception as error:  # FMPy's own errors have no common class
        why = " ".join(str(error).split())
        raise InputError(f"{path}: modelDescription.xml contradicts FMI 3.0: {why}") from error


def _description(path: Path, root: Element, interface: Element, found: Any, only_steps: bool) -> ModelDescription:
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


def _number(value: Any) -> float | None:
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
        start=_number(variable.start),
        minimum=_number(own_or_declared("min")),
        maximum=_number(own_or_declared("max")),
        nominal=_number(own_or_declared("nominal")),
        value_reference=int(variable.valueReference),
        kind=_KINDS[variable.type],
        settable_start=variable.initial in ("exact", "approx"),
        discrete=variable.variability == "discrete",
    )
