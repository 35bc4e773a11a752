"""Reading FMUs: what is there, and one clear line for what is not usable."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy import read_model_description

from aero_bayes.errors import InputError
from aero_bayes.simulation import Model
from aero_bayes.simulation import archive as archive_module

Edit = Callable[[dict[str, bytes]], None]


def rewrite(source: Path, target: Path, edit: Edit) -> Path:
    """A copy of an FMU with edited members."""
    with zipfile.ZipFile(source) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    edit(members)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return target


def replaced(old: bytes, new: bytes) -> Edit:
    def edit(members: dict[str, bytes]) -> None:
        assert old in members["modelDescription.xml"]
        members["modelDescription.xml"] = members["modelDescription.xml"].replace(old, new)

    return edit


def without(name: str) -> Edit:
    def edit(members: dict[str, bytes]) -> None:
        for member in [m for m in members if m.startswith(name)]:
            del members[member]

    return edit


def with_member(name: str, data: bytes = b"x") -> Edit:
    def edit(members: dict[str, bytes]) -> None:
        members[name] = data

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (without("modelDescription.xml"), "no modelDescription.xml"),
        (without("binaries"), "binaries/linux64"),
        (replaced(b'fmiVersion="2.0"', b'fmiVersion="4.0"'), "FMI version 4.0"),
        (replaced(b'fmiVersion="2.0"', b'fmiVersion="3.0"'), "contradicts FMI 3.0"),
        (replaced(b'fmiVersion="2.0"', b'fmiVersion="1.0"'), "FMI version 1.0"),
        (replaced(b"<ModelExchange", b"<Simulation"), "neither Model Exchange nor"),
        (replaced(b"</fmiModelDescription>", b""), "not valid XML"),
        (replaced(b"<fmiModelDescription", b"<!DOCTYPE a [<!ENTITY b 'c'>]><fmiModelDescription"), "document type"),
        (replaced(b'<Unknown index="1"/>', b'<Unknown index="99"/>'), "contradicts"),
        (replaced(b'valueReference="0"', b'valueReference="zero"'), "contradicts"),
        (replaced(b'modelIdentifier="', b'modelIdentifier="../'), "not a file name"),
        (with_member("../evil.txt"), "outside"),
        (with_member("/etc/evil.txt"), "outside"),
        (with_member("resources/..\\..\\evil.txt"), "outside"),
    ],
)
def test_unusable_files_are_named(test_fmu, tmp_path, edit, message):
    def derivatives_too(members: dict[str, bytes]) -> None:
        edit(members)
        text = members.get("modelDescription.xml", b"")
        if b"derivative=" not in text or message != "contradicts":
            return
        members["modelDescription.xml"] = text.replace(b'derivative="1"', b'derivative="77"')

    path = rewrite(test_fmu("Dahlquist").path, tmp_path / "bad.fmu", derivatives_too)
    with pytest.raises(InputError, match=message) as caught:
        Model.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_foreign_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Model.load(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("not a zip")
    with pytest.raises(InputError, match="zip"):
        Model.load(tmp_path / "text.fmu")


def test_truncated_file(test_fmu, tmp_path):
    data = test_fmu("Dahlquist").path.read_bytes()
    (tmp_path / "cut.fmu").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="zip"):
        Model.load(tmp_path / "cut.fmu")


def test_zip_bomb(test_fmu, tmp_path, monkeypatch):
    path = rewrite(test_fmu("Dahlquist").path, tmp_path / "bomb.fmu", with_member("resources/big", bytes(4 << 20)))
    monkeypatch.setattr(archive_module, "MOST_UNPACKED_BYTES", 1 << 20)
    with pytest.raises(InputError, match="MiB"):
        Model.load(path)


@pytest.mark.parametrize("name", ["Dahlquist", "BouncingBall", "Stair", "Feedthrough", "Circuit"])
def test_description_agrees_with_fmpy(test_fmu, name):
    model = test_fmu(name)
    other = read_model_description(str(model.path), validate=False)
    assert [(v.name, v.value_reference) for v in model.states] == [
        (d.variable.derivative.name, d.variable.derivative.valueReference) for d in other.derivatives
    ]
    assert [v.name for v in model.outputs] == [v.name for v in other.modelVariables if v.causality == "output"]
    assert [v.name for v in model.parameters] == [v.name for v in other.modelVariables if v.causality == "parameter"]
    assert model.event_indicators == other.numberOfEventIndicators
    assert model.guid == other.guid


def test_names_that_are_not_there_list_those_that_are(test_fmu):
    with pytest.raises(InputError, match="mu"):
        test_fmu("VanDerPol").parameter("nu")
    assert test_fmu("VanDerPol").state_index("x1") == 1
