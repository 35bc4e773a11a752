"""An FMU on disk: its description, read and checked once."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from aero_bayes.declared import DECLARATION_MEMBER, PackageDeclaration, parse_declaration
from aero_bayes.display import table_html
from aero_bayes.errors import InputError
from aero_bayes.files import ScratchFolder, user_cache
from aero_bayes.modelica.build import Platform, this_machine, write_archive
from aero_bayes.modelica.library import declaration_of
from aero_bayes.simulation import archive
from aero_bayes.simulation.fmi_description import parse_description, read_description
from aero_bayes.simulation.model_description import BINARY_FOLDERS, ModelDescription, listed
from aero_bayes.simulation.probed_facts import verified_copies
from aero_bayes.unknown_names import no_such_file

if TYPE_CHECKING:
    import pandas


#: Seconds that a compilation may take.
BUILD_TIME_LIMIT = 600.0


def built_from_source(path: Path, model: ModelDescription, names: Collection[str]) -> Path:
    """Return the FMU with a binary for this machine, compiled from the source inside it."""
    here = this_machine()
    binary = f"{BINARY_FOLDERS[model.fmi_version]}/{model.identifier}{here.suffix}"
    have = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
    there = ", ".join(have) or "no machine"
    if not any(n.startswith("sources/") and n.endswith((".c", ".cpp", ".xml")) for n in names):
        raise InputError(
            f"{path}: has no {binary}, binaries for {there} only and no source: export it with a "
            f"binary for {here.name}, or with its source code"
        )
    kept = user_cache() / "made" / f"{path.stem}-{model.sha256[:32]}-{here.name}.fmu"
    if kept.exists():
        return kept
    if shutil.which("cmake") is None:
        raise InputError(f"{path}: has binaries for {there} only; to compile its source: pip install cmake")
    with ScratchFolder() as folder:
        unpacked, build = folder / "fmu", folder / "build"
        unpacked.mkdir()
        build.mkdir()
        archive.extract(path, unpacked)
        _compile(path, unpacked, build)
        if not (unpacked / binary).is_file():
            raise InputError(f"{path}: its source was compiled, but to something else than {binary}")
        files = (file for file in sorted(unpacked.rglob("*")) if file.is_file())
        write_archive(kept, {file.relative_to(unpacked).as_posix(): file.read_bytes() for file in files})
    return kept


def _compile(path: Path, unpacked: Path, build: Path) -> None:
    import fmpy

    try:
        from fmpy.build import create_cmake_settings

        create_cmake_settings(unzipdir=unpacked, build_dir=build)
    except Exception as error:
        reason = f"{error}".partition("\n")[0]
        raise InputError(f"{path}: its source says not how it is compiled: {reason}") from None
    scripts = Path(fmpy.__file__).parent / "c-code"
    for command in (["-S", str(scripts), "-B", str(build)], ["--build", str(build), "--target", "install"]):
        done = subprocess.run(
            ["cmake", *command], capture_output=True, text=True, check=False, timeout=BUILD_TIME_LIMIT
        )
        if done.returncode != 0:
            lines = f"{done.stdout}\n{done.stderr}".splitlines()
            shown = next((line for line in lines if "error" in line.lower()), lines[-1] if lines else "?")
            raise InputError(f"{path}: its source does not compile: {shown.strip()[:200]}")


@dataclass(frozen=True)
class ModelicaSource:
    """What a model was built from: full name of its class, files and package folders, folders of libraries."""

    name: str
    files: tuple[Path, ...] = ()
    libraries: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Model(ModelDescription):
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
    candidate_copies : tuple of (str, int)
        Outputs that copy a state by their name or the model structure, and that state's position; not yet verified.
    fmi_version : {2, 3}
    interface : {"model exchange", "co-simulation"}
        The latter only where the FMU has no Model Exchange.
    takes_any_step : bool
        Whether a communication step of co-simulation may vary.
    interpolates_inputs : bool
        Whether co-simulation takes the slope of an input over a step beside its value.
    step_size : float, optional
        Communication step in s that the FMU proposes (``stepSize`` of its default experiment).
    execution_tool : str
        What has to be installed for the FMU to run, where it says so (``needsExecutionTool``).
    operators : tuple of DescribedOperator
        Laws that act on an input and may be applied to its signal before a run, or on an output and to its samples.
    relay : DescribedRelay, optional
        A law that steps by the sign of a speed, which a simulator may hold on a side of it.
    fixed_starts : tuple of str
        States that start where the model says (``fixed = true``), where that is known: of Modelica and our own FMUs.
    state_aliases : mapping of str to str
        The state that a variable is by its value reference.
    feedthrough : mapping of int to frozenset of str
        The inputs on which an output or a derivative, by its value reference, depends at once.
    declared : PackageDeclaration
        What the package that it is from declares of its rigs.
    source : ModelicaSource, optional
        What it was built from, where that is known.

    Examples
    --------
    >>> model.units["k"], model.parameter("k").unit, model.input("F").unit, model.output("position").description
    ('N/m', 'N/m', 'N', 'Position, as measured')
    >>> model.state_index("v"), model.copied_state("position"), model.copied_state("F")
    (1, 0, None)
    >>> dict(model.verified_copies()), dict(model.copies_by_name())  # OpenModelica's outputs only
    ({}, {})
    >>> again = aero_bayes.Model.load(model.path)
    >>> again == model
    True
    >>> Path("unpacked").mkdir()
    >>> model.unpack(Path("unpacked")) == model.binary_in(Path("unpacked"))
    True
    """

    declared: PackageDeclaration = field(default=PackageDeclaration(), compare=False, repr=False)
    source: ModelicaSource | None = field(default=None, compare=False, repr=False)

    @classmethod
    def load(cls, path: Path | str) -> Model:
        """Read and check an FMU.

        Parameters
        ----------
        path : path
            An FMI 2.0 or 3.0 FMU with Model Exchange or Co-Simulation, and a binary for this machine or C source,
            which is compiled.

        Raises
        ------
        InputError
            For a file that is not a usable FMU; the message says why.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(no_such_file(path, " (expected an FMU)"))
        names, (text, declared) = archive.read_texts(path, DECLARATION_MEMBER)
        root = parse_description(path, text)
        version = root.get("fmiVersion", "none")
        if root.tag != "fmiModelDescription" or not version.startswith(("2.", "3.")):
            raise InputError(
                f"{path}: FMI version {version} is not supported: export the model anew with FMI 2.0 or 3.0"
            )
        model = cls(**vars(read_description(path, root)))
        here = this_machine()
        binary = f"{BINARY_FOLDERS[model.fmi_version]}/{model.identifier}{here.suffix}"
        if binary not in names:
            built = built_from_source(path, model, names)
            return replace(cls.load(built), path=built, sha256=model.sha256)
        if here.suffix == ".so" and not _is_shared_library(archive.first_bytes(path, binary, 20), here):
            raise InputError(f"{path}: {binary} is no shared library for {here.name}")
        if declared:
            return replace(
                model, declared=parse_declaration(declared.decode("utf-8", "replace"), f"{path}: {DECLARATION_MEMBER}")
            )
        # Another tool's FMU of a shipped system goes by its name.
        return replace(model, declared=declaration_of(model.name))

    def causality_of(self, name: str) -> str:
        """Tell what the FMU calls a variable: ``calculatedParameter``, ``local``, ``fixed local``, ...

        Parameters
        ----------
        name : str

        Returns
        -------
        str
            Empty where the FMU has no such variable; ``fixed`` or ``constant`` stands before a local one that is.

        Examples
        --------
        >>> model.causality_of("k")
        'parameter'
        """
        _, (text,) = archive.read_texts(self.path)
        variables = parse_description(self.path, text).find("ModelVariables")
        found = [v for v in (variables if variables is not None else ()) if v.get("name") == name]
        if not found:
            return ""
        kind, varies = found[0].get("causality", "local"), found[0].get("variability", "")
        return f"{varies} {kind}" if kind == "local" and varies in ("fixed", "constant") else kind

    def verified_copies(self) -> Mapping[str, int]:
        """Return those of ``candidate_copies`` that equal their state in simulations; found once a process."""
        return verified_copies(self)

    def to_frame(self) -> pandas.DataFrame:
        """Return a row for each parameter, input, output and state: kind, unit, start, min, max (SI), description.

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
        signals = f"{listed(self.inputs)} -> {listed(self.outputs)}"
        return f"<Model {self.name}: {signals}; {counts}; FMI {self.fmi_version}, {self.interface}>"

    def _repr_html_(self) -> str:
        frame = self.to_frame()
        rows = [(name, r["kind"], r["unit"], _number(r["start"]), r["description"]) for name, r in frame.iterrows()]
        return table_html(("name", "kind", "unit", "start", "description"), rows, repr(self).strip("<>"))


def _is_shared_library(header: bytes, here: Platform) -> bool:
    """Tell whether a file that begins so is an ELF file of 64 bits, little-endian, of type DYN, for this machine."""
    machine = b"\xb7\x00" if here.name == "aarch64-linux" else b"\x3e\x00"
    return header[:6] == b"\x7fELF\x02\x01" and header[16:20] == b"\x03\x00" + machine


def _number(value: float | None) -> str:
    return "" if value is None or value != value else f"{value:g}"
