"""Where the compiled engine is, and what the loading of a model's binary ends in."""

from __future__ import annotations

import sysconfig
from functools import cache
from pathlib import Path

from aero_bayes.errors import CannotFinishError, InputError


@cache
def engine_path() -> Path:
    """Return the compiled engine; CannotFinishError where the package was installed without it."""
    folder = Path(__file__).parent
    for name in ("_engine.abi3.so", "_engine" + str(sysconfig.get_config_var("EXT_SUFFIX")), "_engine.so"):
        if (folder / name).is_file():
            return folder / name
    raise CannotFinishError(
        "the native engine is not compiled: install a C compiler and reinstall the package, or use --engine fmpy"
    )


class LoadError(InputError):
    """The binary of a model cannot be loaded; the message is the loader's."""
