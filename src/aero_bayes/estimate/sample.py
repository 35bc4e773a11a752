"""Sample the posterior of a fit by ensembles of walkers."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.convergence import Convergence, SampleSettings
from aero_bayes.estimate.log_posterior import JointLogPosterior
from aero_bayes.estimate.mcmc import Chain, run_chain
from aero_bayes.estimate.moves import WarpedStudentT
from aero_bayes.estimate.posterior import Posterior
from aero_bayes.estimate.prediction import predictives
from aero_bayes.estimate.result import Fit, HasFit, fit_of
from aero_bayes.estimate.sampled_modes import (
    ModeDraws,
    NearestAdjustment,
    Region,
    mixed,
    mode_fits,
    mode_rows,
    mode_shares,
)
from aero_bayes.progress import Progress, Watched, watching
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Simulator

#: Blocks of time whose density is given.
_BLOCKS = 2000


def sample(
    fit: Fit | HasFit,
    *,
    draws: int | None = None,
    chains: int | None = None,
    settings: SampleSettings | None = None,
    seed: int = 1,
    workers: int | None = None,
    checkpoint: Checkpoint | Path | str | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Draw from the posterior of physical parameters, nuisances and noise together.

    Parameters
    ----------
    fit : Fit or LoopResult
        Of a loop's result the model that came out is sampled.
    draws, chains : int, optional
        Draws that each chain keeps, and how many chains, four at least; as ``settings`` say by default. A chain is an
        ensemble of walkers.
    settings : SampleSettings, optional
    seed : int
    workers : int, optional
        Worker processes; all cores by default.
    checkpoint : Checkpoint or path, optional
        File to resume from and to keep up to date.
    progress : callable, optional
        Told a phase, how far it is (0 to 1), and a line of text; where it returns True, sampling ends with the draws so
        far, which have not converged. By default a bar in a notebook, where an interrupt ends it likewise.

    Returns
    -------
    Posterior
        Draws in SI units, by ensemble, with their convergence.

    Raises
    ------
    CannotFinishError
        If no starting point of finite density can be found, or it is ended before burn-in was over.

    Examples
    --------
    >>> settings = aero_bayes.SampleSettings(max_steps=20)  # too few to converge
    >>> short = aero_bayes.sample(fit, settings=settings, workers=0)
    >>> short.converged, short.draws.shape[0]
    (False, 4)
    >>> "F_c" in aero_bayes.sample(loop, settings=settings, workers=0).names  # of the model that came out
    True
    """
    settings = settings or SampleSettings()
    settings = replace(settings, draws=draws or settings.draws, ensembles=chains or settings.ensembles)
    if settings.ensembles < 4:
        raise InputError(f"chains: {settings.ensembles} chains cannot be held against each other; expected 4 or more")
    fit = fit_of(fit)
    with ExitStack() as stack:
        # Simulations occupy every core; BLAS threads for matrices of a dozen rows would only fight them for it.
        stack.enter_context(threadpool_limits(limits=1, user_api="blas"))
        simulator = stack.enter_context(open_simulator(fit.calibration.problem(), workers))
        return _sample(fit, settings, seed, checkpoint, stack.enter_context(watching(progress)), simulator)


def _sample(
    fit: Fit,
    settings: SampleSettings,
    seed: int,
    checkpoint: Checkpoint | Path | str | None,
    progress: Watched,
    simulator: Simulator,
) -> Posterior:
    began = time.perf_counter()
    fits = mode_fits(fit, simulator) if fit.modes else (fit,)
    joints = [one.joint_target(simulator) for one in fits]
    regions = [Region(joint, fits, k) for k, joint in enumerate(joints)]
    keys = [digest(f.calibration.identity, f.free, f.values, f.noise) for f in fits]
    each = replace(settings, max_minutes=settings.max_minutes / len(fits))
    chains = [
        run_chain(
            joint if len(fits) == 1 else region,
            WarpedStudentT.of(one.laplace.mean, one.laplace.covariance, settings.dof, joint.axes),
            each, seed, checkpoint=checkpoint, identity=key, progress=progress,
        )
        for one, joint, region, key in zip(fits, joints, regions, keys, strict=True)
    ]  # fmt: skip
    _refuse_unsettled(chains, settings, progress)
    rng = np.random.default_rng([seed, 1])
    points, density = _thin(chains[0], settings.draws)
    told: list[ModeDraws] = []
    if len(fits) > 1:
        shares = mode_shares(fits, regions, chains, rng)
        points, density, counts = mixed([_thin(chain, settings.draws) for chain in chains], shares, rng)
        told = mode_rows(fits, chains, shares, counts)
        joints[0].target.widening = NearestAdjustment.of_fits(fits)
    joint = joints[0]
    count = max(1, settings.predictive // len(points))
    rows = np.unique(np.linspace(0, points.shape[1] - 1, count).astype(np.int64))
    target, drawn = joint.target, points[:, rows].reshape(-1, points.shape[-1])
    own, noise = drawn[:, : len(target.free)], joint.layout.unpack(drawn[:, len(target.free) :])[:, 0]
    predictive = predictives(
        target.calibration, simulator, target.values(own), noise, fit.predictor.band_factors, rng,
        read=target.calibration.data.measured, blocks=_BLOCKS,
        likely=None if target.widening is None else target.values(target.widening(own)),
    )  # fmt: skip
    short = [f"answer {k + 1} of {len(chains)}: {c.reason}" for k, c in enumerate(chains) if not c.converged]
    steps = min(chain.points.shape[1] for chain in chains)
    found = [chain.diagnoses for chain in chains]
    trace = np.concatenate([chain.points[:, :steps].mean(axis=2) for chain in chains])
    return Posterior(
        fit=fit,
        names=joint.names,
        draws=_physical(joint, points),
        log_posterior=density,
        trace=_physical(joint, trace),
        diagnoses=dict(zip(joint.names, map(Convergence.worst, zip(*found, strict=True)), strict=True)),
        predictive=predictive,
        converged=all(chain.converged for chain in chains),
        reason=short[0] if short and len(chains) > 1 else chains[0].reason,
        acceptance=float(np.mean([chain.acceptance for chain in chains])),
        steps=steps,
        walkers=chains[0].points.shape[2],
        evaluations=sum(chain.evaluations for chain in chains),
        outcomes=dict(sum((Counter(one.target.outcomes) for one in joints), Counter())),
        seconds=max(sum(chain.seconds for chain in chains), time.perf_counter() - began),
        seed=seed,
        mode_draws=tuple(told),
    )


def _refuse_unsettled(chains: Sequence[Chain], settings: SampleSettings, progress: Watched) -> None:
    """Raise CannotFinishError if a chain ended before there were draws to look at."""
    if any(chain.points.shape[1] < 8 for chain in chains):
        cause = f"the time limit of {settings.max_minutes:g} minutes passed"
        cause = "sampling was interrupted" if progress.asked_to_end else cause
        raise CannotFinishError(f"{cause} before the sampler had settled")


def _thin(chain: Chain, draws: int) -> tuple[FloatArray, FloatArray]:
    """Take at most ``draws`` points of each ensemble, evenly over steps and walkers: (e, draws, d) and (e, draws)."""
    ensembles, steps, walkers, d = chain.points.shape
    flat = chain.points.reshape(ensembles, steps * walkers, d)
    rows = np.unique(np.linspace(0, steps * walkers - 1, min(draws, steps * walkers)).astype(np.int64))
    return flat[:, rows], chain.log_density.reshape(ensembles, -1)[:, rows]


def _physical(joint: JointLogPosterior, points: FloatArray) -> FloatArray:
    free = len(joint.target.free)
    return np.concatenate(
        [joint.target.parameters.from_search(points[..., :free]), np.exp(points[..., free:])], axis=-1
    )
