"""The input signal of a proposed experiment, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.files import whole_file

#: Families whose name is not what one calls their signals.
SIGNAL_PHRASES = {
    "binary": "a binary sequence", "square wave": "a square wave", "step and release": "a step and its release",
    "multi-sine": "a sum of sines", "chirp": "a chirp",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class ProposedInput:
    """An input by name; ``time`` (n,) in s and ``values`` (n,) in its unit, each held; the ``family`` it is of."""

    input: str
    time: FloatArray
    values: FloatArray
    family: str

    def table(self) -> tuple[FloatArray, FloatArray]:
        """Return times (k,) and values (k,) at which the input changes."""
        changes = np.flatnonzero(np.diff(self.values, prepend=np.nan) != 0.0)
        return self.time[changes], self.values[changes]

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(self.time[-1] - self.time[0])

    @property
    def in_words(self) -> str:
        """Length and kind of the signal."""
        return f"{self.duration:g} s of {SIGNAL_PHRASES.get(self.family, self.family)}"

    def write_csv(self, path: Path | str) -> Path:
        """Write ``time`` and the input at every sample, as a recording has them; whole or not at all."""
        path = Path(path)
        rows = [f"time,{self.input}"] + [f"{t:.9g},{v:.6g}" for t, v in zip(self.time, self.values, strict=True)]
        with whole_file(path) as temporary:
            temporary.write_text("\n".join(rows) + "\n", encoding="utf-8")
        return path
