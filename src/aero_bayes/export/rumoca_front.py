"""Modelica source -> flat Modelica text, by rumoca."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from aero_bayes.errors import InputError


def flatten(model: str, root: Path, files: Sequence[Path]) -> str:
    """Flatten ``model``; ``files`` lie below ``root`` and nothing else does.

    Raises
    ------
    InputError
        One line that says what rumoca found wrong, or which construct cannot be exported.
    """
    try:
        import rumoca
    except ImportError:
        raise InputError("the embedded exporter needs rumoca: pip install 'aero-bayes[export]'") from None
    session = rumoca.Session(roots=[str(root)])
    try:
        return str(session.load(str(_file_of(model, files)), model=model).render("dae-modelica"))
    except Exception as error:
        raise InputError(f"{model}: {_one_line(str(error), root)}") from None


def _file_of(model: str, files: Sequence[Path]) -> Path:
    first = model.split(".")[0]
    for file in files:
        name = file.parent.name if file.name == "package.mo" else file.stem
        if name == first:
            return file
    return files[-1]


def _one_line(text: str, root: Path) -> str:
    lines = [line.strip() for line in text.replace(str(root) + "/", "").splitlines() if line.strip()]
    line = lines[0] if lines else "unknown error"
    line = re.sub(r"^Target rendering error: ", "", line)
    return line
