"""The second witness of a structure: its errors on validation readings, which were not fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import Mask
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.predict_recordings import Predictor, counted_readings, rms_error

#: Blocks of validation readings, which give the standard error; of several recordings each has at least two.
VALIDATION_BLOCKS = 10


@dataclass(frozen=True, eq=False)
class Validation:
    """Errors of structures on validation readings: ``counted`` (n, m) of each recording, the same for all structures.

    Outliers of the first model are left out."""

    predictor: Predictor
    counted: Mapping[int, Mask]

    @classmethod
    def of(cls, predictor: Predictor, calibration: Calibration, fit: Optimum) -> Validation | None:
        """The validation readings as the first model shows them; None if there are none, or it cannot predict them."""
        recordings = predictor.recordings
        judged = [k for k, r in enumerate(recordings.everything) if recordings.parts_of(r, "validation", "test")]
        found = predictor.outputs(calibration, fit, judged)
        if found is None:
            return None
        counted: dict[int, Mask] = {}
        for k in judged:
            recording, mask = recordings.everything[k], np.zeros(found[k].shape, dtype=bool)
            for column, output in enumerate(recordings.outputs):
                if output in recording.outputs:
                    mask[:, column] = counted_readings(recording, output, found[k][:, column])
            counted[k] = mask
        return cls(predictor, counted)

    def errors(self, calibration: Calibration, fit: Optimum) -> tuple[FloatArray, dict[str, float]]:
        """Squared errors (blocks, m) on validation readings, and the RMS by output on test readings.

        CannotFinishError where the model cannot be simulated over validation readings."""
        found = self.predictor.outputs(calibration, fit, self.counted)
        if found is None:
            raise CannotFinishError("the fitted model cannot be simulated over the validation readings")
        recordings = self.predictor.recordings
        blocks: list[FloatArray] = []
        tested: dict[str, list[FloatArray]] = {}
        for k, counted in self.counted.items():
            recording = recordings.everything[k]
            read = [recording.outputs.get(o, np.full(recording.rows, np.nan)) for o in recordings.outputs]
            residual = np.where(counted, np.column_stack(read) - found[k], 0.0)
            for part in recordings.parts_of(recording, "validation"):
                inside = np.nonzero(part.within & counted.any(axis=1))[0]
                count = max(VALIDATION_BLOCKS // len(self.counted), 2)
                blocks += [np.sum(residual[rows] ** 2, axis=0) for rows in np.array_split(inside, count)]
            for part in recordings.parts_of(recording, "test"):
                for column, output in enumerate(recordings.outputs):
                    own = residual[part.within & counted[:, column], column]
                    if own.size and np.all(np.isfinite(own)):
                        tested.setdefault(output, []).append(own)
        errors = {output: rms_error(np.concatenate(parts)).rms for output, parts in tested.items()}
        return np.array(blocks), errors
