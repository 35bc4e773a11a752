"""What keeps other people's model code from harming this machine, and how much of it this machine can do.

Each worker is limited in memory and file size and gives up, for good and before it loads the model, writing anywhere
but in a scratch folder of its own (Landlock), other processes, the network, shared memory and signals to others
(seccomp). A model may read what its user may read; what it reads can go nowhere. Not limited is the number of files in
its scratch folder, and a model that forges its results in the memory it shares with us is believed. Runs in this
process (``workers=0``) are not confined at all.

A model that needs a licence server or a program of its own cannot be run confined: set ``AERO_BAYES_TRUST_FMU=1`` for
one that you trust.
"""

from __future__ import annotations

import ctypes
import os
from dataclasses import dataclass

from aero_bayes.simulation.engine_library import engine_path

FILE_LIMIT = 256 << 20
TRUST = "AERO_BAYES_TRUST_FMU"


@dataclass(frozen=True)
class Confinement:
    """What the kernel offers."""

    landlock: int
    seccomp: bool
    trusted: bool

    def lines(self) -> tuple[str, ...]:
        """Return what a model's code is kept from on this machine, and what not, a line each."""
        if self.trusted:
            return (f"{TRUST} is set: models run with all rights of their user",)
        rows = (
            ("memory, size of a file, core dumps", True, ""),
            ("writing outside its scratch folder", self.landlock > 0, "the kernel has no Landlock"),
            ("network", self.seccomp or self.landlock >= 4, "the kernel has neither seccomp nor Landlock 4"),
            ("processes, signals to others, shared memory", self.seccomp, "the kernel has no seccomp"),
        )
        return tuple(f"{what}: {'kept from' if kept else f'NOT kept from ({why})'}" for what, kept, why in rows)


def available() -> Confinement:
    """Return what this machine can do."""
    engine = ctypes.CDLL(str(engine_path()))
    return Confinement(engine.ab_landlock(), bool(engine.ab_seccomp()), is_trusted())


def is_trusted() -> bool:
    """Return whether the user has switched the confinement off."""
    return os.environ.get(TRUST, "") not in ("", "0")
