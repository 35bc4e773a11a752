"""Units that a user gives to the variables of an FMU that declares none."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

from aero_bayes.arguments import Paths, paths_of
from aero_bayes.errors import InputError
from aero_bayes.files import ScratchFolder
from aero_bayes.modelica.build import write_archive
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.sources import as_packages, main_class
from aero_bayes.simulation.model import Model, ModelicaSource
from aero_bayes.unknown_names import known_names_hint


def session_folder() -> Path:
    """Return a new folder that stays until this process ends."""
    return Path(tempfile.mkdtemp(dir=_session().path))


@cache
def _session() -> ScratchFolder:
    """Return where built models stay until this process ends."""
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

    Returns
    -------
    Model
        Its inputs, outputs, states and parameters, in SI units.

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
    files = as_packages(paths_of(sources, "sources"))
    if path.suffix == ".mo":
        (path,) = as_packages([path])
        files, name = (path, *files), main_class(path)
    whole = (tuple(p.absolute() for p in paths) for paths in (files, paths_of(libraries, "libraries")))
    source = ModelicaSource(str(name), *whole)
    target = Path(folder) if folder is not None else session_folder()
    target.mkdir(parents=True, exist_ok=True)
    out = target / f"{source.name.rpartition('.')[2]}.fmu"
    export_fmu(source.name, out, sources=source.files, libraries=source.libraries)
    return replace(Model.load(out), source=source)


def with_units(fmu: Path, units: Mapping[str, str]) -> Path:
    """Write a copy of an FMU, until this process ends, whose variables have these units. Returns its path."""
    Model.load(fmu)  # refuses what must not be unpacked
    with zipfile.ZipFile(fmu) as archive:
        members = {i.filename: archive.read(i) for i in archive.infolist() if not i.is_dir()}
    root = ET.fromstring(members["modelDescription.xml"])
    variables = {v.get("name", ""): v for v in root.iterfind("ModelVariables/*")}
    defined = root.find("UnitDefinitions")
    if defined is None:
        defined = ET.Element("UnitDefinitions")
        kinds = ("ModelExchange", "CoSimulation", "ScheduledExecution")
        root.insert(max(k for k, e in enumerate(root) if e.tag in kinds) + 1, defined)
    known = {u.get("name") for u in defined}
    for name, unit in units.items():
        found = variables.get(name)
        real = found.find("Real") if found is not None and found.tag == "ScalarVariable" else found
        if real is None:
            raise InputError(f"{fmu}: no real variable {name!r}{known_names_hint(name, variables)}")
        real.set("unit", unit)
        if unit not in known:
            ET.SubElement(defined, "Unit", name=unit)
            known.add(unit)
    target = session_folder() / fmu.name
    write_archive(target, {**members, "modelDescription.xml": ET.tostring(root, "utf-8", xml_declaration=True)})
    return target
