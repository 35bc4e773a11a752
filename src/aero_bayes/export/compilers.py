"""Modelica source to FMU by the first compiler that takes it: the embedded exporter, then OpenModelica."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from aero_bayes.arguments import Paths, paths_of
from aero_bayes.errors import InputError
from aero_bayes.export.embedded import export_embedded
from aero_bayes.export.openmodelica import export_openmodelica
from aero_bayes.export.platforms import platforms_called, this_machine

Compiler = Literal["auto", "omc", "embedded"]


def first_compiler(compiler: Compiler, attempt: Callable[[Compiler], Path]) -> Path:
    """Return what the first compiler makes that does not refuse.

    For ``auto`` the embedded one, then ``omc`` if it is there."""
    if compiler != "auto":
        return attempt(compiler)
    try:
        return attempt("embedded")
    except InputError as refusal:
        if shutil.which("omc") is None:
            raise
        try:
            return attempt("omc")
        except InputError as other:
            raise InputError(f"{refusal}; and OpenModelica: {other}") from None


def export_fmu(
    model: str,
    out: Path | str,
    *,
    compiler: Compiler = "auto",
    sources: Paths = (),
    libraries: Paths = (),
    fmi: int = 2,
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
    fmi : int
        2 or 3: version of the standard. The embedded exporter alone writes FMI 3.0.
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
    out, sources, libraries = Path(out), paths_of(sources, "sources"), paths_of(libraries, "libraries")
    wanted = platforms_called(platforms)

    def attempt(one: Compiler) -> Path:
        if one == "omc":
            return export_openmodelica(model, out, sources, libraries)
        return export_embedded(model, out, sources, libraries, fmi=fmi, platforms=wanted, stop=stop)

    return first_compiler(_usable_compiler(compiler, fmi, here_only=wanted == (this_machine(),)), attempt)


def _usable_compiler(compiler: Compiler, fmi: int, *, here_only: bool) -> Compiler:
    """Return the compiler, or the only one that can do what is asked."""
    if compiler not in ("auto", "omc", "embedded"):
        raise InputError(f"compiler {compiler!r}: expected auto, omc or embedded")
    if fmi not in (2, 3):
        raise InputError(f"FMI {fmi}: expected 2 or 3")
    if fmi == 2 and here_only:
        return compiler
    if compiler == "omc":
        raise InputError(
            "FMI 3.0 and binaries for other machines are written by the embedded exporter only; expected "
            "--compiler embedded"
        )
    return "embedded"
