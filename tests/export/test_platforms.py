"""FMUs for other machines: their binaries give the same numbers where they can be run, and their source builds."""

from __future__ import annotations

import importlib.util
import os
import shutil
import struct
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from aero_bayes import InputError, export_fmu
from aero_bayes.estimate.fittable import no_parameter_text
from aero_bayes.modelica.build import (
    PLATFORMS,
    c_compiler,
    fmi_headers,
    one_file,
    platforms_called,
    this_machine,
    zig_compiler,
)
from aero_bayes.simulation.model import Model

#: Where Debian's cross libraries of ARM are, and Wine, which is not on the path.
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")
WINE = shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine")
#: What takes longer than a test may: a compiler for each machine builds its C library first.
BY_TARGET = pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="run by make test-platforms")
BALL = """model Ball
  Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
  input Real push;
  output Real y = h;
equation
  der(h) = v;
  der(v) = push - 9.81;
  when h <= 0 then
    reinit(v, -0.8 * pre(v));
  end when;
end Ball;
"""
CART = Path(__file__).parents[2] / "examples" / "cart" / "Rig.mo"
NAMES = {"aero": "Aero.Systems.OneDof", "cart": "Rig", "ball": "Ball"}


@pytest.fixture(scope="session")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ball") / "Ball.mo"
    path.write_text(BALL)
    return path


def trajectory(fmu: Path, platform: str, folder: Path) -> np.ndarray:
    """Outputs of 200 steps of 10 ms, by a loader that is compiled for the platform."""
    folder.mkdir()
    model, one = Model.load(fmu), PLATFORMS[platform]
    with zipfile.ZipFile(fmu) as archive:
        library = folder / f"model{one.suffix}"
        library.write_bytes(archive.read(f"binaries/{one.folders[2]}/{model.identifier}{one.suffix}"))
    program = folder / "step.exe"
    compiler = c_compiler() if one is this_machine() else zig_compiler(one.targets[0])
    source = Path(__file__).parent / "step_fmu.c"
    subprocess.run([*compiler, "-O1", f"-I{fmi_headers()}", source, "-o", program, "-lm"], check=True)
    before = {"win64": [WINE], "aarch64-linux": ["qemu-aarch64", "-L", str(ARM_LIBRARIES)]}.get(platform, [])
    inputs, outputs = ([str(v.value_reference) for v in group] for group in (model.inputs, model.outputs))
    done = subprocess.run(
        [*before, program, library, model.guid, "200", "0.01", str(len(inputs)), *inputs, str(len(outputs)), *outputs],
        capture_output=True, text=True, check=False, timeout=300, env=os.environ | {"WINEDEBUG": "-all"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return np.array([[float(cell) for cell in line.split()] for line in done.stdout.splitlines()])


@BY_TARGET
@pytest.mark.parametrize("platform", ["win64", "aarch64-linux"])
@pytest.mark.parametrize("model", NAMES)
def test_another_machine_gives_the_same_numbers(model, platform, ball, tmp_path):
    if platform == "win64" and WINE is None:
        pytest.skip("Wine is not installed")
    if platform != "win64" and not (shutil.which("qemu-aarch64") and ARM_LIBRARIES.exists()):
        pytest.skip("qemu-user or the C library of ARM is not installed")
    sources = {"aero": (), "cart": (CART,), "ball": (ball,)}[model]
    fmu = export_fmu(NAMES[model], tmp_path / "m.fmu", sources=sources, platforms=["linux64", platform])
    here, there = (trajectory(fmu, name, tmp_path / name) for name in ("linux64", platform))
    assert here.shape[0] == 200
    assert np.ptp(here, axis=0).max() > 0.01
    np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-9)


def copied(fmu: Path, target: Path, *without: str) -> Path:
    """The archive without members whose names begin so."""
    with zipfile.ZipFile(fmu) as archive, zipfile.ZipFile(target, "w") as copy:
        for name in archive.namelist():
            if not name.startswith(without):
                copy.writestr(name, archive.read(name))
    return target


@BY_TARGET
def test_an_fmu_with_source_only_is_built(ball, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    fmu = export_fmu("Ball", tmp_path / "ball.fmu", sources=ball)
    model = Model.load(copied(fmu, tmp_path / "source.fmu", "binaries/"))
    assert model.path != tmp_path / "source.fmu"
    here = this_machine().name
    before, after = (trajectory(f, here, tmp_path / f.stem[:5]) for f in (fmu, model.path))
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)
    again = time.perf_counter()
    assert Model.load(tmp_path / "source.fmu") == model
    assert time.perf_counter() - again < 1.0


def test_an_fmu_of_another_machine_is_refused_in_one_line(ball, tmp_path):
    fmu = export_fmu("Ball", tmp_path / "ball.fmu", sources=ball)
    foreign = copied(fmu, tmp_path / "win.fmu", "binaries/", "sources/")
    with zipfile.ZipFile(foreign, "a") as archive:
        archive.writestr("binaries/win64/Ball.dll", b"MZ")
    with pytest.raises(InputError, match=rf"win64.*{this_machine().name}.*source") as refused:
        Model.load(foreign)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("causality", "variability", "told"),
    [
        ("calculatedParameter", "fixed", "follows from other"),
        ("local", "fixed", "not final"),
        ("local", "constant", ""),
    ],
)
def test_why_a_name_cannot_be_fitted(causality, variability, told, ball, tmp_path):
    fmu = export_fmu("Ball", tmp_path / "ball.fmu", sources=ball)
    foreign = copied(fmu, tmp_path / "c.fmu", "modelDescription.xml")
    added = (
        f'<ScalarVariable name="tau" valueReference="99" causality="{causality}" variability="{variability}">'
        '<Real start="1"/>'
    ).encode()
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml")
    with zipfile.ZipFile(foreign, "a") as archive:
        end = b"</ModelVariables>"
        archive.writestr("modelDescription.xml", text.replace(end, added + b"</ScalarVariable>" + end))
    model = Model.load(foreign)
    assert all(word in no_parameter_text(model, "tau") for word in (causality, told))
    assert causality != "local" or f"{variability} local" in no_parameter_text(model, "tau")
    assert "no parameter nothing" in no_parameter_text(model, "nothing")


def test_names_of_platforms(monkeypatch):
    assert platforms_called("") == (this_machine(),)
    with pytest.raises(InputError, match=r"win32.*linux64, win64, aarch64-linux, darwin64"):
        platforms_called("linux64, win32")
    monkeypatch.setitem(sys.modules, "ziglang", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'aero-bayes\[platforms\]'"):
        platforms_called("all")


def test_two_processors_share_one_file():
    """The header as Apple's fat.h has it: places and sizes lead to each library, at multiples of 16 KiB."""
    parts = {"x86_64-macos.11.0": b"intel" * 7000, "aarch64-macos.11.0": b"arm" * 9}
    whole = one_file(parts)
    magic, count = struct.unpack(">II", whole[:8])
    assert (magic, count) == (0xCAFEBABE, 2)
    for k, (processor, part) in enumerate(zip((0x01000007, 0x0100000C), parts.values(), strict=True)):
        found, _, start, size, align = struct.unpack(">IIIII", whole[8 + 20 * k : 28 + 20 * k])
        assert (found, align, start % (1 << align)) == (processor, 14, 0)
        assert whole[start : start + size] == part
