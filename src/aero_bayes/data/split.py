"""Which part of the recordings is fitted, and which is kept to judge a model by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.data.recording import Recording
from aero_bayes.errors import InputError


@dataclass(frozen=True, eq=False)
class Recordings:
    """The recordings, and which part of them is fitted.

    ``fitted`` are the training recordings; without test recordings only their first parts. ``unseen_from`` is then the
    time (s), by name, from which readings count as unseen."""

    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    fitted: tuple[Recording, ...]
    unseen_from: Mapping[str, float]
    outputs: tuple[str, ...]

    @classmethod
    def of(
        cls, train: Sequence[Recording], test: Sequence[Recording], held_out: float, known: Sequence[str]
    ) -> Recordings:
        """Check the recordings, and hold out the share ``held_out`` of each training one if there is no other test.

        ``known`` are the outputs of the model."""
        outputs = tuple(o for o in known if any(o in r.outputs for r in train))
        if not outputs:
            raise InputError(f"none of the outputs {', '.join(known)} was recorded")
        names = [r.name for r in train]
        if len(set(names)) < len(names):
            raise InputError("two training recordings have the same name")
        if test:
            return cls(tuple(train), tuple(test), tuple(train), {}, outputs)
        unseen_from: dict[str, float] = {}
        parts = []
        for recording in train:
            cut = _cut(recording, outputs, held_out)
            unseen_from[recording.name] = cut
            parts.append(replace(recording.without(after=cut), name=recording.name))
        return cls(tuple(train), (), tuple(parts), unseen_from, outputs)


def _cut(recording: Recording, outputs: Sequence[str], held_out: float) -> float:
    """Return the time in s from which readings are held out, so that each output has readings before it.

    A sensor that was mounted late has them in its last part only."""
    ends = [
        recording.time[np.isfinite(recording.outputs[o])][[0, -1]]
        for o in outputs
        if o in recording.outputs and np.isfinite(recording.outputs[o]).any()
    ] or [recording.time[[0, -1]]]
    return max(float(first + (1.0 - held_out) * (last - first)) for first, last in ends)
