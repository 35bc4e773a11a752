"""Reading FMUs: what is there, and one clear line for what is not usable."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from facts import facts
from runs import ran

from aero_bayes.errors import InputError
from aero_bayes.simulation import archive as archive_module
from aero_bayes.simulation.interface import Experiment, InputSignal, Problem
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator

pytestmark = pytest.mark.fast

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


UNTRUE = [
    ((b'derivative="1"', b'derivative="0"'), r"'der\(x\)' .*\b0 of 10"),
    ((b'derivative="1"', b'derivative="-1"'), r"'der\(x\)' .*-1 of 10"),
    ((b'derivative="1"', b'derivative="11"'), r"'der\(x\)' .*\b11 of 10"),
    ((b'derivative="1"', b'derivative="2"'), r"'der\(x\)' .*'der\(x\)'"),
    ((b'<Derivatives><Unknown index="2"', b'<Derivatives><Unknown index="0"'), "variable 0 of 10"),
    ((b'valueReference="3"', b'valueReference="-3"'), "-3 of 'a'"),
    ((b'valueReference="3"', b'valueReference="4294967296"'), "4294967296 of 'a'"),
    ((b'name="a"', b'name="b"'), "name 'b'"),
]


@pytest.mark.parametrize(("edit", "message"), [*UNTRUE, (None, "2 .* maximum 1")])
@pytest.mark.parametrize("version", [2, 3])
def test_what_cannot_be_true_is_named(test_fmu, tmp_path, edit, message, version):
    source = test_fmu("Dahlquist", defines=("FMI3",) if version == 3 else ()).path
    tag = b"<Real " if version == 2 else b'<Float64 name="a" '
    old, new = edit or (tag, tag + b'min="2" max="1" ')
    if version == 3 and b"erivative" in old:
        old, new = b'derivative="0"', b'derivative="1"' if new[-2:] == b'2"' else b'derivative="77"'
        message = message if b"1" in new else r"contradicts FMI 3\.0: .*der\(x\)"
    path = rewrite(source, tmp_path / "untrue.fmu", replaced(old, new))
    with pytest.raises(InputError, match=message) as caught:
        Model.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"<ModelVariables>", b'<ModelVariables><Clock name="tick" valueReference="90" causality="input"/>', "clock"),
        (
            b'variability="continuous" initial="exact" start="1.0"/>',
            b'start="1 1"><Dimension start="2"/></Float64>',
            "array",
        ),
        (b'<ContinuousStateDerivative valueReference="1"', b'<ContinuousStateDerivative valueReference="77"', "contra"),
        (b"ModelExchange", b"ScheduledExecution", "neither"),
    ],
)
def test_what_is_refused_of_fmi_3(test_fmu, tmp_path, old, new, message):
    path = rewrite(test_fmu("Dahlquist", defines=("FMI3",)).path, tmp_path / "bad.fmu", replaced(old, new))
    with pytest.raises(InputError, match=message):
        Model.load(path)


def edited_binary(edit: Callable[[bytes], bytes]) -> Edit:
    def change(members: dict[str, bytes]) -> None:
        name = next(name for name in members if name.endswith(".so"))
        members[name] = edit(members[name])

    return change


@pytest.mark.parametrize(
    "binary", [b"", b"MZ no library for Linux", b"\x7fELF\x01\x01" + bytes(10) + b"\x03\x00\x03\x00"]
)
def test_a_binary_that_is_no_library_is_named(test_fmu, tmp_path, binary):
    path = rewrite(test_fmu("Dahlquist").path, tmp_path / "bad.fmu", edited_binary(lambda _: binary))
    with pytest.raises(InputError, match=r"Dahlquist_dd\.so .*no shared library"):
        Model.load(path)


@pytest.mark.parametrize(("steps", "where"), [(False, "pool"), (True, "pool"), (False, "here")])
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"\0libm.so.6\0", b"\0libq.so.3\0", r"libq\.so\.3"),
        (b"\0fmi2SetReal\0", b"\0fmi2SetRule\0", "cannot be loaded: .*(lacks|fmi2SetReal)"),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_library_that_is_missing_is_named(test_fmu, request, tmp_path, steps, where, old, new, message):
    source = test_fmu("Dahlquist", defines=("STEPS",) if steps else ()).path
    path = rewrite(source, tmp_path / "needs.fmu", edited_binary(lambda data: data.replace(old, new)))
    problem = Problem(Model.load(path), (Experiment(np.array([0.0, 1.0]), ("x",)),), ((),))
    with pytest.raises(InputError, match=message) as caught:
        ran(problem, request.getfixturevalue(where))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_discrete_input_does_not_move_linearly(test_fmu, tmp_path):
    edit = replaced(b'causality="input" variability="continuous"', b'causality="input" variability="discrete"')
    model = Model.load(rewrite(test_fmu("Dahlquist").path, tmp_path / "discrete.fmu", edit))
    moving = InputSignal("u", np.array([0.0, 1.0]), np.array([0.0, 1.0]), "linear")
    problem = Problem(model, (Experiment(np.array([0.0, 1.0]), ("x",), (moving,)),), ((),))
    with pytest.raises(InputError, match=facts("u", "discrete")):
        NativeSimulator(problem, workers=0)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_member_that_is_there_twice(test_fmu, tmp_path):
    source = test_fmu("Dahlquist").path
    for name, data in (("same", b"42.5"), ("other", b"42.6")):
        path = tmp_path / f"{name}.fmu"
        path.write_bytes(source.read_bytes())
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("resources/y.txt", data)
    assert Model.load(tmp_path / "same.fmu").unpack(tmp_path).is_file()
    with pytest.raises(InputError, match=r"'resources/y\.txt'.* twice"):
        Model.load(tmp_path / "other.fmu")


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
    monkeypatch.setattr(archive_module, "MAX_UNPACKED_BYTES", 1 << 20)
    with pytest.raises(InputError, match="MiB"):
        Model.load(path)


def test_names_that_are_not_there_list_those_that_are(test_fmu):
    with pytest.raises(InputError, match="mu"):
        test_fmu("VanDerPol").parameter("nu")
    assert test_fmu("VanDerPol").state_index("x1") == 1


def test_a_model_can_be_a_key(test_fmu):
    assert {Model.load(test_fmu("VanDerPol").path)} == {test_fmu("VanDerPol")}
