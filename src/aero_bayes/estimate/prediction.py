"""Predicted readings of a recording, whether it was fitted or not, with bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.display import table_html
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.predictive import (
    Predictive,
    edges,
    predict_from_filter,
    predict_from_outputs,
    recording_log_density,
)
from aero_bayes.estimate.simulate import as_recording, run_filter, run_problem
from aero_bayes.estimate.target import NoiseLayout
from aero_bayes.plot_backend import describe_figure_parameters, plot_backend
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import Filtered, Outcome
from aero_bayes.simulation.model import Model

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Sample times of which whole draws are kept, and blocks of time whose density is given.
_STORED, _BLOCKS = 600, 60


@dataclass(frozen=True, eq=False)
class RecordingPrediction:
    """What a fit or a posterior predicts for one recording.

    Parameters
    ----------
    model : Model
    recording : Recording
        Its inputs, and what was read if anything was.
    outputs : tuple of str, length m
    predictive : Predictive
        Median and bands, shape (n, m) each, and some draws.

    Examples
    --------
    >>> prediction = posterior.predict(test)
    >>> prediction.predictive.median.shape == (test.rows, 1)
    True
    """

    model: Model
    recording: Recording
    outputs: tuple[str, ...]
    predictive: Predictive

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square of readings minus median by output, in its SI unit; outputs without readings are left out.

        Examples
        --------
        >>> sorted(posterior.predict(test).rms)
        ['position']
        """
        return {o: float(np.sqrt(np.mean(r**2))) for o, r, _ in self._read()}

    @property
    def coverage(self) -> dict[str, float]:
        """Share (0 to 1) of readings within the 90 % band, by output; near 0.9 where the model is right.

        Examples
        --------
        >>> 0.0 <= posterior.predict(test).coverage["position"] <= 1.0
        True
        """
        return {o: float(np.mean(inside)) for o, _, inside in self._read()}

    def _read(self) -> list[tuple[str, FloatArray, NDArray[np.bool_]]]:
        found, part = [], self.predictive
        for k, output in enumerate(self.outputs):
            y = self.recording.outputs.get(output)
            if y is not None and (seen := np.isfinite(y)).any():
                inside = (y >= part.lower[:, k]) & (y <= part.upper[:, k])
                found.append((output, (y - part.median[:, k])[seen], inside[seen]))
        return found

    @describe_figure_parameters
    def plot(self, *, ax: Axes | None = None, figure: Figure | None = None, dark: bool = False) -> Figure:
        """Draw the median and the 90 % band over what was read.

        Examples
        --------
        >>> posterior.predict(test).plot().savefig("prediction.png")
        """
        return plot_backend().prediction_figure(self, figure=ax or figure, dark=dark)

    def to_frame(self) -> pandas.DataFrame:
        """Return median and 90 % band by time (s): columns (output, lower | median | upper), SI units.

        Examples
        --------
        >>> posterior.predict(test).to_frame()["position"].columns.to_list()
        ['lower', 'median', 'upper']
        """
        import pandas

        part = self.predictive
        columns = {
            (output, name): values[:, k]
            for k, output in enumerate(self.outputs)
            for name, values in (("lower", part.lower), ("median", part.median), ("upper", part.upper))
        }
        return pandas.DataFrame(columns, index=pandas.Index(part.time, name="time"))

    def __repr__(self) -> str:
        errors = "; ".join(f"{o}: RMS {r:.3g}, {self.coverage[o]:.0%} in the 90 % band" for o, r in self.rms.items())
        return f"<RecordingPrediction of {self.recording.name}: {errors or ', '.join(self.outputs)}>"

    def _repr_html_(self) -> str:
        rows = [(o, f"{r:.4g}", self.model.units[o], f"{self.coverage[o]:.0%}") for o, r in self.rms.items()]
        return table_html(("output", "RMS error", "unit", "within the 90 % band"), rows, repr(self).strip("<>"))


@dataclass(frozen=True, eq=False)
class FittedPredictor:
    """What predictions from draws of a posterior need to know of a fit."""

    calibration: Calibration
    values: FloatArray
    free: tuple[int, ...]
    noise: Mapping[str, OutputNoise]
    band_factors: FloatArray
    engine: str

    def predict(
        self,
        points: FloatArray,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        seed: int = 1,
        workers: int | None = 0,
    ) -> RecordingPrediction:
        """Predict readings of a recording for draws of free and noise parameters."""
        calibration, outputs = self.calibration, self.calibration.data.outputs
        recording = as_recording(inputs, calibration)
        values = np.tile(self.values, (len(points), 1))
        values[:, list(self.free)] = points[:, : len(self.free)]
        run = run_filter if calibration.simulated.process is not None else run_problem
        found = run(calibration, recording, values, workers=workers, engine=self.engine)
        good = found.outcomes[:, 0] == Outcome.OK
        if not good.any():
            raise CannotFinishError(f"no draw of the posterior could be simulated over {recording.name}")
        unread = np.full(recording.rows, np.nan)
        measured = np.column_stack([recording.outputs.get(o, unread) for o in outputs])
        rng, time = np.random.default_rng(seed), recording.time
        if isinstance(found, Filtered):
            y, variance = found.predicted[0][good], found.variance[0][good]
            part = predict_from_filter(time, measured, y, variance, self.band_factors, rng, _STORED, _BLOCKS)
        else:
            noise = NoiseLayout.of(calibration.data, self.noise).unpack(np.log(points[:, len(self.free) :]))[good, 0]
            density = recording_log_density(time, measured - found.outputs[0][good], noise)
            density = np.add.reduceat(density, edges(recording.rows, _BLOCKS)[:-1], axis=1)
            y32 = found.outputs[0][good].astype(np.float32)
            part = predict_from_outputs(time, y32, noise, density, self.band_factors, rng, _STORED, _BLOCKS)
        return RecordingPrediction(calibration.model, recording, outputs, part)
