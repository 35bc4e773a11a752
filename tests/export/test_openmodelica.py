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


def install(folder: Path, action: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tool = folder / "bin" / "omc"
    tool.parent.mkdir()
    tool.write_text(STAND_IN.format(log=folder / "script.mos", action=action), encoding="utf-8")
    tool.chmod(tool.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", f"{tool.parent}:/usr/bin:/bin")


def test_script_loads_everything_and_builds_both_kinds():
    text = script("My.Model", ["Aero/package.mo", "More.mo"])
    lines = text.splitlines()
    assert lines[0] == f'setCommandLineOptions("{DERIVATIVES}{FLAGS}");'
    assert lines.index('loadFile("Aero/package.mo");') < lines.index('loadFile("More.mo");')
    assert 'buildModelFMU(My.Model, version="2.0", fmuType="me_cs", fileNamePrefix="My_Model");' in lines
    assert "--fmiFlags=s:cvode" in FLAGS
    assert "-disableDirectionalDerivatives" in DERIVATIVES


WRITE = 'printf x > modelDescription.xml; python3 -m zipfile -c "$name.fmu" modelDescription.xml'
#: Code of derivatives that does not compile.
ONLY_PLAIN = f"""if grep -q disableDirectional "$1"; then echo "x_12jac.c:7:3: error: 'y' undeclared"; exit 0
    fi; {WRITE}"""


@pytest.fixture
def export(tmp_path, monkeypatch):
    """``export(action, compiler)`` exports with an omc that does this; without a compiler the embedded one refuses."""

    def refuse(*_: object, **__: object) -> None:
        raise InputError("too hard")

    def run(action: str, compiler: str | None = None) -> Path:
        install(tmp_path, action, monkeypatch)
        monkeypatch.setattr("aero_bayes.modelica.compilers.export_embedded", refuse)
        given = {} if compiler is None else {"compiler": compiler}
        return export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu", **given)

    return run


def test_missing_compiler_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"omc .* not on the PATH"):
        export_fmu("Aero.Systems.OneDof", tmp_path / "x.fmu", compiler="omc")
    assert not (tmp_path / "x.fmu").exists()


@pytest.mark.parametrize(("action", "compiler"), [(WRITE, "omc"), (ONLY_PLAIN, "omc"), (WRITE, None)])
def test_what_omc_writes_becomes_the_output(export, action, compiler, tmp_path):
    with zipfile.ZipFile(export(action, compiler)) as archive:
        assert archive.namelist() == ["modelDescription.xml", "resources/aero_bayes.toml"]
    assert "Aero.Systems.OneDof" in (tmp_path / "script.mos").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("compiler", "told"),
    [(None, ("too hard", "Class Foo")), ("omc", ("Aero.Systems.OneDof", "omc", "Class Foo not found."))],
)
def test_an_error_of_omc_is_told(export, compiler, told):
    with pytest.raises(InputError, match=facts(*told)) as caught:
        export('echo "[x.mo:1:1-2:2] Error: Class Foo not found."', compiler)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("log", "first"),
    [
        ('true\n""\nWarning: a\n[/tmp/a/B.mo:3:1] Error: Variable q not found in scope B."\nError: more',
         "Variable q not found in scope B."),
        ("Error building simulator. Build log: make ...\nx_06inz.c:12:5: error: unknown type name 'foo'\nmake: Error 1",
         "unknown type name 'foo'"),
        ("nothing", "FMU"),
    ],
)  # fmt: skip
def test_first_error_of_a_log(log, first):
    assert first in first_error(log)
