"""A model by name: what a notebook calls before it fits."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from aero_bayes.export import export_fmu
from aero_bayes.simulation import Model


def load_model(name: str | Path, *, sources: Sequence[Path] = (), folder: Path | None = None) -> Model:
    """Open an FMU, or build one from a Modelica class.

    Parameters
    ----------
    name : str or Path
        Path of an ``.fmu`` file, or a class such as ``Aero.Systems.OneDof``.
    sources : sequence of Path
        Further Modelica files that the class needs.
    folder : Path, optional
        Where a built FMU is kept; a new temporary folder by default.

    Raises
    ------
    InputError
        For an FMU that cannot be used, or Modelica that cannot be translated.
    """
    if str(name).endswith(".fmu"):
        return Model.load(Path(name))
    target = folder if folder is not None else Path(tempfile.mkdtemp(prefix="aero-bayes-"))
    target.mkdir(parents=True, exist_ok=True)
    return Model.load(export_fmu(str(name), target / f"{str(name).rpartition('.')[2]}.fmu", sources=sources))
