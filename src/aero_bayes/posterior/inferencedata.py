"""The only module that touches ArviZ; works with 0.20 to 1.x.

A *chain* is an ensemble; its draws are taken evenly over steps and walkers. ``log_likelihood`` holds each reading
(in long recordings, blocks of a few) given all earlier ones: whitened innovations, which are independent, under the
likelihood that the posterior is made of. ``prior`` holds draws of what is searched; ``posterior_predictive`` and
``observed_data`` are thinned to some hundred sample times.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # imports its parts when they are first used
from scipy.special import ndtri

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Estimate, Status, status_of
from aero_bayes.estimate.noise import OutputNoise, autocovariance, integrated_time
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.prediction import Predictive
from aero_bayes.estimate.result import Fit
from aero_bayes.files import whole_file


def _rank_normalise(samples: FloatArray) -> FloatArray:
    """Replace samples by the normal scores of their ranks over all chains (Blom)."""
    rank = scipy.stats.rankdata(samples, method="average").reshape(samples.shape)
    return np.asarray(ndtri((rank - 0.375) / (samples.size + 0.25)))


def _plain_r_hat(chains: FloatArray) -> float:
    """Compute the potential scale reduction of chains, shape (c, n)."""
    n = chains.shape[1]
    within = float(np.mean(np.var(chains, axis=1, ddof=1)))
    between = float(np.var(np.mean(chains, axis=1), ddof=1))
    if within == 0.0:
        return 1.0 if between == 0.0 else np.inf
    return float(np.sqrt((n - 1) / n + between / within))


def r_hat(samples: FloatArray) -> float:
    """Compute the rank-normalised split R-hat, the larger of bulk and folded."""
    ensembles, steps, walkers = samples.shape
    half = steps // 2
    if half < 2:
        return np.inf
    kept = samples[:, steps - 2 * half :]
    chains = kept.reshape(2 * ensembles, half * walkers)
    folded = np.abs(chains - np.median(chains))
    return max(_plain_r_hat(_rank_normalise(chains)), _plain_r_hat(_rank_normalise(folded)))


def autocorrelation_time(samples: FloatArray, *, coupled: bool = True) -> float:
    """Compute the steps per independent sample of one walker, the larger of two estimates.

    Walkers are centred on the mean of all, so that one that stays where it is counts for little."""
    _, steps, walkers = samples.shape
    variance = float(np.var(samples))
    if variance == 0.0 or steps < 4:
        return float(steps)
    single = autocovariance(np.swapaxes(samples, 1, 2), float(samples.mean())).mean(axis=(0, 1))
    own = integrated_time(single / variance)
    mean = autocovariance(samples.mean(axis=2)).mean(axis=0)
    if not coupled or mean[0] <= 0.0:
        return max(own, 1.0)
    return float(max(own, walkers * mean[0] / variance * integrated_time(mean / mean[0]), 1.0))


@dataclass(frozen=True)
class Convergence:
    """Diagnostics of one quantity: ``tau`` in steps, ``ess`` in samples."""

    r_hat: float
    tau: float
    ess_bulk: float
    ess_tail: float


def check_convergence(samples: FloatArray, *, coupled: bool = True) -> Convergence:
    """Diagnose one quantity, shape (ensembles, steps, walkers)."""
    size = samples.size
    tau = autocorrelation_time(_rank_normalise(samples), coupled=coupled)
    low, high = np.quantile(samples, [0.05, 0.95])
    tails = [autocorrelation_time((samples <= q).astype(np.float64), coupled=coupled) for q in (low, high)]
    return Convergence(r_hat(samples), tau, size / tau, size / max(tails))


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Draws with their convergence, and the statistics that follow; :class:`Posterior` describes the fields."""

    fit: Fit
    names: tuple[str, ...]
    draws: FloatArray
    log_posterior: FloatArray
    predictive: tuple[Predictive, ...]
    diagnoses: Mapping[str, Convergence]
    converged: bool
    reason: str
    seed: int

    @property
    def calibration(self) -> Calibration:
        """What was fitted to what."""
        return self.fit.calibration

    @property
    def tau(self) -> float:
        """Longest autocorrelation time in steps."""
        return max(d.tau for d in self.diagnoses.values())

    @property
    def r_hat_max(self) -> float:
        """Largest rank-normalised R-hat of any parameter; at most 1.01 is asked for."""
        return max(d.r_hat for d in self.diagnoses.values())

    @property
    def ess_bulk_min(self) -> float:
        """Fewest effective draws for the middle of any parameter."""
        return min(d.ess_bulk for d in self.diagnoses.values())

    @property
    def ess_tail_min(self) -> float:
        """Fewest effective draws for the tails of any parameter."""
        return min(d.ess_tail for d in self.diagnoses.values())

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


def _groups(posterior: PosteriorDraws) -> tuple[dict[str, dict[str, Any]], dict[str, Any], dict[str, list[str]]]:
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


def _prior(posterior: PosteriorDraws) -> dict[str, Any]:
    """Return it as many draws from the priors of the parameters as a chain has.

    The noise has none that can be drawn from."""
    fit = posterior.fit
    part = ParameterSet(tuple(fit.calibration.parameters.items[j] for j in fit.free))
    drawn = part.sample_prior(np.random.default_rng(posterior.seed), posterior.draws.shape[1])
    return {name: drawn[None, :, j] for j, name in enumerate(part.names)}


def to_inference_data(posterior: PosteriorDraws) -> Any:
    """Make ArviZ InferenceData, or the DataTree that takes its place from ArviZ 1.0 on."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz

        groups, coords, dims = _groups(posterior)
        groups = {name: variables for name, variables in groups.items() if variables}
        attributes = {"converged": int(posterior.converged), "reason": posterior.reason, "seed": posterior.seed}
        if int(arviz.__version__.split(".")[0]) >= 1:
            data = arviz.from_dict(groups, coords=coords, dims=dims)
            data.attrs.update(attributes)
            return data
        old: Any = arviz.from_dict
        data = old(**groups, coords=coords, dims=dims)
        data.attrs.update(attributes)
        return data


def save(posterior: PosteriorDraws, path: Path) -> Path:
    """Write netCDF to a temporary file beside ``path`` and rename it."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        to_inference_data(posterior).to_netcdf(str(temporary), engine="h5netcdf")
    return path


def draws_in(path: Path) -> dict[str, FloatArray]:
    """Return the draws of each parameter in a file, all chains after each other; InputError if it has none."""
    try:
        posterior = load(path)["posterior"]
    except (OSError, KeyError, ValueError):
        raise InputError("is no posterior as aero-bayes or ArviZ writes it (netCDF with a group posterior)") from None
    return {str(n): np.asarray(posterior[n], float).ravel() for n in posterior.data_vars if posterior[n].ndim == 2}


def load(path: Path) -> Any:
    """Read back what :func:`save` wrote."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz

        reader: Any = arviz.from_netcdf
        return reader(str(path), engine="h5netcdf")
