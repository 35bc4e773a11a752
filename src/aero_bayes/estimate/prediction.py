"""What a fit and a posterior have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.display import join_names, parameter_lines, table_html
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.log_posterior import NoiseLayout
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.noise_estimation import reading_log_density
from aero_bayes.estimate.simulate import as_recording, on_recordings, opener
from aero_bayes.figures import Picture, drawn
from aero_bayes.plain import plain
from aero_bayes.simulation.interface import Outcome, Simulator
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False)
class Predictive:
    """Predictions for one recording."""

    time: FloatArray
    lower: FloatArray
    median: FloatArray
    upper: FloatArray
    draw_time: FloatArray
    draws: FloatArray
    block_edges: FloatArray
    log_likelihood: FloatArray


def recording_log_density(time: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Compute the log-density (k, n) of readings given earlier ones, of residuals (k, n, m), noise (k, m, 3)."""
    out = np.zeros(residual.shape[:2])
    for j in range(residual.shape[2]):
        out += reading_log_density(time, residual[:, :, j], noise[:, j])
    return out


def edges(n: int, blocks: int) -> NDArray[np.int64]:
    """Cut rows into ``blocks`` blocks of about equal length; returns the edges, the ends included."""
    return np.unique(np.linspace(0, n, min(blocks, n) + 1).astype(np.int64))


def _noise_draws(rng: np.random.Generator, noise: FloatArray, times: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """Draw noise at some of the times, shape (k, n, m), for noise triples (k, m, 3)."""
    time = times[rows]
    k, m = noise.shape[:2]
    white, ou, tau = np.moveaxis(noise, 2, 0)
    out = np.empty((k, time.size, m))
    state = rng.standard_normal((k, m))
    for j in range(time.size):
        if j:
            rho = np.exp(-(time[j] - time[j - 1]) / np.where(tau > 0.0, tau, 1.0))
            state = rho * state + np.sqrt(1.0 - rho**2) * rng.standard_normal((k, m))
        out[:, j] = ou * state
    return np.asarray(out + white[:, None] * rng.standard_normal(out.shape))


def _predict_from_filter(
    time: FloatArray, measured: FloatArray, predicted: FloatArray, variance: FloatArray, factors: FloatArray,
    rng: np.random.Generator, blocks: int,
) -> Predictive:  # fmt: skip
    """Predict readings from a filter's predictions (k, n, m) of independent readings, and their variances."""
    density = np.nansum(-0.5 * ((measured - predicted) ** 2 / variance + np.log(2.0 * np.pi * variance)), axis=2)
    bounds = edges(time.size, blocks)
    sd = np.sqrt(variance)
    return _summarise(
        time, predicted.astype(np.float32), sd, lambda rows: sd[:, rows] * rng.standard_normal(sd[:, rows].shape),
        np.add.reduceat(density, bounds[:-1], axis=1), factors, blocks,
    )  # fmt: skip


def _summarise(
    time: FloatArray,
    outputs: NDArray[np.float32],
    sd: FloatArray,
    noise: Callable[[NDArray[np.int64]], FloatArray],
    density: FloatArray,
    factors: FloatArray,
    blocks: int,
) -> Predictive:
    """Summarise readings by bands and draws."""
    _, n, m = outputs.shape
    lower, median, upper = np.empty((n, m)), np.empty((n, m)), np.empty((n, m))
    variance = np.broadcast_to(np.mean(sd**2, axis=0), (n, m))
    for first in range(0, n, 4000):
        part = outputs[:, first : first + 4000].astype(np.float64)
        spread = factors * np.sqrt(variance[first : first + 4000] + part.var(axis=0))
        centre = part.mean(axis=0)
        median[first : first + 4000] = centre
        lower[first : first + 4000], upper[first : first + 4000] = centre - spread, centre + spread
    chosen = np.unique(np.linspace(0, n - 1, min(_STORED, n)).astype(np.int64))
    draws = outputs[:, chosen].astype(np.float64) + noise(chosen)
    bounds = edges(n, blocks)
    return Predictive(time, lower, median, upper, time[chosen], draws, time[np.minimum(bounds, n - 1)], density)


#: Sample times of which whole draws are kept, and draws that are simulated at a time.
_STORED, _AT_ONCE = 600, 25
#: Blocks of time whose density is given of one prediction.
_BLOCKS = 60


def predictives(
    calibration: Calibration, simulator: Simulator, values: FloatArray, noise: FloatArray, factors: FloatArray,
    rng: np.random.Generator, *, read: Sequence[FloatArray], blocks: int = _BLOCKS, likely: FloatArray | None = None,
) -> tuple[Predictive, ...]:  # fmt: skip
    """Predict readings of each recording of a calibration from draws: SI values (k, p) and noise triples (k, m, 3).

    ``read`` (n, m) is what was read of each. ``likely`` (k, p) are the values at which the likelihood is taken, where
    it was widened. With process noise the filter of each draw predicts each reading of an experiment from all before
    it. Draws that fail are left out."""
    times = [e.time for e in calibration.data.experiments]
    if calibration.process is not None:
        found = cast(NativeSimulator, simulator).filter(values)
        good = np.all(found.outcomes == Outcome.OK, axis=1)
        if good.any():
            return tuple(
                _predict_from_filter(time, y, predicted[good], variance[good], factors, rng, blocks)
                for time, y, predicted, variance in zip(times, read, found.predicted, found.variance, strict=True)
            )
    elif chunks := list(_simulated(simulator, times, read, values, noise, likely, blocks)):
        kept = np.concatenate([own for own, _, _ in chunks])
        sd = np.hypot(kept[:, np.newaxis, :, 0], kept[:, np.newaxis, :, 1])
        return tuple(
            _summarise(
                time, np.concatenate([y[e] for _, y, _ in chunks]), sd, partial(_noise_draws, rng, kept, time),
                np.concatenate([density[e] for _, _, density in chunks]), factors, blocks,
            )
            for e, time in enumerate(times)
        )  # fmt: skip
    names = join_names([recording.name for recording in calibration.data.recordings])
    raise CannotFinishError(f"no draw of the posterior could be simulated over {names}")


def _simulated(
    simulator: Simulator, times: Sequence[FloatArray], read: Sequence[FloatArray], values: FloatArray,
    noise: FloatArray, likely: FloatArray | None, blocks: int,
) -> Iterator[tuple[FloatArray, list[NDArray[np.float32]], list[FloatArray]]]:  # fmt: skip
    """Noise, outputs and log-densities by block of some draws at a time, the latter two by recording."""
    for first in range(0, len(values), _AT_ONCE):
        rows = np.arange(first, min(first + _AT_ONCE, len(values)))
        run = other = simulator.simulate(values[rows])
        if likely is not None:
            other = simulator.simulate(likely[rows])
        good = np.all((run.outcomes == Outcome.OK) & (other.outcomes == Outcome.OK), axis=1)
        if good.any():
            kept = noise[rows[good]]
            densities = [
                np.add.reduceat(recording_log_density(time, y - at[good], kept), edges(time.size, blocks)[:-1], axis=1)
                for time, y, at in zip(times, read, other.outputs, strict=True)
            ]
            yield kept, [y[good].astype(np.float32) for y in run.outputs], densities


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

    def plot(self, *, dark: bool = False) -> Picture:
        """Draw the median and the 90 % band over what was read.

        Parameters
        ----------
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture

        Examples
        --------
        >>> posterior.predict(test).plot().save("prediction.svg").name
        'prediction.svg'
        """
        return drawn("prediction_picture", self, dark=dark)

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

    def predict(
        self,
        points: FloatArray,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        seed: int = 1,
        workers: int | None = 0,
    ) -> RecordingPrediction:
        """Predict readings of a recording for draws of free and noise parameters."""
        calibration, free = self.calibration, len(self.free)
        recording, opened = as_recording(inputs, calibration), opener(workers)
        values = np.tile(self.values, (1 + len(points), 1))
        values[1:, list(self.free)] = points[:, :free]
        whole, rows = on_recordings(calibration, values, [recording], self.noise, opened)
        noise, read = np.empty((len(points), 0, 3)), whole.data.measured
        if calibration.process is None:
            noise = NoiseLayout.of(calibration.data, self.noise).unpack(np.log(points[:, free:]))[:, 0]
        else:  # its filter is not told the readings
            blind = (replace(e, measured=None) for e in whole.data.experiments)
            whole = replace(whole, data=whole.data.with_experiments(blind))
        rng = np.random.default_rng(seed)
        with opened(whole.problem()) as simulator:
            (part,) = predictives(whole, simulator, rows[1:], noise, self.band_factors, rng, read=read)
        return RecordingPrediction(calibration.model, recording, calibration.data.outputs, part)


class FittedResult(ABC):
    """What a fit and a posterior have in common: an entry for each parameter, and predictions of recordings."""

    @property
    @abstractmethod
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter by name."""

    @property
    @abstractmethod
    def predictor(self) -> FittedPredictor:
        """Predicts recordings from draws of parameters."""

    @abstractmethod
    def _parameter_draws(self, draws: int, seed: int) -> FloatArray:
        """Return draws of free and noise parameters in SI units, shape (draws, d)."""

    def __getitem__(self, name: str) -> Estimate:
        table = self.parameters
        if name not in table:
            raise InputError(f"no parameter {name!r}{known_names_hint(str(name), table)}")
        return table[name]

    def __contains__(self, name: str) -> bool:
        return name in self.parameters

    @property
    @abstractmethod
    def verdict(self) -> str:
        """Whether the model explains the recordings, in a line."""

    def summary(self) -> str:
        """Return whether the model explains the data, and a table of parameters: value, 90 % interval, unit, status.

        Examples
        --------
        >>> said, head, *rows = fit.summary().splitlines()
        >>> said == fit.verdict, head.split()[:2]
        (True, ['parameter', 'value'])
        """
        return "\n".join([self.verdict, *parameter_lines(self.parameters)])

    def __str__(self) -> str:
        return self.summary()

    def to_frame(self) -> pandas.DataFrame:
        """Return a row for each parameter: value, standard deviation, quantiles (SI), unit, status, prior, bounds.

        The value of a posterior is its median.

        Examples
        --------
        >>> fit.to_frame().loc["k", ["unit", "status"]].to_list()
        ['N/m', 'identified']
        >>> bool(posterior.to_frame().loc["k", "q05"] < posterior.to_frame().loc["k", "q95"])
        True
        """
        import pandas

        rows = plain(self.parameters)
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    def predict(
        self,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        draws: int = 200,
        seed: int = 1,
        workers: int | None = 0,
    ) -> RecordingPrediction:
        """Predict new readings with a 90 % band, for a recording whether it was fitted or not.

        A posterior predicts from its own draws, a fit from draws of the Gaussian approximation of its posterior.

        Parameters
        ----------
        inputs : Recording or mapping of str to array_like, shape (n,)
            As :meth:`Fit.simulate` takes them.
        draws : int
            Draws of the parameters that are simulated.
        seed : int
            Of what is drawn: the noise, and the parameters of a fit.
        workers : int, optional
            Worker processes; none beside this one by default, None for all cores.

        Returns
        -------
        RecordingPrediction
            Median and 90 % band, noise included, and how the readings lie in it. The band is as wide as noise
            and parameters make it, and wider where the fit missed readings that were left out of it.

        Raises
        ------
        InputError
            For inputs that the model does not have, or one that is missing.
        CannotFinishError
            If no draw can be simulated.

        Examples
        --------
        >>> posterior.predict(test, draws=50).to_frame().shape == (test.rows, 3)
        True
        >>> fit.predict(test, draws=50).to_frame().shape == (test.rows, 3)
        True
        """
        points = self._parameter_draws(draws, seed)
        return self.predictor.predict(points, inputs, seed=seed, workers=workers)
