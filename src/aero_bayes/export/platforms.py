"""The machines that an FMU can carry binaries for, and how each is compiled: here, or by the compiler of Zig."""

from __future__ import annotations

import importlib.util
import platform
import struct
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from aero_bayes.errors import InputError

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
