"""The posterior of a fit: draws, intervals, predictions and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.identifiability import estimates_html
from aero_bayes.estimate.other_tools import chosen_estimates, noise_table, process_noise_table
from aero_bayes.estimate.prediction import FittedPredictor, FittedResult
from aero_bayes.figures import describe_figure_parameters, drawn
from aero_bayes.plain import picked
from aero_bayes.posterior.inferencedata import PosteriorDraws, save, to_inference_data
from aero_bayes.posterior.modes import ModeDraws
from aero_bayes.simulation.interface import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Json = dict[str, object]


@dataclass(frozen=True, eq=False)
class Posterior(PosteriorDraws, FittedResult):
    """Draws from the posterior of a fit.

    Parameters
    ----------
    fit : Fit
        What the sampling started from.
    names : tuple of str, length d
        Free parameters, then noise parameters (``noise.<output>.<part>``).
    draws : ndarray, shape (ensembles, draws, d)
        In SI units, thinned evenly from the chain; the ensembles are independent.
    log_posterior : ndarray, shape (ensembles, draws)
    predictive : tuple of Predictive
        One a recording.
    diagnoses : mapping of str to Convergence
    converged : bool
        False unless every criterion of the settings was met.
    reason : str
        Which was not.
    seed : int
    trace : ndarray, shape (ensembles, steps, d)
        Mean over the walkers of each ensemble after each step, in SI units, for trace plots; with several modes, those
        of all of them, one mode after the other.
    acceptance : float
        Share of proposals that were taken.
    steps, walkers, evaluations : int
        Steps of the kept chain, walkers of an ensemble, points at which the density was computed.
    outcomes : mapping of Outcome to int
        How many simulations ended how.
    seconds : float
    mode_draws : tuple of ModeDraws
        With several modes: how many draws are of each, the reported one first.

    Examples
    --------
    >>> posterior.samples("k").shape == (posterior.draws.shape[0] * posterior.draws.shape[1],)
    True
    >>> entry = posterior["k"]
    >>> bool(entry.q05 < np.median(posterior.samples("k")) < entry.q95), entry.unit
    (True, 'N/m')
    >>> posterior.r_hat_max < 1.2 and min(posterior.ess_bulk_min, posterior.ess_tail_min) > 100 and posterior.tau > 0
    True
    >>> posterior.noise["position"].sd > 0, len(posterior.warnings) >= len(posterior.fit.warnings)
    (True, True)
    >>> posterior.predictor is posterior.fit.predictor
    True
    >>> posterior.calibration is fit.calibration, posterior.to_dict()["mcmc"]["ensembles"]
    (True, 4)
    >>> posterior.save(Path("posterior.nc")).name
    'posterior.nc'
    """

    trace: FloatArray
    acceptance: float
    steps: int
    walkers: int
    evaluations: int
    outcomes: Mapping[Outcome, int]
    seconds: float
    mode_draws: tuple[ModeDraws, ...] = ()

    def to_dict(self) -> Json:
        """Return the keys of result.json that a posterior fills, those of its fit included."""
        base = self.fit.to_dict()
        failures = {o.key: self.fit.outcomes.get(o, 0) + self.outcomes.get(o, 0) for o in Outcome}
        return base | {
            "parameters": {
                name: e.to_dict() for name, e in (self.parameters | chosen_estimates(self.fit.trials)).items()
            },
            "noise": noise_table(self.calibration.data, self.noise),
            "process_noise": process_noise_table(self.calibration.process, self.parameters),
            "mcmc": picked(
                self,
                "walkers tau r_hat_max ess_bulk_min ess_tail_min seconds converged reason acceptance evaluations",
                ensembles=self.draws.shape[0],
                draws=self.steps,
                modes=[row.to_dict() for row in self.mode_draws],
                per_parameter={n: picked(d, "r_hat ess_bulk ess_tail tau") for n, d in self.diagnoses.items()},
            ),
            "failures": failures,
            "warnings": list(self.warnings),
            "seconds": self.fit.seconds + self.seconds,
        }

    def save(self, path: Path | str) -> Path:
        """Write ArviZ InferenceData (netCDF) to ``path``, whole or not at all."""
        return save(self, Path(path))

    @property
    def idata(self) -> Any:
        """The draws as ArviZ takes them: InferenceData, from ArviZ 1.0 on a DataTree.

        Examples
        --------
        >>> import arviz
        >>> arviz.summary(posterior.idata, var_names=["k", "d"]).index.to_list()
        ['k', 'd']
        """
        return to_inference_data(self)

    @property
    def predictor(self) -> FittedPredictor:
        """Predicts recordings from draws of parameters, as the fit's."""
        return self.fit.predictor

    def _parameter_draws(self, draws: int, seed: int) -> FloatArray:
        points = self.draws.reshape(-1, self.draws.shape[-1])
        return points[np.unique(np.linspace(0, len(points) - 1, min(draws, len(points))).astype(np.int64))]

    @describe_figure_parameters
    def plot(
        self,
        parameters: Sequence[str] | None = None,
        *,
        ax: Axes | None = None,
        figure: Figure | None = None,
        dark: bool = False,
    ) -> Figure:
        """Draw how the parameters hang together: marginals, 50 % and 90 % regions, rank correlations.

        Parameters
        ----------
        parameters : sequence of str, optional
            Which; by default at most eight, those in the strongest correlations.

        Raises
        ------
        InputError
            For a parameter without draws.

        Examples
        --------
        >>> len(posterior.plot(["k", "d"]).axes)
        4
        """
        units = {name: entry.unit for name, entry in self.parameters.items()}
        by_name = {name: self.draws[:, :, j] for j, name in enumerate(self.names)}
        return drawn("pairs_figure", by_name, units, parameters, figure=ax or figure, dark=dark)

    @describe_figure_parameters
    def plot_bands(
        self, recording: str | None = None, *, ax: Axes | None = None, figure: Figure | None = None, dark: bool = False
    ) -> Figure:
        """Draw a fitted recording within the 90 % band of new readings.

        Parameters
        ----------
        recording : str, optional
            Name of a fitted recording; the first by default.

        Raises
        ------
        InputError
            For a recording that was not fitted.

        Examples
        --------
        >>> posterior.plot_bands().savefig("bands.png")
        """
        return drawn("bands_figure", self, recording, figure=ax or figure, dark=dark)

    def _repr_html_(self) -> str:
        caption = f"{self.calibration.model.name}: R-hat {self.r_hat_max:.4f}, ESS {self.ess_bulk_min:.0f}"
        return estimates_html(self.parameters, caption, self.warnings)

    def __repr__(self) -> str:
        state = "converged" if self.converged else f"not converged ({self.reason})"
        return (
            f"<Posterior {self.calibration.model.name}: {self.draws.shape[0]} ensembles, {self.steps} steps, {state}>"
        )
