"""Units that a user gives to the variables of an FMU that declares none."""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export import write_archive
from aero_bayes.simulation.load_model import session_folder
from aero_bayes.simulation.model import Model
from aero_bayes.unknown_names import known_names_hint


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
