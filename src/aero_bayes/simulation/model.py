"""What an FMU says of itself, read once and kept as plain typed values."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aero_bayes.errors import InputError
from aero_bayes.simulation import archive

BINARY_FOLDER = "binaries/linux64"

Kind = Literal["real", "integer", "boolean"]


@dataclass(frozen=True)
class Variable:
    """A scalar of the model, in SI units as declared.

    ``kind`` is ``real`` for everything but discrete outputs; ``settable_start`` tells whether the start value may be
    set before initialisation.
    """

    name: str
    unit: str
    description: str
    start: float | None
    minimum: float | None
    maximum: float | None
    nominal: float | None
    value_reference: int
    kind: Kind = "real"
    settable_start: bool = False


@dataclass(frozen=True)
class Model:
    """An FMU on disk and its description.

    ``parameters`` are the Real parameters that may be set before initialisation (fixed or tunable), ``states`` the
    continuous states in the FMU's own order. ``derivatives`` holds the value references of the states' derivatives;
    ``jacobian_pattern[j]`` the states whose derivative depends on state j (None where the FMU does not say).
    ``said_copies`` pairs outputs that are said to copy a state with that state's position; see :meth:`copied_state`.
    """

    path: Path
    sha256: str
    name: str
    guid: str
    identifier: str
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    event_indicators: int
    has_directional_derivatives: bool
    needs_instance_per_process: bool
    derivatives: tuple[int, ...] = ()
    jacobian_pattern: tuple[tuple[int, ...], ...] | None = None
    wants_step_callback: bool = True
    said_copies: tuple[tuple[str, int], ...] = ()

    @classmethod
    def load(cls, path: Path | str) -> Model:
        """Read and check an FMU.

        Parameters
        ----------
        path : path
            An FMI 2.0 FMU with Model Exchange and a linux64 binary.

        Raises
        ------
        InputError
            For a file that is not a usable FMI 2.0 Model-Exchange FMU; the message says why.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such file (expected an FMU)")
        names, text = archive.read_description(path)
        root = _parse(path, text)
        model = _describe(path, root)
        binary = f"{BINARY_FOLDER}/{model.identifier}.so"
        if binary not in names:
            have = sorted({str(PurePosixPath(n).parent) for n in names if n.startswith("binaries/")}) or ["none"]
            raise InputError(f"{path}: no {binary} inside (binaries for: {', '.join(have)})")
        return model

    def parameter(self, name: str) -> Variable:
        """The parameter of this name; InputError with the names there are otherwise."""
        return self._find("parameter", self.parameters, name)

    def input(self, name: str) -> Variable:
        """The input of this name."""
        return self._find("input", self.inputs, name)

    def output(self, name: str) -> Variable:
        """The output of this name; a state may be asked for by its own name too."""
        for variable in self.states:
            if variable.name == name:
                return variable
        return self._find("output", self.outputs, name)

    def state_index(self, name: str) -> int:
        """Position of a state, by the name of the state or of an output that is this state."""
        for index, variable in enumerate(self.states):
            if variable.name == name:
                return index
        copied = self.copied_state(name)
        if copied is None:
            raise InputError(f"{self.path.name}: no state {name!r} (states: {_listed(self.states)})")
        return copied

    def copied_state(self, output: str) -> int | None:
        """Position of the state that an output is or copies; None if it is none, or there is no such output.

        An output with a value reference of its own is said to copy a state by its name or by the model structure;
        whether it does is tried on the FMU itself, once a process.
        """
        for variable in self.outputs:
            if variable.name == output and variable.kind == "real":
                for index, state in enumerate(self.states):
                    if state.value_reference == variable.value_reference:
                        return index
        if any(name == output for name, _ in self.said_copies):
            from aero_bayes.simulation.copies import true_copies

            return true_copies(self).get(output)
        return None

    def _find(self, what: str, variables: tuple[Variable, ...], name: str) -> Variable:
        for variable in variables:
            if variable.name == name:
                return variable
        raise InputError(f"{self.path.name}: no {what} {name!r} ({what}s: {_listed(variables)})")

    def unpack(self, folder: Path) -> Path:
        """Unpack into an existing private folder; returns the binary's path. No member leaves the folder."""
        archive.unpack(self.path, folder)
        return folder / BINARY_FOLDER / f"{self.identifier}.so"


def _listed(variables: Sequence[Variable]) -> str:
    names = [v.name for v in variables]
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "none"


def _parse(path: Path, text: bytes) -> Element:
    head = text[:65536]
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text or head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: modelDescription.xml declares a document type, which no FMU needs")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: modelDescription.xml is not valid XML: {error}") from error


def _number(element: Element, key: str) -> float | None:
    text = element.get(key)
    if text is None:
        return None
    if text in ("true", "false"):
        return float(text == "true")
    return float(text)


def _is_true(element: Element, key: str) -> bool:
    return element.get(key, "false") in ("true", "1")


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


def _describe(path: Path, root: Element) -> Model:
    version = root.get("fmiVersion", "none")
    if root.tag != "fmiModelDescription" or version != "2.0":
        raise InputError(f"{path}: FMI version {version} (expected 2.0)")
    exchange = root.find("ModelExchange")
    if exchange is None:
        raise InputError(f"{path}: no Model Exchange in this FMU (it has only Co-Simulation)")
    try:
        return _describe_valid(path, root, exchange)
    except (ValueError, IndexError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: modelDescription.xml contradicts FMI 2.0: {error}") from error


def _describe_valid(path: Path, root: Element, exchange: Element) -> Model:
    variables = _variables(root)
    identifier = exchange.get("modelIdentifier", "")
    if not identifier or "/" in identifier or "\\" in identifier:
        raise InputError(f"{path}: the model identifier {identifier!r} is not a file name")
    states: list[Variable] = []
    derivatives: list[int] = []
    position: dict[int, int] = {}
    depends: list[set[int] | None] = []
    for unknown in root.iterfind("ModelStructure/Derivatives/Unknown"):
        _, own, variable = variables[int(unknown.get("index", "0")) - 1]
        if own is None or own.get("derivative") is None:
            raise InputError(f"{path}: {variable.name!r} is listed as a derivative but names no state")
        at = int(own.get("derivative", "0")) - 1
        position[at] = len(states)
        states.append(variables[at][2])
        derivatives.append(variable.value_reference)
        known = unknown.get("dependencies")
        depends.append(None if known is None else {int(i) - 1 for i in known.split()})
    pattern: tuple[tuple[int, ...], ...] | None = None
    if states and all(d is not None for d in depends):
        rows = [{position[k] for k in d if k in position} for d in depends if d is not None]
        pattern = tuple(tuple(i for i, row in enumerate(rows) if j in row) for j in range(len(states)))
    _refuse_selected_states(path, states)
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
    return Model(
        path=path,
        sha256=_sha256(path),
        name=root.get("modelName", identifier),
        guid=root.get("guid", ""),
        identifier=identifier,
        parameters=tuple(pick["parameter"]),
        inputs=tuple(pick["input"]),
        outputs=tuple(pick["output"]),
        states=tuple(states),
        event_indicators=int(root.get("numberOfEventIndicators", "0")),
        has_directional_derivatives=_is_true(exchange, "providesDirectionalDerivative"),
        needs_instance_per_process=_is_true(exchange, "canBeInstantiatedOnlyOncePerProcess"),
        derivatives=tuple(derivatives),
        jacobian_pattern=pattern,
        wants_step_callback=not _is_true(exchange, "completedIntegratorStepNotNeeded"),
        said_copies=_said_copies(root, variables, position, states),
    )


# OpenModelica's name of the state behind an output that is a state.
OUTPUT_ALIAS = re.compile(r"(?:\$|_D_)outputAlias_(?P<output>.+)")
_STATE_SET = re.compile(r"(?:\$|_D_)STATESET")


def _refuse_selected_states(path: Path, states: Sequence[Variable]) -> None:
    for state in states:
        if _STATE_SET.match(state.name):
            raise InputError(
                f"{path}: {state.name!r} is selected while the model runs (dynamic state selection), which is not "
                "supported: choose the states in the source, with stateSelect = StateSelect.always or .prefer"
            )


def _said_copies(
    root: Element,
    variables: Sequence[tuple[Element, Element | None, Variable]],
    position: Mapping[int, int],
    states: Sequence[Variable],
) -> tuple[tuple[str, int], ...]:
    """Outputs that depend on one state and nothing else, or after which a state is named."""
    named = {m["output"]: i for i, s in enumerate(states) if (m := OUTPUT_ALIAS.fullmatch(s.name))}
    references = {state.value_reference for state in states}
    said = {}
    for unknown in root.iterfind("ModelStructure/Outputs/Unknown"):
        variable = variables[int(unknown.get("index", "0")) - 1][2]
        known = unknown.get("dependencies")
        depends = None if known is None else [int(i) - 1 for i in known.split()]
        if variable.kind != "real" or variable.value_reference in references:
            continue
        if variable.name in named:
            said[variable.name] = named[variable.name]
        elif depends is not None and len(depends) == 1 and depends[0] in position:
            said[variable.name] = position[depends[0]]
    return tuple(said.items())


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
