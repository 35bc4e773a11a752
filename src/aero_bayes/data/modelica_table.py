"""Text files of Modelica's tables, as ``CombiTimeTable`` reads them: ``#1``, then ``double tab(n,m)`` and n rows.

A matrix ``tab`` of m columns becomes ``tab(1)`` ... ``tab(m)``; the first is the time. Where a time is there twice, the
table jumps, and the later row holds.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.source import Source
from aero_bayes.errors import InputError

MATRIX = re.compile(r"\s*(?:double|float)\s+(\w+)\s*\(\s*(\d+)\s*,\s*(\d+)\s*\)\s*(?:#.*)?")
#: What ends a comment in a line, and what separates numbers.
COMMENT, SEPARATORS = re.compile(r"(#|//|/\*).*"), re.compile(r"[\s,;]+")


def is_one(path: Path) -> bool:
    """Return whether a file begins as such a table."""
    with path.open("rb") as file:
        return bool(re.fullmatch(rb"(?:\xef\xbb\xbf)?#1\s*", file.readline(64)))


def source_of(path: Path, memory: int | None = None) -> Source:
    """Return all columns; InputError for a matrix that has not the size that it states."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    vectors: dict[str, FloatArray] = {}
    clocks: dict[str, str] = {}
    row = 1
    while row < len(lines):
        start = MATRIX.fullmatch(lines[row])
        row += 1
        if start is None:
            continue
        name, rows, columns = start[1], int(start[2]), int(start[3])
        where = f"{path}, row {row}: matrix {name} of {rows} rows and {columns} columns"
        words: list[str] = []
        while len(words) < rows * columns and row < len(lines) and not MATRIX.fullmatch(lines[row]):
            words += [word for word in SEPARATORS.split(COMMENT.sub("", lines[row])) if word]
            row += 1
        try:
            numbers = np.array([float(word) for word in words]).reshape(rows, columns)
        except ValueError:
            raise InputError(
                f"{where}: found {len(words)} numbers and words, expected {rows * columns} numbers"
            ) from None
        last = np.append(np.diff(numbers[:, 0]) != 0.0, True)
        called = [f"{name}({k + 1})" for k in range(columns)]
        vectors |= dict(zip(called, np.ascontiguousarray(numbers[last].T), strict=True))
        clocks |= dict.fromkeys(called[1:], called[0])
    if not vectors:
        raise InputError(f"{path}: begins as a table of Modelica (#1) but has no matrix such as double tab(10,3)")
    return Source.of_vectors(path, vectors, clocks)
