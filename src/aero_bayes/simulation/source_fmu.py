"""FMUs without a binary for this machine: their C source is compiled, once a user, by CMake as FMPy sets it up."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Collection
from pathlib import Path, PurePosixPath

from aero_bayes.build_cache import user_cache
from aero_bayes.errors import InputError
from aero_bayes.export.build import write_archive
from aero_bayes.export.platforms import this_machine
from aero_bayes.files import ScratchFolder
from aero_bayes.simulation import archive
from aero_bayes.simulation.model_description import BINARY_FOLDERS, ModelDescription

#: Seconds that a compilation may take.
BUILD_TIME_LIMIT = 600.0


def built_from_source(path: Path, model: ModelDescription, names: Collection[str]) -> Path:
    """Return the FMU with a binary for this machine, compiled from the source inside it."""
    here = this_machine()
    binary = f"{BINARY_FOLDERS[model.fmi_version]}/{model.identifier}{here.suffix}"
    have = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
    there = ", ".join(have) or "no machine"
    if not any(n.startswith("sources/") and n.endswith((".c", ".cpp", ".xml")) for n in names):
        raise InputError(
            f"{path}: has no {binary}, binaries for {there} only and no source: export it with a "
            f"binary for {here.name}, or with its source code"
        )
    kept = user_cache() / "made" / f"{path.stem}-{model.sha256[:32]}-{here.name}.fmu"
    if kept.exists():
        return kept
    if shutil.which("cmake") is None:
        raise InputError(f"{path}: has binaries for {there} only; to compile its source: pip install cmake")
    with ScratchFolder() as folder:
        unpacked, build = folder / "fmu", folder / "build"
        unpacked.mkdir()
        build.mkdir()
        archive.extract(path, unpacked)
        _compile(path, unpacked, build)
        if not (unpacked / binary).is_file():
            raise InputError(f"{path}: its source was compiled, but to something else than {binary}")
        files = (file for file in sorted(unpacked.rglob("*")) if file.is_file())
        write_archive(kept, {file.relative_to(unpacked).as_posix(): file.read_bytes() for file in files})
    return kept


def _compile(path: Path, unpacked: Path, build: Path) -> None:
    import fmpy

    try:
        from fmpy.build import create_cmake_settings

        create_cmake_settings(unzipdir=unpacked, build_dir=build)
    except Exception as error:
        reason = f"{error}".partition("\n")[0]
        raise InputError(f"{path}: its source says not how it is compiled: {reason}") from None
    scripts = Path(fmpy.__file__).parent / "c-code"
    for command in (["-S", str(scripts), "-B", str(build)], ["--build", str(build), "--target", "install"]):
        done = subprocess.run(
            ["cmake", *command], capture_output=True, text=True, check=False, timeout=BUILD_TIME_LIMIT
        )
        if done.returncode != 0:
            lines = f"{done.stdout}\n{done.stderr}".splitlines()
            shown = next((line for line in lines if "error" in line.lower()), lines[-1] if lines else "?")
            raise InputError(f"{path}: its source does not compile: {shown.strip()[:200]}")
