"""The OpenModelica route, as far as it can be held without its compiler: the script, a stand-in omc, the errors."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path

import pytest
from facts import facts

from aero_bayes.errors import InputError
from aero_bayes.modelica.compilers import DERIVATIVES, FLAGS, export_fmu, first_error, script

pytestmark = pytest.mark.fast

STAND_IN = """#!/bin/sh
# writes what a compiler would write for the name that the script gives
cat "$1" > "{log}"
name=$(sed -n 's/.*fileNamePrefix="\\([^"]*\\)".*/\\1/p' "$1")
test -f Aero/package.mo || exit 1
{action}
"""


def install(folder: Path, action: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    tool = folder / "bin" / "omc"
    tool.parent.mkdir()
    log = folder / "script.mos"
    tool.write_text(STAND_IN.format(log=log, action=action), encoding="utf-8")
    tool.chmod(tool.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", f"{tool.parent}:/usr/bin:/bin")
    return log


def test_script_loads_everything_and_builds_both_kinds():
    text = script("My.Model", ["Aero/package.mo", "More.mo"])
    lines = text.splitlines()
    assert lines[0] == f'setCommandLineOptions("{DERIVATIVES}{FLAGS}");'
    assert lines.index('loadFile("Aero/package.mo");') < lines.index('loadFile("More.mo");')
    assert 'buildModelFMU(My.Model, version="2.0", fmuType="me_cs", fileNamePrefix="My_Model");' in lines
    assert "--fmiFlags=s:cvode" in FLAGS
    assert "-disableDirectionalDerivatives" in DERIVATIVES


def test_missing_compiler_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"omc .* not on the PATH"):
        export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu", compiler="omc")
    assert not (tmp_path / "x.fmu").exists()


def test_what_omc_writes_becomes_the_output(tmp_path, monkeypatch):
    action = 'printf x > modelDescription.xml; python3 -m zipfile -c "$name.fmu" modelDescription.xml'
    log = install(tmp_path, action, monkeypatch)
    out = export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu", compiler="omc")
    with zipfile.ZipFile(out) as archive:
        assert archive.namelist() == ["modelDescription.xml", "resources/aero_bayes.toml"]
    assert "Aero.Systems.OneDof" in log.read_text(encoding="utf-8")


def refuse(*_: object, **__: object) -> None:
    raise InputError("too hard")


def test_what_the_embedded_exporter_refuses_goes_to_omc(tmp_path, monkeypatch):
    action = 'printf x > modelDescription.xml; python3 -m zipfile -c "$name.fmu" modelDescription.xml'
    install(tmp_path, action, monkeypatch)
    monkeypatch.setattr("aero_bayes.modelica.compilers.export_embedded", refuse)
    assert export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu").is_file()


def test_both_refusals_are_told(tmp_path, monkeypatch):
    install(tmp_path, 'echo "Error: Class Foo not found."', monkeypatch)
    monkeypatch.setattr("aero_bayes.modelica.compilers.export_embedded", refuse)
    with pytest.raises(InputError, match=r"too hard.*Class Foo"):
        export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu")


def test_derivatives_whose_code_does_not_compile_are_left_out(tmp_path, monkeypatch):
    action = """if grep -q disableDirectional "$1"; then echo "x_12jac.c:7:3: error: 'y' undeclared"; exit 0
    fi; printf x > modelDescription.xml; python3 -m zipfile -c "$name.fmu" modelDescription.xml"""
    install(tmp_path, action, monkeypatch)
    assert export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu", compiler="omc").is_file()


def test_the_c_compilers_line_comes_first():
    log = "Error building simulator. Build log: make ...\nx_06inz.c:12:5: error: unknown type name 'foo'\nmake: Error 1"
    assert "unknown type name 'foo'" in first_error(log)


def test_an_error_of_omc_is_one_line(tmp_path, monkeypatch):
    install(tmp_path, 'echo "[x.mo:1:1-2:2] Error: Class Foo not found."', monkeypatch)
    with pytest.raises(InputError, match=facts("Aero.Systems.OneDof", "omc", "Class Foo not found.")):
        export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu", compiler="omc")


def test_first_error_of_a_long_log():
    log = 'true\n""\nWarning: a\n[/tmp/a/B.mo:3:1] Error: Variable q not found in scope B."\nError: more'
    assert first_error(log) == "Variable q not found in scope B."
    assert "FMU" in first_error("nothing")
