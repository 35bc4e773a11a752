"""Where the Modelica package ``Aero`` is, and how a model's sources are laid out for a compiler."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

from aero_bayes.errors import InputError


def modelica_root() -> Path:
    """Folder that contains the package ``Aero``: installed with this package, or ``modelica/`` of a checkout."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "modelica", package.parent.parent / "modelica"):
        if (folder / "Aero" / "package.mo").is_file():
            return folder
    raise InputError("the Modelica package Aero was not found; reinstall aero-bayes")


def stage(folder: Path, sources: Sequence[Path]) -> list[Path]:
    """Copy the shipped package and further files into an empty folder, so that nothing beside them is read.

    Returns
    -------
    list of Path
        Files to load, the package first.

    Raises
    ------
    InputError
        For a source that is missing, is no Modelica file, or names a package that is there already.
    """
    shutil.copytree(modelica_root() / "Aero", folder / "Aero")
    loaded = [folder / "Aero" / "package.mo"]
    for source in map(Path, sources):
        if source.is_dir():
            if not (source / "package.mo").is_file():
                raise InputError(f"{source}: a Modelica package folder needs a package.mo")
            target = folder / source.name
            if target.exists():
                raise InputError(f"{source}: a package of that name is already loaded")
            shutil.copytree(source, target)
            loaded.append(target / "package.mo")
        else:
            if source.suffix != ".mo" or not source.is_file():
                raise InputError(f"{source}: expected a Modelica file (.mo)")
            target = folder / source.name
            if target.exists():
                raise InputError(f"{source}: a file of that name is already loaded")
            shutil.copyfile(source, target)
            loaded.append(target)
    return loaded


def check_model_name(model: str) -> str:
    """The name unchanged where it is a dotted Modelica name. Raises InputError otherwise."""
    if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", model):
        raise InputError(f"{model!r} is not a Modelica model name such as Aero.Systems.OneDof")
    return model


def identifier(model: str) -> str:
    """The model's name as a C identifier, which names the FMU's library."""
    return model.replace(".", "_")
