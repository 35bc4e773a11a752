"""What a fit and a posterior have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.display import parameter_lines
from aero_bayes.errors import InputError
from aero_bayes.estimate.parameter_estimates import Estimate
from aero_bayes.estimate.prediction import FittedPredictor, RecordingPrediction
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas


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

    def summary(self) -> str:
        """Return a table of the parameters as text: value, 90 % interval, unit, status.

        Examples
        --------
        >>> fit.summary().splitlines()[0].split()[:2]
        ['parameter', 'value']
        """
        return "\n".join(parameter_lines(self.parameters))

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

        rows = {name: entry.to_dict() for name, entry in self.parameters.items()}
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
            Median, 90 % bands with noise and without, and how the readings lie in them. The band is as wide as noise
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
