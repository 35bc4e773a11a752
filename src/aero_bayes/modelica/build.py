"""C source -> shared library -> FMU archive, the same bytes for the same source."""

from __future__ import annotations

import errno
import importlib.metadata
import importlib.util
import os
import platform
import shlex
import shutil
import struct
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.files import ScratchFolder, make_once, whole_file

PlatformName = Literal["linux64", "win64", "aarch64-linux", "darwin64"]
_ELF = ("-fPIC", "-shared", "-s", "-Wl,--build-id=none")


@dataclass(frozen=True)
class Platform:
    """One kind of machine."""

    name: PlatformName
    folders: Mapping[int, str]
    suffix: str
    targets: tuple[str, ...]
    flags: tuple[str, ...]


# The oldest C library of Linux that is still supported somewhere; macOS 11 is the first on both processors.
PLATFORMS: Mapping[str, Platform] = {
    p.name: p
    for p in (
        Platform("linux64", {2: "linux64", 3: "x86_64-linux"}, ".so", ("x86_64-linux-gnu.2.17",), _ELF),
        Platform("win64", {2: "win64", 3: "x86_64-windows"}, ".dll", ("x86_64-windows-gnu",), ("-shared", "-s")),
        Platform(
            "aarch64-linux", {2: "aarch64-linux", 3: "aarch64-linux"}, ".so", ("aarch64-linux-gnu.2.17",), _ELF
        ),
        Platform(
            "darwin64", {2: "darwin64", 3: "x86_64-darwin"}, ".dylib", ("x86_64-macos.11.0", "aarch64-macos.11.0"),
            ("-fPIC", "-dynamiclib"),
        ),
    )
}  # fmt: skip
#: Processor numbers of Mach-O by Zig's name, with its variant.
_MACH_O = {"x86_64": (0x01000007, 3), "aarch64": (0x0100000C, 0)}
#: Alignment of the parts of a library for several processors, as a power of two.
_MACH_O_ALIGN = 14


def this_machine() -> Platform:
    """Return the machine that this runs on; one of another kind is taken for Linux on x86-64."""
    if sys.platform == "win32":
        return PLATFORMS["win64"]
    if sys.platform == "darwin":
        return PLATFORMS["darwin64"]
    return PLATFORMS["aarch64-linux" if platform.machine() in ("aarch64", "arm64") else "linux64"]


def platforms_called(names: str | Sequence[str]) -> tuple[Platform, ...]:
    """Platforms by their names: ``all``, one, or several with commas between them; this machine's by default."""
    given = [n.strip() for n in names.split(",")] if isinstance(names, str) else list(names)
    given = [name for name in given if name]
    if given == ["all"]:
        given = list(PLATFORMS)
    for name in given:
        if name not in PLATFORMS:
            raise InputError(f"platform {name!r}: expected all or some of {', '.join(PLATFORMS)}")
    found = tuple(PLATFORMS[name] for name in dict.fromkeys(given)) or (this_machine(),)
    if any(p is not this_machine() for p in found) and importlib.util.find_spec("ziglang") is None:
        raise InputError("building for other machines needs the compiler of Zig: pip install 'aero-bayes[platforms]'")
    return found


def zig_compiler(target: str) -> list[str]:
    """Return the command that compiles C for a machine."""
    return [sys.executable, "-m", "ziglang", "cc", "-target", target]


def one_file(libraries: Mapping[str, bytes]) -> bytes:
    """Return a library for several processors of macOS, by Zig's name of each; a single one is returned as it is.

    The form is Apple's ``fat_header``: numbers with the highest byte first, then each library at an aligned place."""
    if len(libraries) == 1:
        return next(iter(libraries.values()))
    head = struct.pack(">II", 0xCAFEBABE, len(libraries))
    body, place = b"", 1 << _MACH_O_ALIGN
    for target, library in libraries.items():
        processor, variant = _MACH_O[target.partition("-")[0]]
        start = place + len(body)
        head += struct.pack(">IIIII", processor, variant, start, len(library), _MACH_O_ALIGN)
        body += library + bytes(-len(library) % (1 << _MACH_O_ALIGN))
    return head.ljust(place, b"\0") + body


_FLAGS = ("-std=gnu11", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math")
_LINK = ("-shared", "-Wl,--build-id=none", "-s")

_NATIVE = Path(__file__).parent / "native"
#: Files of the engine that the runtime has too: its co-simulation takes the same steps.
_SHARED = tuple(
    Path(__file__).parents[1] / "simulation" / "native" / name for name in ("exponential.c", "exponential.h", "phi.c")
)


def c_compiler() -> list[str]:
    """Return the command of a C compiler: ``$CC``, ``cc``, or the one in the ziglang wheel."""
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
    """Folder of the FMI headers that FMPy carries."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise InputError("building an FMU needs FMPy for the FMI headers: pip install fmpy")
    return Path(spec.origin).parent / "c-code"


def _compile_library(source: str, identifier: str) -> bytes:
    """Compile a generated model and link it to the runtime."""
    command = c_compiler()
    flags = [*_FLAGS, "-O2", *_LINK, "-Wl,--version-script=names.map", f"-I{_NATIVE}"]
    shown = "{ global: fmi2*; ab_columns; ab_eventless; ab_linear; ab_linear_held; local: *; };\n"
    name = f"{identifier}.c"
    sources = {"names.map": shown.encode(), "runtime.o": _runtime(command), name: source.encode()}
    arguments = ["-fPIC", *flags, "-o", f"{identifier}.so", name, "runtime.o", "-lm"]
    return _compiled(command, arguments, sources, f"{identifier}.so", _stamp(command, flags))


def compile_binaries(source: str, identifier: str, platforms: Sequence[Platform]) -> dict[str, bytes]:
    """Binaries of a generated model, by their place in the archive: this machine's by its compiler, others by Zig."""
    members = {}
    for one in platforms:
        if one is this_machine():
            library = _compile_library(source, identifier)
        else:
            library = one_file({target: _cross_compile(source, identifier, one, target) for target in one.targets})
        members[f"binaries/{one.folders[2]}/{identifier}{one.suffix}"] = library
    return members


def _cross_compile(source: str, identifier: str, platform: Platform, target: str) -> bytes:
    """Return the library for another machine."""
    command = zig_compiler(target)
    flags = [*_FLAGS, "-O2", *platform.flags, "-I.", "-o", "made", f"{identifier}.c", "fmi2.c", "-lm"]
    stamp = f"{importlib.metadata.version('ziglang')}{command[1:]}{flags}".encode()
    return _compiled(command, flags, source_files(source, identifier), "made", stamp)


def source_files(source: str, identifier: str) -> dict[str, bytes]:
    """Return all C source of an FMU by file: the model, the runtime, and the headers of FMI."""
    runtime = {path.name: path.read_bytes() for path in (*sorted(_NATIVE.iterdir()), *_SHARED)}
    headers = {path.name: path.read_bytes() for path in sorted(fmi_headers().glob("fmi2*.h"))}
    return {**runtime, **headers, f"{identifier}.c": source.encode()}


def _runtime(command: Sequence[str]) -> bytes:
    """Return the compiled runtime of generated models."""
    # Half the compiling of -O2, and no slower in the engine's runs: the equations are the model's own file.
    flags = [f"-I{fmi_headers()}", "-O1", "-finline-small-functions", "-c", "fmi2.c"]
    return compile_kept([*sorted(_NATIVE.iterdir()), *_SHARED], flags, "runtime.o", command)


def compile_kept(
    sources: Sequence[Path],
    flags: Sequence[str],
    product: str,
    command: Sequence[str] = (),
    *,
    objects: Mapping[str, bytes] | None = None,
) -> bytes:
    """Compile sources of this package once a user: kept under a name that tells compiler, flags and sources.

    ``objects`` are compiled already."""
    command = command or c_compiler()
    arguments = ["-fPIC", *_FLAGS, "-O2", f"-I{_NATIVE}", "-o", product, *flags]
    texts = {path.name: path.read_bytes() for path in sources}
    return _compiled(command, arguments, texts | dict(objects or {}), product, _stamp(command, flags))


def _compiled(
    command: Sequence[str], arguments: Sequence[str], sources: Mapping[str, bytes], product: str, stamp: bytes
) -> bytes:
    """Compile sources, or read what was compiled from the same ones before from the user's cache."""

    def compile_it() -> bytes:
        with ScratchFolder() as folder:
            for name, text in sources.items():
                (folder / name).write_bytes(text)
            _compile([*command, *arguments], folder)
            return (folder / product).read_bytes()

    return make_once(product, (stamp, *sources.values()), compile_it)


def _stamp(command: Sequence[str], flags: Sequence[str]) -> bytes:
    """Return which compiler is called, and how; an update of it changes the time of its program."""
    program = Path(shutil.which(command[0]) or command[0]).resolve()
    return f"{command}{program}{program.stat().st_mtime_ns if program.exists() else ''}{_FLAGS}{flags}".encode()


def _compile(command: Sequence[str], folder: Path) -> None:
    plain = os.environ | {"LC_ALL": "C"}
    done = subprocess.run(command, cwd=folder, env=plain, capture_output=True, text=True, check=False)
    full = os.strerror(errno.ENOSPC)
    if done.returncode != 0 and full in done.stderr:
        raise CannotFinishError(f"{folder}: {full}")
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines() or ["?"]
        raise InputError(f"the C compiler {command[0]!r} failed on the generated source: {lines[0]}")


def write_archive(out: Path, members: Mapping[str, bytes], *, packed: bool = True) -> None:
    """Write a zip with fixed times and order; ``out`` appears whole or not at all."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name in sorted(members, key=lambda n: (n != "modelDescription.xml", n)):
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED
            info.create_system = 3
            info.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
            archive.writestr(info, members[name])
