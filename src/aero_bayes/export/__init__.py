"""Modelica source to FMU: OpenModelica where it is installed, else the embedded exporter.

>>> from pathlib import Path
>>> from aero_bayes.export import export_fmu
>>> export_fmu("Aero.Systems.OneDof", Path("OneDof.fmu"))  # doctest: +SKIP
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from aero_bayes.errors import InputError
from aero_bayes.export.catalogue import CATALOGUE, PORTS, Effect, EffectParameter, Port
from aero_bayes.export.extend import (
    CURVE_STATES,
    PROBES,
    EffectUse,
    ExtendedModel,
    FreeForm,
    curve_unit,
    effect_of,
    write_extension,
    write_probes,
    write_screening,
)
from aero_bayes.export.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.export.library import modelica_root

Compiler = Literal["auto", "omc", "embedded"]

__all__ = [
    "CATALOGUE",
    "CURVE_STATES",
    "PORTS",
    "PROBES",
    "Compiler",
    "Effect",
    "EffectParameter",
    "EffectUse",
    "ExtendedModel",
    "FlatEquation",
    "FlatModel",
    "FlatVariable",
    "FreeForm",
    "Port",
    "curve_unit",
    "effect_of",
    "export_flat",
    "export_fmu",
    "load_flat",
    "modelica_root",
    "write_extension",
    "write_probes",
    "write_screening",
]


def export_fmu(
    model: str,
    out: Path | str,
    *,
    compiler: Compiler = "auto",
    sources: Sequence[Path] = (),
    libraries: Sequence[Path] = (),
) -> Path:
    """Export a Modelica model as an FMI 2.0 FMU for Model Exchange and Co-Simulation.

    Parameters
    ----------
    model : str
        Full name, such as ``Aero.Systems.OneDof``. The shipped package ``Aero`` is always loaded.
    out : Path
        The FMU to write; it appears whole or not at all.
    compiler : {"auto", "omc", "embedded"}
        ``auto``: ``omc`` where it is on the PATH, else the embedded exporter.
    sources : sequence of Path
        Further ``.mo`` files or package folders, loaded beside ``Aero``.
    libraries : sequence of Path
        Folders that hold packages which the sources use, such as the Modelica Standard Library. Those that MODELICAPATH
        names and OpenModelica's own are looked through too. OpenModelica finds libraries in its own way as well.

    Returns
    -------
    Path
        ``out``.

    Raises
    ------
    InputError
        For a model with errors, a construct that the exporter cannot translate, or a tool that is missing.
    """
    out = Path(out)
    if compiler == "omc" or (compiler == "auto" and shutil.which("omc") is not None):
        from aero_bayes.export.openmodelica import export_openmodelica

        return export_openmodelica(model, out, sources, libraries)
    if compiler not in ("auto", "embedded"):
        raise InputError(f"compiler {compiler!r}: expected auto, omc or embedded")
    from aero_bayes.export.embedded import export_embedded

    return export_embedded(model, out, sources, libraries)


def load_flat(model: str, sources: Sequence[Path] = (), libraries: Sequence[Path] = ()) -> FlatModel:
    """Flatten a Modelica model; :mod:`aero_bayes.export.compose` builds others from it. See :func:`export_fmu`."""
    from aero_bayes.export.rumoca_front import load_flat as load

    return load(model, sources, libraries)


def export_flat(flat: FlatModel, out: Path | str, *, quick: bool = False) -> Path:
    """Write the FMU of a flat model; ``quick`` compiles faster to code that runs somewhat slower."""
    from aero_bayes.export.embedded import export_flat as export

    return export(flat, Path(out), quick=quick)
