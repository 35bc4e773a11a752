"""Compilers, archives, and the package as it is installed."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from aero_bayes.errors import InputError
from aero_bayes.modelica.build import c_compiler, write_archive
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.library import modelica_root
from aero_bayes.modelica.rumoca_front import refuse_dropped
from aero_bayes.modelica.units import base_units, conversion, to_modelica_unit

pytestmark = pytest.mark.fast


def test_no_compiler_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install ziglang"):
        c_compiler()


def test_the_compiler_named_by_the_environment_comes_first(monkeypatch):
    monkeypatch.setenv("CC", "sh -x")
    assert c_compiler() == ["sh", "-x"]
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(InputError, match="'no-such-compiler'"):
        c_compiler()


def test_a_failing_compiler_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "false")
    with pytest.raises(InputError, match="compiler 'false' failed"):
        export_fmu("Aero.Systems.HalfQuad", tmp_path / "x.fmu", compiler="embedded")
    assert list(tmp_path.iterdir()) == []


def test_an_archive_appears_whole_or_not_at_all(tmp_path):
    out = tmp_path / "a.zip"
    write_archive(out, {"b": b"1", "modelDescription.xml": b"2"})
    before = out.read_bytes()
    with pytest.raises(TypeError):
        write_archive(out, {"b": None})  # type: ignore[dict-item]
    assert out.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.zip"]
    with zipfile.ZipFile(out) as archive:
        assert archive.namelist()[0] == "modelDescription.xml"


def test_every_folder_of_the_package_lists_its_classes():
    root = modelica_root() / "Aero"
    folders = [root, *(p for p in root.iterdir() if p.is_dir())]
    for folder in folders:
        listed = (folder / "package.order").read_text(encoding="utf-8").split()
        classes = {p.stem for p in folder.glob("*.mo")} - {"package"}
        packages = {p.name for p in folder.iterdir() if p.is_dir()}
        assert set(listed) == classes | packages, folder
        assert len(listed) == len(set(listed))


def test_the_package_has_nothing_that_the_front_end_drops():
    root = modelica_root()
    refuse_dropped(root, (root / "Aero").rglob("*.mo"))


def test_every_class_is_documented_and_drawn():
    for path in sorted((modelica_root() / "Aero").rglob("*.mo")):
        text = path.read_text(encoding="utf-8")
        assert "Documentation(info" in text, path
        inherits = "extends Interfaces." in text or "extends OneDof" in text or "extends HalfQuad" in text
        assert "Icon(" in text or inherits, path


@pytest.mark.parametrize(
    ("unit", "factor", "exponents"),
    [
        ("V", 1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("Ohm/A2", 1.0, {"kg": 1, "m": 2, "s": -3, "A": -4}),
        ("N.m.s/rad", 1.0, {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("N.s2/(m.rad)", 1.0, {"kg": 1, "rad": -1}),
        ("1/V", 1.0, {"kg": -1, "m": -2, "s": 3, "A": 1}),
        ("mA", 1e-3, {"A": 1}),
        ("kg.m2", 1.0, {"kg": 1, "m": 2}),
        ("1", 1.0, {}),
    ],
)
def test_base_units(unit, factor, exponents):
    found = base_units(unit)
    assert found is not None
    assert found[0] == pytest.approx(factor)
    assert found[1] == exponents


@pytest.mark.parametrize("unit", ["furlong", "m//s", "", "m^2"])
def test_unknown_units_are_not_guessed(unit):
    assert base_units(unit) is None


@pytest.mark.parametrize(
    ("by_hand", "unit"),
    [
        ("kg*m^2", "kg.m2"), ("N*m*s/rad", "N.m.s/rad"), ("m/s^2", "m/s2"), ("m3/s/V", "m3/(s.V)"), ("Nm/A", "N.m/A"),
        ("1/(K*s)", "1/(K.s)"), ("N s/m", "N.s/m"), ("kg·m**2", "kg.m2"), ("kg.m^-1", "kg.m-1"), ("-", "1"),
        ("(m.s)/(kg)", "(m.s)/(kg)"), ("°C", "degC"), ("%", "%"), ("V^0.5", ""), ("1/sqrt(Hz)", ""), ("m)", ""),
    ],
)  # fmt: skip
def test_units_as_they_are_written_by_hand(by_hand, unit):
    assert to_modelica_unit(by_hand) == unit
    assert to_modelica_unit(unit) == unit


@pytest.mark.parametrize(
    ("unit", "to", "number", "expected"),
    [
        ("degC", "K", 20.0, 293.15), ("K", "degC", 293.15, 20.0), ("degF", "degC", 212.0, 100.0),
        ("min", "s", 2.0, 120.0), ("kPa", "bar", 250.0, 2.5), ("l/min", "m3/s", 60.0, 1e-3), ("deg", "deg", 7.0, 7.0),
        ("rpm", "rad/s", 30.0, np.pi), ("%", "1", 30.0, 0.3), ("g", "m/s2", 2.0, 19.6133), ("g", "kg", 2.0, 2e-3),
        ("mAh", "C", 500.0, 1800.0), ("psi", "bar", 100.0, 6.894757), ("furlong", "furlong", 3.0, 3.0),
    ],
)  # fmt: skip
def test_numbers_go_from_unit_to_unit(unit, to, number, expected):
    found = conversion(unit, to)
    assert found is not None
    assert number * found[0] + found[1] == pytest.approx(expected)
    assert conversion(unit, "V") is None


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("extends B(redeclare final model C = .P.D(k = 1));", "redeclared class 'C' would be dropped"),
        ("replaceable model C = D\n    constrainedby E(k = 2);", "constraining class 'E' would be dropped"),
        ("extends B(x(y = 1), break connect(a, b));", "'break' in the modification of 'B' would be ignored"),
        ("extends B(redeclare model C = D()); // C(k = 1)\n  annotation (x(redeclare model C = D(k = 1)));", ""),
        ('extends B(text = "redeclare model C = D(k = 1)");', ""),
    ],
)  # fmt: skip
def test_what_the_compiler_would_drop_is_refused_with_its_line(body, message, modelica, tmp_path):
    file = modelica(f"model A\n  {body}\nend A;\n")
    if message:
        with pytest.raises(InputError, match=r"A\.mo:[23]: .*" + message):
            refuse_dropped(tmp_path, [file])
    else:
        refuse_dropped(tmp_path, [file])
