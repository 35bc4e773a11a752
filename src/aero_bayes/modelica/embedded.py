"""The embedded exporter: rumoca flattens, this package solves, a C compiler compiles."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from aero_bayes.errors import InputError
from aero_bayes.modelica.build import Platform, compile_binaries, source_files, this_machine, write_archive
from aero_bayes.modelica.causalisation import ExplicitModel, causalise
from aero_bayes.modelica.codegen import generate
from aero_bayes.modelica.equation_system import ScalarVariable, translate
from aero_bayes.modelica.expression import Node, evaluate_nodes
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.library import declared_members, identifier
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.switching_surfaces import VariableLayout, find_surfaces, lay_out
from aero_bayes.modelica.units import base_units

#: End of the default experiment in s where nothing else is known.
DEFAULT_STOP = 40.0


def write_fmi2_description(
    model: ExplicitModel,
    layout: VariableLayout,
    *,
    model_name: str,
    identifier: str,
    guid: str,
    stop: float | None = None,
) -> bytes:
    """Write the description, the same for the same model."""
    root = ET.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=model_name, guid=guid, generationTool="aero-bayes",
        variableNamingConvention="structured", numberOfEventIndicators=str(model.indicators),
    )  # fmt: skip
    _interfaces(root, identifier, asks_for_events=bool(layout.inputs))
    _units(root, layout)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Calls that failed")
    ET.SubElement(categories, "Category", name="logStatusWarning", description="Calls to look at")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime=f"{stop or DEFAULT_STOP:.12g}", tolerance="1e-6")
    if fixed := [v.name for v in layout.states if v.fixed]:  # FMI says as much of a start that is a guess
        tool = ET.SubElement(ET.SubElement(root, "VendorAnnotations"), "Tool", name="aero-bayes")
        group = ET.SubElement(tool, "FixedStarts")  # the schema has one element in a tool
        for name in fixed:
            ET.SubElement(group, "FixedStart", state=name)
    add_variables(root, list(_variables(model, layout)))
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _start_values(model: ExplicitModel, layout: VariableLayout) -> dict[Node, float]:
    """Return values of parameters, inputs and states at the start, where nothing has been set yet."""
    b = model.system.builder
    values = {b.symbol(p.name): _number(p.binding, {}) for p in layout.parameters if p.binding is not None}
    for p in model.system.parameters:
        if p.binding is not None and p.binding.op == "const":
            values.setdefault(b.symbol(p.name), p.binding.value)
    values |= {b.symbol(v.name): v.attribute("start", values, 0.0) for v in layout.inputs}
    values[model.system.time] = 0.0
    for later in (False, True):
        for path, start in zip(layout.state_paths, model.starts, strict=True):
            if (b.symbols(start) <= values.keys()) is not later and b.symbol(path) not in values:
                values[b.symbol(path)] = _state_start(model, path, start, values)
    return values


def _state_start(model: ExplicitModel, path: str, start: Node, values: Mapping[Node, float]) -> float:
    """Return a state's start where nothing has been set yet; what events or inputs decide is left to the FMU itself."""
    try:
        return _number(start, values)
    except (KeyError, ArithmeticError, ValueError):
        by_name = {v.name: v for v in model.system.variables}
        return by_name[path].attribute("start", values, 0.0)


def _interfaces(root: ET.Element, identifier: str, *, asks_for_events: bool) -> None:
    """Add model exchange and co-simulation; a model with inputs asks for an event where one jumps without any."""
    common = {"modelIdentifier": identifier, "canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
    interfaces = [
        ET.SubElement(
            root,
            "ModelExchange",
            common,
            completedIntegratorStepNotNeeded="false" if asks_for_events else "true",
            providesDirectionalDerivative="true",
        ),
        ET.SubElement(
            root,
            "CoSimulation",
            common,
            canHandleVariableCommunicationStepSize="true",
            providesDirectionalDerivative="true",
        ),
    ]
    for interface in interfaces:
        files = ET.SubElement(interface, "SourceFiles")
        for file in (f"{identifier}.c", "fmi2.c"):
            ET.SubElement(files, "File", name=file)


@dataclass(frozen=True)
class DescribedVariable:
    """A variable of a model description.

    ``depends`` names what an output or a derivative depends on, None for: all. One that is not ``listed`` stands not
    among the initial unknowns, though it is calculated."""

    name: str
    reference: int
    causality: str
    variability: str = "continuous"
    initial: str = ""
    description: str = ""
    unit: str = ""
    limits: Mapping[str, float] = field(default_factory=dict)
    start: float | None = None
    derivative_of: str = ""
    depends: Collection[str] | None = None
    listed: bool = True
    tag: str = "Real"


def add_variables(root: ET.Element, variables: Sequence[DescribedVariable]) -> None:
    """Add variables, and the structure: outputs, derivatives and initial unknowns, with what they depend on."""
    index = {v.name: k for k, v in enumerate(variables, 1)}
    group = ET.SubElement(root, "ModelVariables")
    for v in variables:
        element = ET.SubElement(group, "ScalarVariable", name=v.name, valueReference=str(v.reference))
        for key in ("description", "causality", "variability", "initial"):
            if getattr(v, key):
                element.set(key, getattr(v, key))
        own = {"unit": v.unit} if v.unit else {}
        own |= {key: repr(value) for key, value in v.limits.items()}
        own |= {"start": repr(v.start)} if v.start is not None else {}
        own |= {"derivative": str(index[v.derivative_of])} if v.derivative_of else {}
        ET.SubElement(element, v.tag, own)
    structure = ET.SubElement(root, "ModelStructure")
    for tag, unknowns in (
        ("Outputs", [v for v in variables if v.causality == "output"]),
        ("Derivatives", [v for v in variables if v.derivative_of]),
        ("InitialUnknowns", [v for v in variables if v.listed and v.initial in ("calculated", "approx")]),
    ):
        group = ET.SubElement(structure, tag) if unknowns else structure
        for v in unknowns:
            unknown = ET.SubElement(group, "Unknown", index=str(index[v.name]))
            if tag != "InitialUnknowns" and v.depends is not None:
                unknown.set("dependencies", " ".join(map(str, sorted(index[name] for name in v.depends))))


def _variables(model: ExplicitModel, layout: VariableLayout) -> Iterator[DescribedVariable]:
    """Yield every variable of a model."""
    b, values, nx = model.system.builder, _start_values(model, layout), len(layout.states)
    by_name = {v.name: v for v in model.system.variables}
    known = {b.symbol(path): v.name for path, v in zip(model.states, layout.states, strict=True)}
    known |= {b.symbol(v.name): v.name for v in layout.inputs}

    def needed(expression: Node) -> list[str] | None:
        found = model.dependencies(expression)
        return None if found is None else [known[s] for s in found if s in known]

    def described(v: ScalarVariable, reference: int, causality: str, **others: Any) -> DescribedVariable:
        limits = {k: _number(v.attributes[k], values) for k in ("min", "max", "nominal") if k in v.attributes}
        if "min" in limits and "max" in limits and limits["min"] > limits["max"]:
            raise InputError(f"{v.name}: min = {limits['min']:g} is above max = {limits['max']:g}")
        about: dict[str, Any] = {"description": v.description, "unit": v.unit, "limits": limits}
        return DescribedVariable(v.name, reference, causality, **about, **others)

    for i, v in enumerate(layout.inputs):
        yield described(v, 2 * nx + i, "input", start=v.attribute("start", values, 0.0))
    for i, (v, path, start) in enumerate(zip(layout.states, layout.state_paths, model.starts, strict=True)):
        initial, at = "exact" if start.op == "const" else "approx", _state_start(model, path, start, values)
        yield described(v, i, "output" if v.shown else "local", initial=initial, start=at)
    for i, v in enumerate(layout.outputs):
        kind, on = "continuous" if v.variability == "continuous" else "discrete", needed(model.solved[v.name])
        yield described(v, layout.first_output + i, "output", variability=kind, initial="calculated", depends=on)
    for v, reference in ((by_name[name], reference) for name, reference in layout.aliases.items()):
        causality = "output" if v.shown else "local"
        yield described(v, reference, causality, initial="calculated", listed=v.shown)
    for i, v in enumerate(layout.parameters):
        at = values[b.symbol(v.name)]
        yield described(v, layout.first_parameter + i, "parameter", variability="tunable", initial="exact", start=at)
    for i, v in enumerate(layout.dependent):
        reference, causality = layout.first_dependent + i, "calculatedParameter"
        yield described(v, reference, causality, variability="tunable", initial="calculated")
    for i, (v, rate) in enumerate(zip(layout.states, model.rates, strict=True)):
        yield DescribedVariable(
            f"der({v.name})", nx + i, "local", initial="calculated", unit=_rate_unit(v.unit), derivative_of=v.name,
            depends=needed(rate),
        )  # fmt: skip


def _units(root: ET.Element, layout: VariableLayout) -> None:
    names = {
        v.unit
        for group in (layout.states, layout.inputs, layout.parameters, layout.dependent, layout.outputs)
        for v in group
    }
    names |= {_rate_unit(v.unit) for v in layout.states}
    names.discard("")
    if not names:
        return
    group = ET.SubElement(root, "UnitDefinitions")
    for name in sorted(names):
        unit = ET.SubElement(group, "Unit", name=name)
        known = base_units(name)
        if known is not None:
            exponents = {k: str(v) for k, v in known[1].items()}
            if known[0] != 1.0:
                exponents["factor"] = repr(known[0])
            ET.SubElement(unit, "BaseUnit", exponents)


def _rate_unit(unit: str) -> str:
    if not unit:
        return ""
    above, _, below = unit.partition("/")
    parts = below.removeprefix("(").removesuffix(")").split(".") if below else []
    seconds = [p for p in parts if p == "s" or (p.startswith("s") and p[1:].isdigit())]
    if seconds:
        parts[parts.index(seconds[0])] = f"s{int(seconds[0][1:] or 1) + 1}"
    else:
        parts.append("s")
    return f"{above}/{parts[0]}" if len(parts) == 1 else f"{above}/({'.'.join(parts)})"


def _number(node: Node | None, values: Mapping[Node, float]) -> float:
    return 0.0 if node is None else evaluate_nodes([node], values)[0]


_PLACED = re.compile(r"[^ :]+\.mo:\d+: ")
_NO_GUID = "{00000000-0000-0000-0000-000000000000}"


def explicit_model(model: str, sources: Sequence[Path] = (), libraries: Sequence[Path] = ()) -> ExplicitModel:
    """Flatten and solve a Modelica model. Raises InputError for what cannot be translated."""
    flat = load_flat(model, sources, libraries)
    with _placed(flat):
        return causalise(translate(flat))


@contextmanager
def _placed(flat: FlatModel) -> Iterator[None]:
    """Errors as one line that begins with file and line: of the variable that they name, or of the first one."""
    try:
        yield
    except (ArithmeticError, ValueError) as error:
        text = (
            str(error) if isinstance(error, InputError) else f"model {flat.name}: {error} with the values of constants"
        )
        words = set(re.findall(r"[\w.]+(?:\[[\d,]+\])?", text))
        places = [v.place for v in sorted(flat.variables, key=lambda v: v.name not in words) if v.place is not None]
        raise InputError(text if _PLACED.match(text) or not places else f"{places[0]}: {text}") from None


def export_embedded(
    model: str,
    out: Path,
    sources: Sequence[Path] = (),
    libraries: Sequence[Path] = (),
    *,
    platforms: Sequence[Platform] = (),
    stop: float | None = None,
) -> Path:
    """Write the FMU of ``model`` to ``out``; see :func:`aero_bayes.modelica.export_fmu` and :func:`export_flat`."""
    flat, members = load_flat(model, sources, libraries), declared_members(model, sources)
    return export_flat(flat, out, members=members, platforms=platforms, stop=stop)


def export_flat(
    flat: FlatModel,
    out: Path | str,
    *,
    members: Mapping[str, bytes] | None = None,
    platforms: Sequence[Platform] = (),
    stop: float | None = None,
) -> Path:
    """Write the FMU of a flat model to ``out``."""
    out, name = Path(out), identifier(flat.name)
    source, description = _with_guid(*_source_and_description(flat, stop=stop))
    write_archive(
        out,
        {
            "modelDescription.xml": description,
            **compile_binaries(source, name, platforms or (this_machine(),)),
            **{f"sources/{file}": text for file, text in source_files(source, name).items()},
            **(members or {}),
        },
    )
    return out


def _source_and_description(flat: FlatModel, *, stop: float | None) -> tuple[str, bytes]:
    """Write the C source and the model description, with no identifier yet."""
    with _placed(flat):
        switching = find_surfaces(causalise(translate(flat)))
        solved = switching.model
        layout = lay_out(solved)
        if not layout.states and not layout.outputs:
            raise InputError(f"{flat.name}: the model has neither states nor outputs")
        source = generate(switching, layout, _NO_GUID)
        description = write_fmi2_description(
            solved, layout, model_name=flat.name, identifier=identifier(flat.name), guid=_NO_GUID, stop=stop,
        )  # fmt: skip
    return source, description


def _with_guid(source: str, description: bytes) -> tuple[str, bytes]:
    """Give source and description the identifier that follows from both."""
    digest = hashlib.sha256(source.encode() + description).hexdigest()
    guid = "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"
    return source.replace(_NO_GUID, guid), description.replace(_NO_GUID.encode(), guid.encode())
