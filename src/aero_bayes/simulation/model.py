"""What an FMU says of itself, read once and kept as plain typed values."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal

from aero_bayes.declared import DECLARATION_MEMBER, PackageDeclaration, parse_declaration
from aero_bayes.display import table_html
from aero_bayes.errors import InputError
from aero_bayes.export.library import declaration_of
from aero_bayes.simulation import archive

if TYPE_CHECKING:
    import pandas

BINARY_FOLDERS = {2: "binaries/linux64", 3: "binaries/x86_64-linux"}

Kind = Literal["real", "integer", "boolean"]
Interface = Literal["model exchange", "co-simulation"]


@dataclass(frozen=True)
class Variable:
    """A scalar of the model, in SI units as declared.

    ``kind`` is ``real`` for everything but discrete outputs; ``settable_start`` tells whether the start value may be
    set before initialisation, ``discrete`` whether the value may change at events only.
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
    discrete: bool = False


@dataclass(frozen=True)
class ModelicaSource:
    """What a model was built from: full name of its class, files and package folders, folders of libraries."""

    name: str
    files: tuple[Path, ...] = ()
    libraries: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Model:
    """An FMU on disk and its description.

    Parameters
    ----------
    path : Path
    sha256 : str
        Hash of the file.
    name, guid, identifier : str
        As the FMU has them.
    parameters : tuple of Variable
        Real parameters that may be set before initialisation (fixed or tunable).
    inputs, outputs : tuple of Variable
    states : tuple of Variable
        Continuous states in the FMU's own order; none where it has co-simulation only.
    event_indicators : int
    has_directional_derivatives, needs_instance_per_process : bool
    derivatives : tuple of int
        Value references of the states' derivatives.
    jacobian_pattern : tuple of tuples of int, optional
        ``jacobian_pattern[j]``: the states whose derivative depends on state j; None where the FMU does not say.
    wants_step_callback : bool
    said_copies : tuple of (str, int)
        Outputs that are said to copy a state, and that state's position; see :meth:`copied_state`.
    fmi_version : {2, 3}
    interface : {"model exchange", "co-simulation"}
        The latter only where the FMU has no Model Exchange.
    takes_any_step : bool
        Whether a communication step of co-simulation may vary.
    interpolates_inputs : bool
        Whether co-simulation takes the slope of an input over a step beside its value.
    declared : Declaration
        What the package that it is from declares of its rigs.
    source : ModelicaSource, optional
        What it was built from, where that is known.

    Examples
    --------
    >>> model.parameter("k").unit, model.input("F").unit, model.output("position").description
    ('N/m', 'N', 'Position, as measured')
    >>> model.state_index("v"), model.copied_state("position"), model.copied_state("F")
    (1, 0, None)
    >>> again = aero_bayes.Model.load(model.path)
    >>> again == model
    True
    >>> Path("unpacked").mkdir()
    >>> model.unpack(Path("unpacked")) == model.binary_in(Path("unpacked"))
    True
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
    fmi_version: int = 2
    interface: Interface = "model exchange"
    takes_any_step: bool = True
    interpolates_inputs: bool = False
    declared: PackageDeclaration = field(default=PackageDeclaration(), compare=False, repr=False)
    source: ModelicaSource | None = field(default=None, compare=False, repr=False)

    @classmethod
    def load(cls, path: Path | str) -> Model:
        """Read and check an FMU.

        Parameters
        ----------
        path : path
            An FMI 2.0 or 3.0 FMU with Model Exchange or Co-Simulation and a binary for Linux on x86-64.

        Raises
        ------
        InputError
            For a file that is not a usable FMU; the message says why.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such file (expected an FMU)")
        names, (text, declared) = archive.read_texts(path, DECLARATION_MEMBER)
        from aero_bayes.simulation import description2, description3

        root = description2.parse(path, text)
        version = root.get("fmiVersion", "none")
        if root.tag != "fmiModelDescription" or not version.startswith(("2.", "3.")):
            raise InputError(
                f"{path}: FMI version {version} is not supported: export the model anew with FMI 2.0 or 3.0"
            )
        model = description2.describe(path, root) if version.startswith("2.") else description3.describe(path, root)
        binary = f"{BINARY_FOLDERS[model.fmi_version]}/{model.identifier}.so"
        if binary not in names:
            have = sorted({str(PurePosixPath(n).parent) for n in names if n.startswith("binaries/")}) or ["none"]
            raise InputError(f"{path}: no {binary} inside (binaries for: {', '.join(have)})")
        if not _is_shared_library(archive.first_bytes(path, binary, 20)):
            raise InputError(f"{path}: {binary} is no shared library for Linux on x86-64")
        if declared:
            return replace(
                model, declared=parse_declaration(declared.decode("utf-8", "replace"), f"{path}: {DECLARATION_MEMBER}")
            )
        # Another tool's FMU of a shipped system goes by its name.
        return replace(model, declared=declaration_of(model.name))

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

    def to_frame(self) -> pandas.DataFrame:
        """A row for each parameter, input, output and state: kind, unit, start, min, max (SI), description.

        Examples
        --------
        >>> model.to_frame().query("kind == 'input'").index.to_list()
        ['F']
        """
        import pandas

        rows = [
            (v.name, kind, v.unit, v.start, v.minimum, v.maximum, v.description)
            for kind, variables in (
                ("parameter", self.parameters), ("input", self.inputs), ("output", self.outputs), ("state", self.states)
            )
            for v in variables
        ]  # fmt: skip
        columns = ["name", "kind", "unit", "start", "min", "max", "description"]
        return pandas.DataFrame(rows, columns=columns).set_index("name")

    def __repr__(self) -> str:
        counts = f"{len(self.parameters)} parameters, {len(self.states)} states"
        signals = f"{_listed(self.inputs)} -> {_listed(self.outputs)}"
        return f"<Model {self.name}: {signals}; {counts}; FMI {self.fmi_version}, {self.interface}>"

    def _repr_html_(self) -> str:
        frame = self.to_frame()
        rows = [(name, r["kind"], r["unit"], _number(r["start"]), r["description"]) for name, r in frame.iterrows()]
        return table_html(("name", "kind", "unit", "start", "description"), rows, repr(self).strip("<>"))

    def unpack(self, folder: Path | str) -> Path:
        """Unpack into an existing private folder; returns the binary's path. No member leaves the folder."""
        archive.unpack(self.path, Path(folder))
        return self.binary_in(folder)

    def binary_in(self, folder: Path | str) -> Path:
        """Where the binary is in a folder into which the FMU was unpacked."""
        return Path(folder) / BINARY_FOLDERS[self.fmi_version] / f"{self.identifier}.so"


def _is_shared_library(header: bytes) -> bool:
    """Whether a file that begins so is an ELF file of 64 bits, little-endian, of the type DYN, for x86-64."""
    return header[:6] == b"\x7fELF\x02\x01" and header[16:20] == b"\x03\x00\x3e\x00"


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


def _number(value: float | None) -> str:
    return "" if value is None or value != value else f"{value:g}"


def _listed(variables: Sequence[Variable]) -> str:
    names = [v.name for v in variables]
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "none"


def sha256(path: Path) -> str:
    """Checksum of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
