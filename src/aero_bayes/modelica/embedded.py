"""The embedded exporter: rumoca flattens, this package solves, a C compiler compiles."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
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
    _structure(root, model, layout, _variables(_Variables(root, _start_values(model, layout)), model, layout))
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
    values |= {b.symbol(v.name): _attribute(v, "start", values, 0.0) for v in layout.inputs}
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
        return _attribute(by_name[path], "start", values, 0.0)


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
class _Indices:
    """Indices of variables in the description, by what they are; ``outputs`` are all that the model shows."""

    inputs: list[int]
    states: list[int]
    calculated: list[int]
    outputs: list[int]
    dependent: list[int]
    rates: list[int]


def _variables(writer: _Variables, model: ExplicitModel, layout: VariableLayout) -> _Indices:
    """Add every variable."""
    values, nx = writer.values, len(layout.states)
    inputs = [
        writer.add(
            v, 2 * nx + i, causality="input", variability="continuous", start=_attribute(v, "start", values, 0.0)
        )
        for i, v in enumerate(layout.inputs)
    ]
    states = [
        writer.add(
            v,
            i,
            causality="output" if v.shown else "local",
            variability="continuous",
            initial="exact" if start.op == "const" else "approx",
            start=_state_start(model, path, start, values),
        )
        for i, (v, path, start) in enumerate(zip(layout.states, layout.state_paths, model.starts, strict=True))
    ]
    calculated = [
        writer.add(
            v,
            layout.first_output + i,
            causality="output",
            variability="continuous" if v.variability == "continuous" else "discrete",
            initial="calculated",
        )
        for i, v in enumerate(layout.outputs)
    ]
    outputs, by_name = list(calculated), {v.name: v for v in model.system.variables}
    for name, vr in layout.aliases.items():
        v = by_name[name]
        causality = "output" if v.shown else "local"
        index = writer.add(v, vr, causality=causality, variability="continuous", initial="calculated")
        if v.shown:
            outputs.append(index)
    for i, v in enumerate(layout.parameters):
        writer.add(
            v, layout.first_parameter + i, causality="parameter", variability="tunable", initial="exact",
            start=values[model.system.builder.symbol(v.name)],
        )  # fmt: skip
    dependent = [
        writer.add(
            v, layout.first_dependent + i, causality="calculatedParameter", variability="tunable", initial="calculated"
        )
        for i, v in enumerate(layout.dependent)
    ]
    rates = [_add_rate(writer, v, nx + i, states[i]) for i, v in enumerate(layout.states)]
    shown = sorted(outputs + [s for s in states if writer.causality(s) == "output"])
    return _Indices(inputs, states, calculated, shown, dependent, rates)


def _structure(root: ET.Element, model: ExplicitModel, layout: VariableLayout, indices: _Indices) -> None:
    """Add outputs, derivatives and initial unknowns, with what they depend on."""
    b, states, outputs, rates = model.system.builder, indices.states, indices.outputs, indices.rates
    structure = ET.SubElement(root, "ModelStructure")
    knowns = {b.symbol(path): index for path, index in zip(model.states, states, strict=True)}
    knowns |= {b.symbol(v.name): index for v, index in zip(layout.inputs, indices.inputs, strict=True)}
    expressions = dict(zip(rates, model.rates, strict=True))
    expressions |= dict(zip(indices.calculated, [model.solved[v.name] for v in layout.outputs], strict=True))
    needs = {index: model.dependencies(e) for index, e in expressions.items()}
    open_states = [s for s, e in zip(states, model.starts, strict=True) if e.op != "const"]
    first = {*(o for o in outputs if o not in states), *rates, *indices.dependent, *open_states}
    for tag, unknowns in (("Outputs", outputs), ("Derivatives", rates), ("InitialUnknowns", sorted(first))):
        if unknowns:
            group = ET.SubElement(structure, tag)
            for index in unknowns:
                unknown = ET.SubElement(group, "Unknown", index=str(index))
                on = needs.get(index)
                if tag != "InitialUnknowns" and on is not None:
                    unknown.set("dependencies", " ".join(map(str, sorted(knowns[s] for s in on if s in knowns))))


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


def _attribute(v: ScalarVariable, key: str, values: Mapping[Node, float], otherwise: float) -> float:
    return _number(v.attributes[key], values) if key in v.attributes else otherwise


class _Variables:
    def __init__(self, root: ET.Element, values: Mapping[Node, float]) -> None:
        self.group = ET.SubElement(root, "ModelVariables")
        self.values = values

    def causality(self, index: int) -> str:
        return self.group[index - 1].get("causality", "local")

    def add(self, v: ScalarVariable, reference: int, *, start: float | None = None, **attributes: str) -> int:
        """Append a variable; its index counts from one."""
        element = ET.SubElement(self.group, "ScalarVariable", name=v.name, valueReference=str(reference))
        if v.description:
            element.set("description", v.description)
        for key, value in attributes.items():
            if key == "initial" and attributes["causality"] == "input":
                continue
            element.set(key, value)
        real = {"unit": v.unit} if v.unit else {}
        for key in ("min", "max", "nominal"):
            if key in v.attributes:
                real[key] = repr(_number(v.attributes[key], self.values))
        if "min" in real and "max" in real and float(real["min"]) > float(real["max"]):
            raise InputError(f"{v.name}: min = {float(real['min']):g} is above max = {float(real['max']):g}")
        if start is not None:
            real["start"] = repr(start)
        ET.SubElement(element, "Real", real)
        return len(self.group)


def _add_rate(writer: _Variables, v: ScalarVariable, reference: int, state: int) -> int:
    rate = ScalarVariable(f"der({v.name})", "Real", "continuous", "local", "", _rate_unit(v.unit), {}, False, None)
    index = writer.add(rate, reference, causality="local", variability="continuous", initial="calculated")
    writer.group[index - 1][0].set("derivative", str(state))
    return index


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
