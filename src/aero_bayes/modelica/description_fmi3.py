"""modelDescription.xml of FMI 3.0 from that of FMI 2.0 for the same model.

The same variables under the same value references; behind them the time and the event indicators, which are variables
there.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

#: What FMI 3.0 has besides the model description where there is source.
_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{name}">
    <SourceFileSet language="C11">
      <SourceFile name="{name}.c"/>
      <SourceFile name="fmi3.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""
_SAME = ("UnitDefinitions", "LogCategories", "DefaultExperiment")
_UNKNOWNS = {"Outputs": "Output", "Derivatives": "ContinuousStateDerivative", "InitialUnknowns": "InitialUnknown"}


def build_description(name: str) -> bytes:
    """Return how the source of an FMU is built: ``sources/buildDescription.xml``."""
    return _BUILD.format(name=name).encode()


def convert_to_fmi3(description: bytes, indicators: int) -> bytes:
    """Return the description in the terms of FMI 3.0; names that share another variable's reference are left out."""
    old = ET.fromstring(description)
    scalars = list(old.iterfind("ModelVariables/ScalarVariable"))
    references = [s.get("valueReference", "") for s in scalars]
    root = ET.Element(
        "fmiModelDescription", fmiVersion="3.0", modelName=old.get("modelName", ""),
        instantiationToken=old.get("guid", ""), generationTool="aero-bayes", variableNamingConvention="structured",
    )  # fmt: skip
    _add_interfaces(root, old)
    root.extend(e for tag in _SAME if (e := old.find(tag)) is not None)
    first = _add_variables(root, scalars, references, indicators)
    structure = ET.SubElement(root, "ModelStructure")
    for above, tag in _UNKNOWNS.items():
        done: set[str] = set()
        for unknown in old.iterfind(f"ModelStructure/{above}/Unknown"):
            reference = references[int(unknown.get("index", "0")) - 1]
            if reference not in done:
                done.add(reference)
                new = ET.SubElement(structure, tag, valueReference=reference)
                on = unknown.get("dependencies")
                if on is not None:
                    new.set("dependencies", " ".join(references[int(i) - 1] for i in on.split()))
    for k in range(indicators):
        ET.SubElement(structure, "EventIndicator", valueReference=str(first + 1 + k))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'.encode()


def _add_interfaces(root: ET.Element, old: ET.Element) -> None:
    """Add model exchange and co-simulation as the old description has them."""
    for tag in ("ModelExchange", "CoSimulation"):
        interface = old.find(tag)
        assert interface is not None
        common = {
            "modelIdentifier": interface.get("modelIdentifier", ""), "canGetAndSetFMUState": "true",
            "canSerializeFMUState": "true", "providesDirectionalDerivatives": "true",
        }  # fmt: skip
        if tag == "CoSimulation":
            common["canHandleVariableCommunicationStepSize"] = "true"
        elif interface.get("completedIntegratorStepNotNeeded") == "false":
            common["needsCompletedIntegratorStep"] = "true"
        ET.SubElement(root, tag, common)


def _add_variables(root: ET.Element, scalars: list[ET.Element], references: list[str], indicators: int) -> int:
    """Add each variable once, the time and the event indicators; return the value reference of the time."""
    group = ET.SubElement(root, "ModelVariables")
    seen: set[str] = set()
    for scalar, reference in zip(scalars, references, strict=True):
        real = scalar.find("Real")
        assert real is not None
        if reference in seen:
            continue
        seen.add(reference)
        given = {
            "name": scalar.get("name", ""),
            "valueReference": reference,
            **dict(scalar.items()),
            **dict(real.items()),
        }
        if "derivative" in given:
            given["derivative"] = references[int(given["derivative"]) - 1]
        ET.SubElement(group, "Float64", given)
    first = max((int(r) for r in references), default=-1) + 1
    ET.SubElement(
        group, "Float64", name="time", valueReference=str(first), causality="independent", variability="continuous"
    )
    for k in range(indicators):
        ET.SubElement(
            group, "Float64", name=f"event_indicator[{k + 1}]", valueReference=str(first + 1 + k), causality="local",
            variability="continuous", initial="calculated",
        )  # fmt: skip
    return first
