"""One FMU made of two: an FMU of another tool, and the laws around it.

The binary (``native/coupler.c``) is the same for all. A table among the resources says which variables of one part are
set from the other one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import aero_bayes.simulation
from aero_bayes.errors import InputError
from aero_bayes.export.build import compile_kept, write_archive
from aero_bayes.export.embedded import export_flat
from aero_bayes.export.platforms import this_machine
from aero_bayes.files import ScratchFolder
from aero_bayes.laws.fmu_ports import LawCoupling
from aero_bayes.simulation import BINARY_FOLDERS, Model, Variable

INNER, LAWS = 0, 1
_ENGINE = Path(aero_bayes.simulation.__file__).parent / "native"
_COUPLER = ("coupler.c", "coupling_file.c", "coupled_equations.c")
_SOURCES = (
    *(Path(__file__).parent / "native" / name for name in (*_COUPLER, "coupler.h")),
    *(_ENGINE / name for name in ("bind.c", "fmi2.c", "fmi3.c", "fmu_library.h", "fmi2.h")),
)
_TAGS = {"real": "Real", "integer": "Integer", "boolean": "Boolean"}


def couple(inner: Model, coupling: LawCoupling, out: Path, laws_out: Path) -> None:
    """Write an FMU 2.0 for Model Exchange that is an FMU with laws around it."""
    if inner.interface != "model exchange":
        raise InputError(
            f"{inner.path}: laws are put around an FMU with Model Exchange; this one has co-simulation only"
        )
    laws = Model.load(export_flat(coupling.flat, laws_out, quick=True))
    table = _CoupledDescription(inner, laws, coupling)
    identifier = "coupled"
    flags = ["-shared", "-s", "-Wl,--build-id=none", *_COUPLER, "bind.c", "fmi2.c", "fmi3.c", "-lm", "-ldl"]
    library = compile_kept(_SOURCES, flags, "coupled.so")
    folders = (BINARY_FOLDERS[inner.fmi_version], "resources")
    members = {
        f"{BINARY_FOLDERS[2]}/{identifier}{this_machine().suffix}": library,
        "resources/coupling.txt": table.text().encode(),
        **_part(inner, "inner", folders),
        **_part(laws, "laws", folders),
    }
    digest = hashlib.sha256(b"".join(members[k] for k in sorted(members))).hexdigest()
    write_archive(out, {"modelDescription.xml": table.description(identifier, digest[:32]), **members})


def _part(model: Model, folder: str, kept: Sequence[str]) -> dict[str, bytes]:
    """Return the files of an FMU that its binary may need."""
    with ScratchFolder() as scratch:
        model.unpack(scratch)
        binary = model.binary_in(scratch)
        found = [p for k in kept for p in sorted((scratch / k).rglob("*")) if p.is_file()]
        if binary not in found:
            found.append(binary)
        return {f"resources/{folder}/{p.relative_to(scratch)}": p.read_bytes() for p in found}


@dataclass(frozen=True)
class _Coupled:
    """A variable of the coupled model description."""

    v: Variable
    name: str
    reference: int
    causality: str
    variability: str = "continuous"
    initial: str = ""
    start: float | None = None
    derivative_of: str = ""
    depends: tuple[str, ...] | None = None


@dataclass
class _CoupledDescription:
    """The variables of the coupled model. Value references count them; each belongs to one part."""

    inner: Model
    laws: Model
    coupling: LawCoupling
    variables: list[tuple[int, int]] = field(default_factory=list)

    def reference(self, part: int, own: int) -> int:
        if (part, own) not in self.variables:
            self.variables.append((part, own))
        return self.variables.index((part, own))

    def text(self) -> str:
        """Return the table that ``coupling_file.c`` reads. The variables, which the description numbers, come last."""
        list(self.coupled_variables())
        inner, laws = self.inner, self.laws
        lines = []
        for model, folder in ((inner, "inner"), (laws, "laws")):
            binary = f"{folder}/{BINARY_FOLDERS[model.fmi_version]}/{model.identifier}.so"
            lines += [f"{model.fmi_version} {model.event_indicators}", binary, f"{folder}/resources", model.guid]
            lines.append(_row([(s.value_reference,) for s in model.states]))
        lines.append(_row([(int(not s.settable_start),) for s in inner.states]))
        given, acting = laws.input, laws.output
        lines += [
            _row([(v.value_reference, given(name).value_reference) for v, name in self.coupling.states]),
            _row([(acting(acts).value_reference, v.value_reference) for v, _, acts in self.coupling.inputs]),
            _row([(v.value_reference, given(name).value_reference) for v, name, _ in self.coupling.outputs]),
            _row(self.variables),
        ]
        return "\n".join(lines) + "\n"

    def coupled_variables(self) -> Iterator[_Coupled]:
        """Yield the variables in the order of the model description."""
        inner, laws, coupling = self.inner, self.laws, self.coupling
        read = {v.name: outside for v, _, outside in coupling.outputs}
        plain = [v for v in inner.outputs if v.name not in read]
        outputs = {v.name for v in plain}
        for s, rate in zip(inner.states, inner.derivatives, strict=True):
            name = state_name(s.name, read)
            known = s.start is not None
            causality = "output" if s.name in outputs else "local"
            yield _Coupled(s, name, self.reference(INNER, s.value_reference), causality,
                         initial="exact" if known else "calculated", start=s.start)  # fmt: skip
            yield _Coupled(_derivative(s), f"der({name})", self.reference(INNER, rate), "local", initial="calculated",
                         derivative_of=name)  # fmt: skip
        for s, rate in zip(laws.states, laws.derivatives, strict=True):
            yield _Coupled(s, s.name, self.reference(LAWS, s.value_reference), "local", initial="calculated")
            yield _Coupled(_derivative(s), f"der({s.name})", self.reference(LAWS, rate), "local", initial="calculated",
                         derivative_of=s.name)  # fmt: skip
        for v, outside, _ in coupling.inputs:
            reference = self.reference(LAWS, laws.input(outside).value_reference)
            yield _Coupled(v, v.name, reference, "input", start=v.start or 0.0)
        for part, model in ((INNER, inner), (LAWS, laws)):
            for v in model.parameters:
                start = v.start if v.start is not None else 0.0
                yield _Coupled(v, v.name, self.reference(part, v.value_reference), "parameter", "fixed", "exact", start)
        own = {s.name for s in inner.states}
        copies = dict(inner.candidate_copies)
        for v in plain:
            if v.name not in own:
                on = (state_name(inner.states[copies[v.name]].name, read),) if v.name in copies else None
                kind = "continuous" if v.kind == "real" else "discrete"
                yield _Coupled(v, v.name, self.reference(INNER, v.value_reference), "output", kind, "calculated",
                             depends=on)  # fmt: skip
        for v, _, outside in coupling.outputs:
            reference = self.reference(LAWS, laws.output(outside).value_reference)
            yield _Coupled(v, v.name, reference, "output", initial="calculated")

    def description(self, identifier: str, guid: str) -> bytes:
        """Write the modelDescription.xml."""
        inner = self.inner
        root = ET.Element(
            "fmiModelDescription", fmiVersion="2.0", modelName=self.coupling.flat.name, guid=guid,
            generationTool="aero-bayes coupling", variableNamingConvention="flat",
            numberOfEventIndicators=str(inner.event_indicators + self.laws.event_indicators),
        )  # fmt: skip
        exchange = ET.SubElement(root, "ModelExchange", modelIdentifier=identifier)
        exchange.set("completedIntegratorStepNotNeeded", str(not inner.wants_step_callback).lower())
        exchange.set("canBeInstantiatedOnlyOncePerProcess", str(inner.needs_instance_per_process).lower())
        exchange.set("providesDirectionalDerivative", str(inner.has_directional_derivatives).lower())
        every = list(self.coupled_variables())
        units = sorted({s.v.unit for s in every if s.v.unit and s.v.kind == "real"})
        if units:
            group = ET.SubElement(root, "UnitDefinitions")
            for unit in units:
                ET.SubElement(group, "Unit", name=unit)
        index = {s.name: i + 1 for i, s in enumerate(every)}
        group = ET.SubElement(root, "ModelVariables")
        for s in every:
            _scalar(group, s, index)
        structure = ET.SubElement(root, "ModelStructure")
        outputs = [s for s in every if s.causality == "output"]
        rates = [s for s in every if s.derivative_of]
        open_ = [s for s in every if s.initial == "calculated" and s.causality in ("output", "local")]
        for tag, group_of in (("Outputs", outputs), ("Derivatives", rates), ("InitialUnknowns", open_)):
            if group_of:
                below = ET.SubElement(structure, tag)
                for s in group_of:
                    unknown = ET.SubElement(below, "Unknown", index=str(index[s.name]))
                    on = self._rate_depends(s) if s.derivative_of else s.depends
                    if on is not None and tag != "InitialUnknowns":
                        unknown.set("dependencies", " ".join(str(index[n]) for n in on))
        ET.indent(root)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'.encode()

    def _rate_depends(self, s: _Coupled) -> tuple[str, ...] | None:
        """Return dependencies of a derivative as the FMU states them.

        None (all) where laws have states or read states."""
        inner = self.inner
        if inner.jacobian_pattern is None or self.laws.states or self.coupling.states:
            return None
        read = {v.name for v, _, _ in self.coupling.outputs}
        names = [state_name(x.name, read) for x in inner.states]
        row = names.index(s.derivative_of)
        return tuple(n for j, n in enumerate(names) if row in inner.jacobian_pattern[j]) + tuple(
            v.name for v in inner.inputs
        )


def state_name(state: str, read: Collection[str]) -> str:
    """Name of a state in the coupled model. It has a suffix where laws act on the output of the same name."""
    return f"{state}_unread" if state in read else state


def _derivative(s: Variable) -> Variable:
    return Variable(s.name, "", f"Rate of {s.name}", None, None, None, None, s.value_reference)


def _row(rows: Sequence[Sequence[int]]) -> str:
    return " ".join(map(str, (len(rows), *(n for row in rows for n in row))))


def _scalar(group: ET.Element, s: _Coupled, index: dict[str, int]) -> None:
    element = ET.SubElement(group, "ScalarVariable", name=s.name, valueReference=str(s.reference))
    if s.v.description:
        element.set("description", s.v.description)
    element.set("causality", s.causality)
    element.set("variability", s.variability)
    if s.initial:
        element.set("initial", s.initial)
    real: dict[str, str] = {}
    if s.v.kind == "real":
        real |= {"unit": s.v.unit} if s.v.unit else {}
        limits = (("min", s.v.minimum), ("max", s.v.maximum), ("nominal", s.v.nominal))
        real |= {key: repr(value) for key, value in limits if value is not None}
    if s.start is not None:
        real["start"] = repr(s.start)
    if s.derivative_of:
        real["derivative"] = str(index[s.derivative_of])
    ET.SubElement(element, _TAGS[s.v.kind], real)
