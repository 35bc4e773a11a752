"""The recordings of a loop, and which part of them is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aero_bayes.data import Recording
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
            cut = float(recording.time[0] + (1.0 - held_out) * recording.duration)
            unseen_from[recording.name] = cut
            parts.append(replace(recording.without(after=cut), name=recording.name))
        return cls(tuple(train), (), tuple(parts), unseen_from, outputs)
