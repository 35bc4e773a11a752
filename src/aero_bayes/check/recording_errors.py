"""The error of a model on each recording, fitted or not, judged by that recording's own noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.check.residual_tests import portmanteau_test
from aero_bayes.data import Recording
from aero_bayes.sensors import OutputNoise, autocorrelation, innovations, is_rotor_speed, ripple_means
from aero_bayes.sensors.whiteness import FALSE_ALARM_RATE

Verdict = Literal["noise", "structured", "too large"]
#: Error over noise above which it is too large: then more than two fifths of its square are no noise.
MAX_RATIO = 1.3
#: Least autocorrelation, at any of the lags that are tested, of a residual with structure: with many readings a
#: dependence that nobody would see in a plot fails the test, too.
MIN_CORRELATION, LAGS = 0.1, 20
#: Fewest readings that are judged.
MIN_READINGS = 16

Role = Literal["train", "test"]
Fitted = Mapping[tuple[str, str], FloatArray]
#: A recording, its role, and from when and until when (s) it counts.
JudgedPart = tuple[Recording, Role, float | None, float | None]


@dataclass(frozen=True)
class RecordingError:
    """Error of one output in one recording (RMS, SI) before and after; ``begin`` is where a part of it begins, in s.

    ``noise`` is that of this recording, or, where it cannot be told from the readings, that of the fit
    (``noise_known`` is false). ``verdict`` and ``p_value`` (of a white residual) are of the model that came out."""

    recording: str
    role: Role
    output: str
    before: float | None
    after: float
    noise: float
    noise_known: bool
    p_value: float
    verdict: Verdict
    begin: float | None = None

    @property
    def ratio(self) -> float:
        return self.after / self.noise if self.noise > 0.0 else math.inf

    def to_dict(self) -> dict[str, object]:
        """Return it as ``errors`` in result.json holds it."""
        return {**asdict(self), "ratio": self.ratio}


def recording_errors(
    recordings: Sequence[JudgedPart],
    before: Fitted | None,
    after: Fitted,
    floors: Mapping[tuple[str, str], float],
    noise: Mapping[str, OutputNoise],
) -> tuple[RecordingError, ...]:
    """Judge models by each recording, or part of one.

    ``before`` and ``after`` hold the outputs of the models on all samples, by recording and output, ``floors`` the
    noise that is known."""
    found = []
    for recording, role, begin, end in recordings:
        within = (recording.time >= (-math.inf if begin is None else begin)) & (
            recording.time < (math.inf if end is None else end)
        )
        for output, fitted in ((o, y) for (name, o), y in after.items() if name == recording.name):
            residual = np.where(within, recording.outputs[output] - fitted, np.nan)
            if np.isfinite(residual).sum() < MIN_READINGS:
                continue
            before_it = None if before is None else before[recording.name, output]
            was = None if before_it is None else _rms(np.where(within, recording.outputs[output] - before_it, np.nan))
            floor = floors.get((recording.name, output))
            size = noise[output].sd if floor is None else floor
            p_value, structured = _whiteness(recording, output, residual, noise[output])
            rms = _rms(residual)
            verdict: Verdict = "too large" if rms > MAX_RATIO * size else "structured" if structured else "noise"
            found.append(
                RecordingError(recording.name, role, output, was, rms, size, floor is not None, p_value, verdict, begin)
            )
    return tuple(found)


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _whiteness(recording: Recording, output: str, residual: FloatArray, noise: OutputNoise) -> tuple[float, bool]:
    """Return the p-value of a white residual, and whether its correlation can be seen as well."""
    white = innovations(recording.time, residual, noise)
    white = white[np.isfinite(white)]
    if is_rotor_speed(recording.outputs[output], recording.units.get(output, "")):
        white = ripple_means(white, float(np.median(np.diff(recording.time))))
    p_value = portmanteau_test(white, LAGS).p_value
    seen = float(np.abs(autocorrelation(white, LAGS)[1:]).max(initial=0.0))
    return p_value, p_value < FALSE_ALARM_RATE and seen > MIN_CORRELATION
