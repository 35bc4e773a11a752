"""A model by name, a finished run by its folder: where a notebook begins."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from aero_bayes.export import export_fmu
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.scratch import ScratchFolder
from aero_bayes.simulation import Model


@cache
def _session() -> ScratchFolder:
    """Where built models stay until this process ends."""
    return ScratchFolder()


def load_model(
    name: str | Path, *, sources: Sequence[Path] = (), libraries: Sequence[Path] = (), folder: Path | None = None
) -> Model:
    """Open an FMU, or build one from a Modelica class.

    Parameters
    ----------
    name : str or Path
        Path of an ``.fmu`` file, or a class such as ``Aero.Systems.OneDof``.
    sources : sequence of Path
        Further Modelica files that the class needs.
    libraries : sequence of Path
        Folders of Modelica packages that these use.
    folder : Path, optional
        Where a built FMU is kept; a temporary folder that lasts as long as the process by default.

    Raises
    ------
    InputError
        For an FMU that cannot be used, or Modelica that cannot be translated.

    Examples
    --------
    >>> model = aero_bayes.load_model("Rig", sources=[Path("Rig.mo")])
    >>> model
    <Model Rig: F -> position; 3 parameters, 2 states; FMI 2, model exchange>
    """
    if str(name).endswith(".fmu"):
        return Model.load(Path(name))
    target = folder if folder is not None else Path(tempfile.mkdtemp(dir=_session().path))
    target.mkdir(parents=True, exist_ok=True)
    built = export_fmu(str(name), target / f"{str(name).rpartition('.')[2]}.fmu", sources=sources, libraries=libraries)
    return Model.load(built)


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
