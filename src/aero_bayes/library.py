"""A model by name, a finished run by its folder: where a notebook begins."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from aero_bayes.arguments import Paths, paths_of
from aero_bayes.errors import InputError
from aero_bayes.export import export_fmu
from aero_bayes.language.sources import main_class
from aero_bayes.report import write_run_page
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.scratch import ScratchFolder
from aero_bayes.simulation.model import Model, ModelicaSource

if TYPE_CHECKING:
    from aero_bayes.estimate.result import Fit
    from aero_bayes.sample.posterior import Posterior


@cache
def _session() -> ScratchFolder:
    """Where built models stay until this process ends."""
    return ScratchFolder()


def load_model(
    name: str | Path,
    *,
    sources: Paths = (),
    libraries: Paths = (),
    folder: str | Path | None = None,
) -> Model:
    """Open an FMU, or build one from a Modelica class.

    Parameters
    ----------
    name : str or path
        An ``.fmu`` file; a ``.mo`` file, whose class is the one that no other class there uses; or a class such as
        ``Aero.Systems.OneDof``.
    sources : path or sequence of paths
        Further Modelica files that the class needs.
    libraries : path or sequence of paths
        Folders of Modelica packages that these use.
    folder : path, optional
        Where a built FMU is kept; a temporary folder that lasts as long as the process by default.

    Raises
    ------
    InputError
        For an FMU that cannot be used, or Modelica that cannot be translated.

    Examples
    --------
    >>> model = aero_bayes.load_model("Rig.mo")
    >>> model
    <Model Rig: F -> position; 3 parameters, 2 states; FMI 2, model exchange>
    """
    (path,) = paths_of((name,), "name")
    if path.suffix == ".fmu":
        return Model.load(path)
    files = paths_of(sources, "sources")
    if path.suffix == ".mo":
        files, name = (path, *files), main_class(path)
    whole = (tuple(p.absolute() for p in paths) for paths in (files, paths_of(libraries, "libraries")))
    source = ModelicaSource(str(name), *whole)
    target = Path(folder) if folder is not None else Path(tempfile.mkdtemp(dir=_session().path))
    target.mkdir(parents=True, exist_ok=True)
    out = target / f"{source.name.rpartition('.')[2]}.fmu"
    export_fmu(source.name, out, sources=source.files, libraries=source.libraries)
    return replace(Model.load(out), source=source)


def open_run(directory: Path | str) -> RunDirectory:
    """Open what a command left in its output folder.

    Parameters
    ----------
    directory : path
        What was given as ``--out``.

    Returns
    -------
    RunDirectory
        ``result`` is result.json, typed; ``series`` are its curves, ``posterior`` its draws where there are any.

    Raises
    ------
    InputError
        No ``result.json`` there, or one of the files is damaged.

    Examples
    --------
    >>> run = aero_bayes.open_run("out/loop")
    >>> run.result.loop.outcome
    'extended'
    """
    return RunDirectory.read(directory)


def write_report(found: Fit | Posterior | str | Path, path: str | Path | None = None) -> Path:
    """Write the page of a fit, or draw that of a finished run again.

    Parameters
    ----------
    found : Fit, Posterior or path
        What was found, or the folder that a command wrote with ``--out``.
    path : path, optional
        The page to write, for a fit or a posterior; that of a folder is its ``report.html``.

    Returns
    -------
    Path
        The page: a single file that loads nothing from elsewhere.

    Raises
    ------
    InputError
        No ``result.json`` in the folder, or one of the files is damaged.

    Examples
    --------
    >>> aero_bayes.write_report(fit, "fit.html").name
    'fit.html'
    >>> aero_bayes.write_report("out/loop").name
    'report.html'
    """
    from aero_bayes.estimate.result import Fit
    from aero_bayes.sample.posterior import Posterior
    from aero_bayes.workflow.commands import write_page

    if isinstance(found, str | Path):
        return write_run_page(found)
    if not isinstance(found, Fit | Posterior):
        raise InputError(f"expected a Fit, a Posterior or the folder of a run, got {type(found).__name__}")
    if path is None:
        raise InputError("path: say where the page goes, such as fit.html")
    return write_page(found, Path(path))
