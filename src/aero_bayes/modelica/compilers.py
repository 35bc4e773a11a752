"""Modelica source to FMU by the first compiler that takes it: the embedded exporter, then OpenModelica."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from aero_bayes.arguments import Paths, paths_of
from aero_bayes.errors import InputError
from aero_bayes.files import ScratchFolder
from aero_bayes.modelica.build import platforms_called, this_machine, write_archive
from aero_bayes.modelica.embedded import export_embedded
from aero_bayes.modelica.library import (
    check_model_name,
    copy_sources,
    declared_members,
    identifier,
    library_roots,
    needed_libraries,
)
from aero_bayes.modelica.sources import as_packages

FLAGS = "--fmiFlags=s:cvode --fmuRuntimeDepends=modelica"
DERIVATIVES = "-d=-disableDirectionalDerivatives "
OMC_TIME_LIMIT = 600.0
C_ERROR = re.compile(r":\d+(?::\d+)?: (?:fatal )?error: (?P<message>[^\n]+)")


def export_openmodelica(model: str, out: Path, sources: Sequence[Path] = (), libraries: Sequence[Path] = ()) -> Path:
    """Write the FMU of ``model`` to ``out`` with ``omc``."""
    compiler = shutil.which("omc")
    if compiler is None:
        raise InputError("omc (OpenModelica) is not on the PATH; install it or use the embedded exporter")
    check_model_name(model)
    with ScratchFolder() as folder:
        staged = copy_sources(folder, sources)
        # without any the compiler looks for libraries itself, where a model says which ones it uses
        packages = needed_libraries(model, staged, library_roots(libraries)) if libraries else {}
        files = [str(p / "package.mo" if p.is_dir() else p) for p in packages.values()]
        files += [f.relative_to(folder).as_posix() for f in staged]
        made = folder / f"{identifier(model)}.fmu"
        text = _run(compiler, folder, model, script(model, files, DERIVATIVES + FLAGS))
        if not made.is_file() and C_ERROR.search(text):
            text = _run(compiler, folder, model, script(model, files, FLAGS))
        if not made.is_file():
            raise InputError(f"{model}: omc: {first_error(text)}")
        try:
            with zipfile.ZipFile(made) as archive:
                members = {n: archive.read(n) for n in archive.namelist() if not n.endswith("/")}
        except zipfile.BadZipFile:
            raise InputError(f"{model}: omc wrote a damaged FMU") from None
    write_archive(out, members | declared_members(model, sources))
    return out


def _run(compiler: str, folder: Path, model: str, lines: str) -> str:
    """Return what omc prints."""
    (folder / "export.mos").write_text(lines, encoding="utf-8")
    try:
        done = subprocess.run(
            [compiler, "export.mos"], cwd=folder, capture_output=True, text=True, check=False, timeout=OMC_TIME_LIMIT
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{model}: omc did not finish within {OMC_TIME_LIMIT:g} s") from None
    return done.stdout + done.stderr


def script(model: str, files: Sequence[str], flags: str = DERIVATIVES + FLAGS) -> str:
    """Return the ``.mos`` script: load the files in order, build the FMU, print what went wrong."""
    lines = [f'setCommandLineOptions("{flags}");', "getErrorString();"]
    for file in files:
        lines += [f'loadFile("{file}");', "getErrorString();"]
    lines += [
        f'buildModelFMU({model}, version="2.0", fmuType="me_cs", fileNamePrefix="{identifier(model)}");',
        "getErrorString();",
    ]
    return "\n".join(lines) + "\n"


def first_error(text: str) -> str:
    """Return the first error line of omc's output, or of the C compiler that it calls, without its temporary folder."""
    if found := C_ERROR.search(text):
        return f"the C compiler: {found['message'].strip()}"
    for line in text.splitlines():
        _, mark, message = line.partition("Error:")
        if mark:
            return message.strip().rstrip('"')
    return "no FMU was written, and no error was printed"


Compiler = Literal["auto", "omc", "embedded"]


def export_fmu(
    model: str,
    out: Path | str,
    *,
    compiler: Compiler = "auto",
    sources: Paths = (),
    libraries: Paths = (),
    platforms: str | Sequence[str] = (),
    stop: float | None = None,
) -> Path:
    """Export a Modelica model as an FMU for Model Exchange and Co-Simulation.

    Parameters
    ----------
    model : str
        Full name, such as ``Aero.Systems.OneDof``. Shipped packages of rigs are always loaded.
    out : path
        The FMU to write; it appears whole or not at all.
    compiler : {"auto", "omc", "embedded"}
        ``auto``: the embedded exporter, whose FMUs are several times faster and take a second; where it refuses the
        model and ``omc`` is on the PATH, that.
    sources : path or sequence of paths
        Further ``.mo`` files or package folders, loaded beside them.
    libraries : path or sequence of paths
        Folders that hold packages which the sources use, such as the Modelica Standard Library. Those that MODELICAPATH
        names and OpenModelica's own are looked through too. OpenModelica finds libraries in its own way as well.
    platforms : str or sequence of str
        ``all``, or some of ``linux64``, ``win64``, ``aarch64-linux`` and ``darwin64``; this machine by default. Others
        are compiled by the wheel ziglang (``aero-bayes[platforms]``). The C source is always inside.
    stop : float, optional
        End of the default experiment in s.

    Returns
    -------
    Path
        ``out``.

    Raises
    ------
    InputError
        For a model with errors, a construct that the exporter cannot translate, or a tool that is missing.

    Examples
    --------
    >>> aero_bayes.export_fmu("Rig", "Rig.fmu", sources="Rig.mo")
    PosixPath('Rig.fmu')
    """
    out, sources = Path(out), as_packages(paths_of(sources, "sources"))
    libraries = paths_of(libraries, "libraries")
    wanted = platforms_called(platforms)
    elsewhere = wanted != (this_machine(),)
    if compiler not in ("auto", "omc", "embedded"):
        raise InputError(f"compiler {compiler!r}: expected auto, omc or embedded")
    if compiler == "omc" and elsewhere:
        raise InputError("--platforms: OpenModelica writes for this machine only; expected --compiler embedded")
    if compiler == "omc":
        return export_openmodelica(model, out, sources, libraries)
    try:
        return export_embedded(model, out, sources, libraries, platforms=wanted, stop=stop)
    except InputError as refusal:
        if compiler == "embedded" or elsewhere or shutil.which("omc") is None:
            raise
        try:
            return export_openmodelica(model, out, sources, libraries)
        except InputError as other:
            raise InputError(f"{refusal}; and OpenModelica: {other}") from None
