"""Simulations and predictions with the values of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.data import Recording
from aero_bayes.estimate.band_width import band_factors
from aero_bayes.estimate.fit_statistics import FitStatistics
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.prediction import FittedPredictor, RecordingPrediction
from aero_bayes.estimate.simulate import simulate

FloatArray = NDArray[np.float64]


class FittedSimulation(FitStatistics):
    """A fit that simulates and predicts other recordings; :class:`Fit` describes the fields."""

    values: FloatArray
    free: tuple[int, ...]
    series: tuple[Series, ...]
    fitted: tuple[FloatArray, ...]
    engine: str

    def simulate(
        self,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        parameters: Mapping[str, float] | None = None,
        start: Mapping[str, float] | None = None,
    ) -> Recording:
        """Run the fitted model on other inputs.

        Parameters
        ----------
        inputs : Recording or mapping of str to array_like, shape (n,)
            A recording, whose readings only give its initial values; or ``time`` in s and every input in its SI unit. A
            recording that was fitted keeps its own delay and start. Another one takes the mean delay of those that
            were, and starts at its own first readings, off by as much as theirs were; without readings, where the
            model starts.
        parameters : mapping of str to float, optional
            Other values of parameters of the model, in SI units.
        start : mapping of str to float, optional
            Initial values of states, in SI units.

        Returns
        -------
        Recording
            The inputs, and the fit's outputs as simulated, without noise.

        Raises
        ------
        InputError
            For inputs, parameters or states that the model does not have, or an input that is missing.
        CannotFinishError
            If the model cannot be simulated so.

        Examples
        --------
        >>> time = np.linspace(0.0, 2.0, 201)
        >>> pushed = fit.simulate({"time": time, "F": 2.0 * (time > 0.5)}, parameters={"k": 100.0})
        >>> pushed.rows, list(pushed.outputs)
        (201, ['position'])
        """
        return simulate(self.calibration, self.values, inputs, parameters=parameters, start=start, engine=self.engine)

    @cached_property
    def predictor(self) -> FittedPredictor:
        """Predicts recordings from draws of parameters; the width of its bands comes from readings that are left out.

        Examples
        --------
        >>> bool(fit.predictor.band_factors[0] >= 1.64)  # standard deviations
        True
        """
        covariance = self.laplace.covariance[: len(self.free), : len(self.free)]
        left = [y - f for y, f in zip(self.calibration.raw_readings, self.fitted, strict=True)]
        factors = band_factors(self.calibration, self.series, self.optimum, covariance, left)
        return FittedPredictor(self.calibration, self.values, self.free, self.noise, factors, self.engine)

    def predict(
        self,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        draws: int = 200,
        seed: int = 1,
        workers: int | None = 0,
    ) -> RecordingPrediction:
        """Return what new readings would be, with a 90 % band, by the Gaussian approximation of the posterior.

        Parameters
        ----------
        inputs : Recording or mapping of str to array_like, shape (n,)
            As :meth:`simulate` takes them.
        draws : int
            Draws of the parameters that are simulated.
        seed : int
            Of the draws.
        workers : int, optional
            Worker processes; none beside this one by default, None for all cores.

        Returns
        -------
        RecordingPrediction
            As of :meth:`aero_bayes.Posterior.predict`, which needs no approximation but a sampler.

        Raises
        ------
        InputError
            For inputs that the model does not have, or one that is missing.
        CannotFinishError
            If no draw can be simulated.

        Examples
        --------
        >>> fit.predict(test, draws=50).to_frame().shape == (test.rows, 3)
        True
        """
        points = self.laplace.draw(draws, np.random.default_rng(seed))
        count, parameters = len(self.free), self.calibration.parameters
        low, high = (bound[list(self.free)] for bound in parameters.box)
        coordinates = np.tile(parameters.to_search(self.values), (draws, 1))
        coordinates[:, list(self.free)] = np.clip(points[:, :count], low, high)
        values = parameters.from_search(coordinates)[:, list(self.free)]
        drawn = np.concatenate([values, np.exp(points[:, count:])], axis=1)
        return self.predictor.predict(drawn, inputs, seed=seed, workers=workers)
