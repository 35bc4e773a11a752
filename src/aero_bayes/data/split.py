"""Three roles of readings: training is fitted, validation confirms, and the test part is only reported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from aero_bayes.data.columns import Mask
from aero_bayes.data.recording import Recording
from aero_bayes.display import join_names
from aero_bayes.errors import InputError

Role = Literal["train", "validation", "test"]
ROLES: tuple[Role, ...] = ("train", "validation", "test")
#: Readings of an output below which a recording is not halved: half of them confirm too little, and test too little.
MIN_HALVED_READINGS = 100


@dataclass(frozen=True, eq=False)
class Part:
    """Readings of one recording in one role: from ``begin`` (s) on and before ``end``; None is where it ends itself."""

    recording: Recording
    role: Role
    begin: float | None = None
    end: float | None = None

    @property
    def within(self) -> Mask:
        """The samples (n,) of the recording that belong to the part."""
        low, high = (-math.inf if self.begin is None else self.begin), (math.inf if self.end is None else self.end)
        return np.asarray((self.recording.time >= low) & (self.recording.time < high))

    @property
    def words(self) -> str:
        """The recording, and what of it is meant."""
        return f"{self.recording.name} {span_words(self.begin, self.end)}".strip()


def span_words(begin: float | None, end: float | None) -> str:
    """Say from when to when, in s; empty for all of a recording."""
    digits = ".0f" if max(begin or 0.0, end or 0.0) >= 1e4 else ".4g"  # a day of seconds without a power of ten
    first = "" if begin is None else f"from {begin:{digits}} s "
    last = "on" if end is None else f"{'to' if first else 'up to'} {end:{digits}} s"
    return "" if begin is None and end is None else first + last


@dataclass(frozen=True, eq=False)
class Recordings:
    """The recordings, which part of them is ``fitted``, and the role of each ``part``.

    ``train``, ``validation`` and ``test`` are whole recordings as they were given."""

    train: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    test: tuple[Recording, ...]
    fitted: tuple[Recording, ...]
    parts: tuple[Part, ...]
    outputs: tuple[str, ...]

    @classmethod
    def of(
        cls, train: Sequence[Recording], test: Sequence[Recording], held_out: float, known: Sequence[str],
        validation: Sequence[Recording] = (),
    ) -> Recordings:  # fmt: skip
        """Check the recordings and give each reading a role; ``known`` are the outputs of the model.

        Without ``validation`` the first half of each test recording validates. Without any of both the last share
        ``held_out`` of each training recording is not fitted, and halved. What is too short to halve validates."""
        outputs = tuple(o for o in known if any(o in r.outputs for r in train))
        if not outputs:
            raise InputError(f"none of the outputs {', '.join(known)} was recorded")
        names = [r.name for r in train]
        if len(set(names)) < len(names):
            raise InputError("two training recordings have the same name")
        test = [replace(r) for r in test]  # a recording may be given twice; its readings have a role in each place
        fitted, parts = [*train], [Part(r, "train") for r in train]
        if validation:
            parts += [*(Part(r, "validation") for r in validation), *(Part(r, "test") for r in test)]
        elif test:
            parts += [part for r in test for part in _halves(r, outputs, None)]
        else:
            cuts = [_cut(r, outputs, held_out) for r in train]
            fitted = [replace(r.without(after=cut), name=r.name) for r, cut in zip(train, cuts, strict=True)]
            parts = [Part(r, "train", None, cut) for r, cut in zip(train, cuts, strict=True)]
            parts += [part for r, cut in zip(train, cuts, strict=True) for part in _halves(r, outputs, cut)]
        return cls(tuple(train), tuple(validation), tuple(test), tuple(fitted), tuple(parts), outputs)

    @property
    def everything(self) -> tuple[Recording, ...]:
        """All recordings whole, training first."""
        return *self.train, *self.validation, *self.test

    def parts_of(self, recording: Recording, *roles: Role) -> tuple[Part, ...]:
        """The parts of a recording that have one of some roles, or all."""
        roles = roles or ROLES
        return tuple(part for part in self.parts if part.recording is recording and part.role in roles)

    @property
    def sentence(self) -> str:
        """What each part of the recordings does."""
        named = {role: join_names([p.words for p in self.parts if p.role == role]) for role in ROLES}
        told = f"Training, which is fitted: {named['train']}. Validation, which confirms: {named['validation']}."
        if any(part.role == "test" for part in self.parts):
            return f"{told} Test, which decides nothing: {named['test']}."
        return f"{told} No readings are left for a test, so the error on validation readings is no test."


def _halves(recording: Recording, outputs: Sequence[str], begin: float | None) -> tuple[Part, ...]:
    """The first half of the readings from a time on for validation, the second for the test, if there are enough."""
    after = recording.time >= (-math.inf if begin is None else begin)
    times = [recording.time[after & np.isfinite(recording.outputs[o])] for o in outputs if o in recording.outputs]
    times = [one for one in times if one.size]
    if not times or min(one.size for one in times) < MIN_HALVED_READINGS:
        return (Part(recording, "validation", begin),)
    middle = float(np.median(np.concatenate(times)))
    return Part(recording, "validation", begin, middle), Part(recording, "test", middle)


def _cut(recording: Recording, outputs: Sequence[str], held_out: float) -> float:
    """Return the time in s from which readings are held out, so that each output has readings before it.

    A sensor that was mounted late has them in its last part only."""
    ends = [
        recording.time[np.isfinite(recording.outputs[o])][[0, -1]]
        for o in outputs
        if o in recording.outputs and np.isfinite(recording.outputs[o]).any()
    ] or [recording.time[[0, -1]]]
    return max(float(first + (1.0 - held_out) * (last - first)) for first, last in ends)
