"""The posterior of a fit: draws, intervals, predictions and figures; the only module that touches ArviZ (0.20 to 1.x).

For ArviZ a *chain* is an ensemble; its draws are taken evenly over steps and walkers. ``log_likelihood`` holds each
reading (in long recordings, blocks of a few) given all earlier ones: whitened innovations, which are independent, under
the likelihood that the posterior is made of. ``prior`` holds draws of what is searched; ``posterior_predictive`` and
``observed_data`` are thinned to some hundred sample times.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.convergence import Convergence
from aero_bayes.estimate.exports import chosen_estimates, noise_table, process_noise_table
from aero_bayes.estimate.identifiability import Estimate, Status, estimates_html, status_of
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.prediction import FittedPredictor, FittedResult, Predictive
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.sampled_modes import ModeDraws
from aero_bayes.figures import HasPage, Picture, drawn
from aero_bayes.files import whole_file
from aero_bayes.plain import JsonNumber, JsonTable, picked, plain
from aero_bayes.simulation.interface import Outcome

Json = dict[str, object]


class McmcJson(JsonTable):
    """The sampler."""

    ensembles: int
    draws: int
    walkers: int | None = None
    tau: JsonNumber
    r_hat_max: JsonNumber
    ess_bulk_min: JsonNumber
    ess_tail_min: JsonNumber
    seconds: float
    converged: bool = True
    reason: str = ""
    acceptance: JsonNumber = None
    evaluations: int | None = None
    modes: list[ModeDraws] = Field(default_factory=list)
    per_parameter: dict[str, Convergence] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Posterior(FittedResult, HasPage):
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
    >>> posterior.predictor is posterior.fit.predictor, posterior.verdict.endswith(posterior.fit.verdict)
    (True, True)
    >>> posterior.calibration is fit.calibration, posterior.to_dict()["mcmc"]["ensembles"]
    (True, 4)
    >>> posterior.save(Path("posterior.nc")).name
    'posterior.nc'
    """

    fit: Fit
    names: tuple[str, ...]
    draws: FloatArray
    log_posterior: FloatArray
    predictive: tuple[Predictive, ...]
    diagnoses: Mapping[str, Convergence]
    converged: bool
    reason: str
    seed: int
    trace: FloatArray
    acceptance: float
    steps: int
    walkers: int
    evaluations: int
    outcomes: Mapping[Outcome, int]
    seconds: float
    mode_draws: tuple[ModeDraws, ...] = ()

    @property
    def calibration(self) -> Calibration:
        """What was fitted to what."""
        return self.fit.calibration

    @property
    def tau(self) -> float:
        """Longest autocorrelation time in steps."""
        return Convergence.worst(self.diagnoses.values()).tau

    @property
    def r_hat_max(self) -> float:
        """Largest rank-normalised R-hat of any parameter; at most 1.01 is asked for."""
        return Convergence.worst(self.diagnoses.values()).r_hat

    @property
    def ess_bulk_min(self) -> float:
        """Fewest effective draws for the middle of any parameter."""
        return Convergence.worst(self.diagnoses.values()).ess_bulk

    @property
    def ess_tail_min(self) -> float:
        """Fewest effective draws for the tails of any parameter."""
        return Convergence.worst(self.diagnoses.values()).ess_tail

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know before trusting an interval."""
        unfinished = () if self.converged else (f"The sampling has not converged: {self.reason}.",)
        return unfinished + self.fit.warnings

    def samples(self, name: str) -> FloatArray:
        """Return draws of one parameter by ``name`` over all ensembles, in its SI unit, shape (ensembles * draws,)."""
        return self.draws[:, :, self.names.index(name)].ravel()

    @cached_property
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter: median, standard deviation, quantiles; the model's fixed ones included."""
        estimates = dict(self.fit.parameters)
        prior_sd = self.calibration.parameters.prior_sd()
        for column, item in enumerate(self.calibration.parameters):
            if item.name in self.names and estimates[item.name].status is not Status.AT_BOUND:
                estimates[item.name] = self._marginal(estimates[item.name], item, float(prior_sd[column]))
        return estimates

    def _marginal(self, estimate: Estimate, item: Parameter, prior_sd: float) -> Estimate:
        """Estimate a parameter from its draws; its prior has a standard deviation in search coordinates."""
        x = self.samples(item.name)
        axis = np.log(x) if item.scale == "log" else x / (item.upper - item.lower)
        status = self.fit.identifiability.capped(item.name, status_of(float(np.std(axis)) / prior_sd))
        q05, q50, q95 = np.quantile(x, [0.05, 0.5, 0.95]).tolist()
        if status is Status.UNIDENTIFIED:
            note = "the data says no more of it than the prior"
            return replace(estimate, value=q50, status=status, sd=None, q05=None, q50=None, q95=None, note=note)
        # Between two modes the median is a value that fits nothing: the reported one stays.
        value, note = (estimate.value, "the interval is that of all answers") if self.fit.modes else (q50, "")
        note = "; ".join(filter(None, (note, self.fit.identifiability.with_held.get(item.name, ""))))
        return replace(estimate, value=value, status=status, sd=float(np.std(x)), q05=q05, q50=q50, q95=q95, note=note)

    @property
    def noise(self) -> dict[str, OutputNoise]:
        """Noise of each output at the posterior's median."""
        found = {}
        for output, held in self.fit.noise.items():
            parts = {p: f"noise.{output}.{p}" for p in ("sd_white", "sd_ou", "tau")}
            middle = {p: float(np.median(self.samples(n))) for p, n in parts.items() if n in self.names}
            found[output] = OutputNoise(**{**held.__dict__, **middle})
        return found

    def to_dict(self) -> Json:
        """Return the keys of result.json that a posterior fills, those of its fit included."""
        base = self.fit.to_dict()
        failures = {o.key: self.fit.outcomes.get(o, 0) + self.outcomes.get(o, 0) for o in Outcome}
        return base | {
            "parameters": plain(self.parameters | chosen_estimates(self.fit.trials)),
            "noise": noise_table(self.calibration.data, self.noise),
            "process_noise": process_noise_table(self.calibration.process, self.parameters),
            "mcmc": picked(
                McmcJson,
                self,
                ensembles=self.draws.shape[0],
                draws=self.steps,
                modes=self.mode_draws,
                per_parameter=self.diagnoses,
            ),
            "failures": failures,
            "warnings": list(self.warnings),
            "seconds": self.fit.seconds + self.seconds,
        }

    def save(self, path: Path | str) -> Path:
        """Write ArviZ InferenceData (netCDF) to ``path``, whole or not at all."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            self.to_arviz().to_netcdf(str(temporary), engine="h5netcdf")
        return path

    def to_arviz(self) -> Any:
        """Return the draws as ArviZ takes them: InferenceData, from ArviZ 1.0 on a DataTree.

        Examples
        --------
        >>> import arviz
        >>> arviz.summary(posterior.to_arviz(), var_names=["k", "d"]).index.to_list()
        ['k', 'd']
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import arviz

            groups, coords, dims = _groups(self)
            groups = {name: variables for name, variables in groups.items() if variables}
            new = int(arviz.__version__.split(".")[0]) >= 1
            make: Any = arviz.from_dict
            data = make(groups, coords=coords, dims=dims) if new else make(**groups, coords=coords, dims=dims)
            data.attrs.update({"converged": int(self.converged), "reason": self.reason, "seed": self.seed})
            return data

    @property
    def verdict(self) -> str:
        """Whether the model explains the recordings, in a line; first of all, whether the sampling has converged."""
        unfinished = "" if self.converged else f"The sampling has not converged: {self.reason}. "
        return f"{unfinished}{self.fit.verdict}"

    @property
    def predictor(self) -> FittedPredictor:
        """Predicts recordings from draws of parameters, as the fit's."""
        return self.fit.predictor

    def _parameter_draws(self, draws: int, seed: int) -> FloatArray:
        points = self.draws.reshape(-1, self.draws.shape[-1])
        return points[np.unique(np.linspace(0, len(points) - 1, min(draws, len(points))).astype(np.int64))]

    def plot(self, parameters: Sequence[str] | None = None, *, dark: bool = False) -> Picture:
        """Draw how the parameters hang together: marginals, 50 % and 90 % regions, rank correlations.

        Parameters
        ----------
        parameters : sequence of str, optional
            Which; by default at most eight, those in the strongest correlations.
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture

        Raises
        ------
        InputError
            For a parameter without draws.

        Examples
        --------
        >>> posterior.plot(["k", "d"]).save("pairs.svg").name
        'pairs.svg'
        """
        units = {name: entry.unit for name, entry in self.parameters.items()}
        by_name = {name: self.draws[:, :, j] for j, name in enumerate(self.names)}
        return drawn("pairs_picture", by_name, units, parameters, dark=dark)

    def plot_bands(self, recording: str | None = None, *, dark: bool = False) -> Picture:
        """Draw a fitted recording within the 90 % band of new readings.

        Parameters
        ----------
        recording : str, optional
            Name of a fitted recording; the first by default.
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture

        Raises
        ------
        InputError
            For a recording that was not fitted.

        Examples
        --------
        >>> posterior.plot_bands().save("bands.svg").name
        'bands.svg'
        """
        return drawn("run_picture", self, recording, dark=dark)

    def _repr_html_(self) -> str:
        caption = f"{self.calibration.model.name}: R-hat {self.r_hat_max:.4f}, ESS {self.ess_bulk_min:.0f}"
        return estimates_html(self.parameters, caption, (self.verdict, *self.fit.warnings))

    def __repr__(self) -> str:
        state = "converged" if self.converged else f"not converged ({self.reason})"
        return (
            f"<Posterior {self.calibration.model.name}: {self.draws.shape[0]} ensembles, {self.steps} steps, {state}>"
        )


def _groups(posterior: Posterior) -> tuple[dict[str, dict[str, Any]], dict[str, Any], dict[str, list[str]]]:
    """Collect groups of variables, coordinates and dimensions."""
    chains = posterior.draws.shape[0]
    groups: dict[str, dict[str, Any]] = {
        "posterior": {n: posterior.draws[:, :, j] for j, n in enumerate(posterior.names)},
        "sample_stats": {"lp": posterior.log_posterior},
        "log_likelihood": {},
        "prior": _prior(posterior),
        "posterior_predictive": {},
        "observed_data": {},
    }
    coords: dict[str, Any] = {}
    dims: dict[str, list[str]] = {}
    for index, (name, part) in enumerate(zip(posterior.calibration.data.names, posterior.predictive, strict=True)):
        label = re.sub(r"\W+", "_", name) or f"recording_{index}"
        if posterior.calibration.data.names.count(name) > 1:
            label = f"{label}_{index}"
        each = len(part.draws) // chains
        if each == 0:
            continue
        coords |= {f"time_{label}": part.draw_time, f"block_{label}": part.block_edges[:-1]}
        blocks = part.log_likelihood[: chains * each]
        groups["log_likelihood"][label] = blocks.reshape(chains, each, -1)
        dims[label] = [f"block_{label}"]
        measured = np.asarray(posterior.calibration.data.experiments[index].measured)
        rows = np.searchsorted(part.time, part.draw_time)
        for k, output in enumerate(posterior.calibration.data.outputs):
            if not np.isfinite(measured[:, k]).any():
                continue
            variable = f"{output}_{label}"
            draws = part.draws[: chains * each, :, k]
            groups["posterior_predictive"][variable] = draws.reshape(chains, each, -1).astype(np.float32)
            groups["observed_data"][variable] = measured[rows, k]
            dims[variable] = [f"time_{label}"]
    return groups, coords, dims


def _prior(posterior: Posterior) -> dict[str, Any]:
    """Return it as many draws from the priors of the parameters as a chain has.

    The noise has none that can be drawn from."""
    fit = posterior.fit
    part = ParameterSet(tuple(fit.calibration.parameters.items[j] for j in fit.free))
    drawn = part.sample_prior(np.random.default_rng(posterior.seed), posterior.draws.shape[1])
    return {name: drawn[None, :, j] for j, name in enumerate(part.names)}


def draws_in(path: Path) -> dict[str, FloatArray]:
    """Return the draws of each parameter in a file, shape (chains, draws); InputError if it has none."""
    import xarray  # a second of imports that only a posterior needs

    try:
        with xarray.open_dataset(path, group="posterior") as group:
            found = {str(name): values for name, values in group.items() if {*values.dims} == {"chain", "draw"}}
            return {name: np.asarray(values.transpose("chain", "draw"), np.float64) for name, values in found.items()}
    except (OSError, KeyError, ValueError):
        raise InputError("is no posterior as aero-bayes or ArviZ writes it (netCDF with a group posterior)") from None


def load(path: Path) -> Any:
    """Read back what :func:`save` wrote."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz

        reader: Any = arviz.from_netcdf
        return reader(str(path), engine="h5netcdf")
