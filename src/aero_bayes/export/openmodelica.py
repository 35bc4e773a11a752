"""Export by OpenModelica's compiler ``omc``.

Its default co-simulation solver is forward Euler, which the stiff motor circuit makes unstable, and it emits no
directional derivatives unless asked: hence the flags. Where the code of the derivatives does not compile (functions
with algorithms), the FMU is built without them.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.build import write_archive
from aero_bayes.export.library import (
    check_model_name,
    copy_sources,
    declared_members,
    identifier,
    library_roots,
    needed_libraries,
)
from aero_bayes.files import ScratchFolder

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
