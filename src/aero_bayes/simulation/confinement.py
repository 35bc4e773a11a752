"""What keeps other people's model code from harming this machine.

Each worker is limited in memory and file size and gives up, for good and before it loads the model, writing anywhere
but in a scratch folder of its own (Landlock), other processes, the network, shared memory and signals to others
(seccomp). A model may read what its user may read; what it reads can go nowhere. Not limited is the number of files in
its scratch folder, and a model that forges its results in the memory it shares with us is believed. Runs in this
process (``workers=0``) are not confined at all.

A model that needs a licence server or a program of its own cannot be run confined: set ``AERO_BAYES_TRUST_FMU=1`` for
one that you trust.
"""

from __future__ import annotations

import os

FILE_LIMIT = 256 << 20
TRUST = "AERO_BAYES_TRUST_FMU"


def is_trusted() -> bool:
    """Return whether the user has switched the confinement off."""
    return os.environ.get(TRUST, "") not in ("", "0")
