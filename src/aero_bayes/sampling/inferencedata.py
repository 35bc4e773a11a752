"""The only module that touches ArviZ; works with 0.20 to 1.x.

A *chain* is an ensemble; its draws are taken evenly over steps and walkers. ``log_likelihood`` holds each reading
(in long recordings, blocks of a few) given all earlier ones: whitened innovations, which are independent, under the
likelihood that the posterior is made of. ``prior`` holds draws of what is searched; ``posterior_predictive`` and
``observed_data`` are thinned to some hundred sample times.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.files import whole_file
from aero_bayes.sampling.draws import PosteriorDraws


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
