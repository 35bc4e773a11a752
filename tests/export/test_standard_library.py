"""Small models on the Modelica Standard Library, against rumoca's own simulator. Skipped where there is no library."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest

from aero_bayes.errors import InputError
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.library import library_roots, link_packages, needed_libraries
from aero_bayes.modelica.rumoca_front import load_flat

SOURCE = Path(__file__).parent / "MslModels.mo"
MODELS = re.findall(r"^  model (\w+)", SOURCE.read_text(encoding="utf-8"), re.MULTILINE)
STOP = 2.0

REFERENCE = """
import json, sys, rumoca
root, source, model, stop, *outputs = sys.argv[1:]
config = rumoca.SimConfig(rtol=1e-10, atol=1e-12, max_wall_seconds=120)
found = rumoca.Session(roots=[root]).load(source, model=model).simulate((0, float(stop)), dt=0.01, config=config)
print(json.dumps([list(map(float, found[n])) for n in outputs] + [list(map(float, found.time))]))
"""


@cache
def libraries() -> Path | None:
    """Folder of the standard library as the exporter finds it."""
    try:
        return link_packages(needed_libraries("Modelica.Any", [], library_roots()))
    except InputError:
        return None


def outputs_of(model: str) -> list[str]:
    text = SOURCE.read_text(encoding="utf-8").split(f"  model {model} ")[1].split(f"  end {model};")[0]
    return re.findall(r"(\w+) = ", re.findall(r"output Real (.*);", text)[0])


@pytest.mark.parametrize("model", MODELS)
def test_agrees_with_the_front_ends_simulator(model, tmp_path):
    root = libraries()
    if root is None:
        pytest.skip("the Modelica Standard Library is not in MODELICAPATH or beside OpenModelica")
    outputs = outputs_of(model)
    environment = {k: v for k, v in os.environ.items() if k != "MODELICAPATH"}
    done = subprocess.run(
        [sys.executable, "-c", REFERENCE, str(root), str(SOURCE), f"MslModels.{model}", str(STOP), *outputs],
        capture_output=True, text=True, check=True, env=environment,
    )  # fmt: skip
    *expected, time = json.loads(done.stdout)
    path = export_fmu(f"MslModels.{model}", tmp_path / "m.fmu", compiler="embedded", sources=[SOURCE])
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="CoSimulation",
        stop_time=STOP,
        output_interval=0.01,
        relative_tolerance=1e-10,
        output=outputs,
    )
    for name, values in zip(outputs, expected, strict=True):
        at = np.interp(found["time"], time, values)
        assert np.max(np.abs(found[name] - at)) <= 1e-6 * max(np.ptp(values), 1e-12), name


def test_a_library_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("aero_bayes.modelica.library._OWN", ())
    monkeypatch.delenv("MODELICAPATH", raising=False)
    monkeypatch.delenv("OPENMODELICAHOME", raising=False)
    with pytest.raises(InputError, match=r"needs the Modelica Standard Library.*MODELICAPATH") as refused:
        export_fmu("MslModels.Heat1", tmp_path / "m.fmu", compiler="embedded", sources=[SOURCE])
    assert "--library" in refused.value.configured
    with pytest.raises(InputError, match="no such folder of Modelica packages"):
        library_roots([tmp_path / "nowhere"])


def test_libraries_are_found_by_name_and_version(modelica, tmp_path):
    for folder in ("Tanks 1.2.0", "Tanks 1.10.0", "Pumps"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "package.mo").write_text("package P end P;", encoding="utf-8")
    source = modelica("model Rig\n  Tanks.Open tank;\n  Pumps.Small pump;\n  Nowhere.Else x;\nend Rig;\n")
    found = needed_libraries("Rig", [source], [tmp_path])
    assert {n: p.name for n, p in found.items()} == {"Tanks": "Tanks 1.10.0", "Pumps": "Pumps"}


def test_a_package_may_use_a_library_that_its_first_file_does_not_name(tmp_path):
    """And units that are written by hand do not keep it from being read."""
    (tmp_path / "libraries").mkdir()
    (tmp_path / "libraries" / "Modelica.mo").write_text(
        'package Modelica\n  connector RealInput = input Real;\n  type Mass = Real(unit = "kg");\nend Modelica;\n'
    )
    package = tmp_path / "Own"
    package.mkdir()
    (package / "package.mo").write_text("package Own\nend Own;\n")
    (package / "Rig.mo").write_text(
        "within Own;\nmodel Rig\n  parameter Modelica.Mass m = 2;\n  Modelica.RealInput u;\n"
        '  Real p(unit = "kg*m/s", start = 0, fixed = true);\nequation\n  der(p) = u / m;\nend Rig;\n'
    )
    flat = load_flat("Own.Rig", [package], [tmp_path / "libraries"])
    assert {v.name: v.unit for v in flat.variables} == {"m": "kg", "u": "", "p": "kg.m/s"}
    assert (package / "package.mo").read_text() == "package Own\nend Own;\n"
