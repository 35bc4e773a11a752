"""C source -> shared library -> FMU archive, the same bytes for the same source."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.files import whole_file
from aero_bayes.scratch import ScratchFolder

_FLAGS = (
    "-std=gnu11", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math",
    "-Wl,--build-id=none", "-s",
)  # fmt: skip


def c_compiler() -> list[str]:
    """The command of a C compiler: ``$CC``, ``cc``, or the one in the ziglang wheel.

    Raises
    ------
    InputError
        Where there is none; says what to install.
    """
    named = os.environ.get("CC", "").strip()
    if named:
        command = shlex.split(named)
        if shutil.which(command[0]) is None:
            raise InputError(f"the C compiler named by CC, {command[0]!r}, was not found")
        return command
    for name in ("cc", "gcc", "clang"):
        if shutil.which(name) is not None:
            return [name]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise InputError("no C compiler found: install one (Debian: apt install gcc) or the wheel (pip install ziglang)")


def fmi_headers() -> Path:
    """Folder of the FMI 2.0 headers that FMPy carries."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise InputError("building an FMU needs FMPy for the FMI headers: pip install fmpy")
    return Path(spec.origin).parent / "c-code"


def compile_library(source: str, identifier: str) -> bytes:
    """Compile one translation unit to a shared library, in a folder of its own."""
    command = c_compiler()
    with ScratchFolder() as folder:
        name = f"{identifier}.c"
        (folder / name).write_text(source, encoding="utf-8")
        done = subprocess.run(
            [*command, *_FLAGS, f"-I{fmi_headers()}", "-o", f"{identifier}.so", name, "-lm"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines() or ["?"]
            raise InputError(f"the C compiler {command[0]!r} failed on the generated source: {lines[0]}")
        return (folder / f"{identifier}.so").read_bytes()


def write_archive(out: Path, members: Mapping[str, bytes]) -> None:
    """Write a zip with fixed times and order; ``out`` appears whole or not at all."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(out) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in sorted(members, key=lambda n: (n != "modelDescription.xml", n)):
                info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                info.compress_type = zipfile.ZIP_DEFLATED
                info.create_system = 3
                info.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
                archive.writestr(info, members[name])
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from None
