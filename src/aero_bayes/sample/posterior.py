"""The posterior: draws in physical units, what they say of each parameter, and how far they can be trusted."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from aero_bayes.arguments import one
from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.data import Recording
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Status, status_of
from aero_bayes.estimate.result import (
    Estimate,
    Fit,
    Json,
    estimates_frame,
    estimates_html,
    fixed_parameters,
    named_estimate,
    noise_table,
)
from aero_bayes.estimate.target import JointTarget
from aero_bayes.sample.diagnostics import Diagnosis
from aero_bayes.sample.mcmc import Chain, SampleSettings, run
from aero_bayes.sample.moves import WarpedStudentT
from aero_bayes.sample.predictive import Predictive, predict
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation.interface import Outcome, Simulator

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from aero_bayes.predict import RecordingPrediction

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float, str], None]


@dataclass(frozen=True, eq=False)
class Posterior:
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
    trace : ndarray, shape (ensembles, steps, d)
        Mean over the walkers of each ensemble after each step, in SI units, for trace plots.
    diagnoses : mapping of str to Diagnosis
    predictive : tuple of Predictive
        One a recording.
    converged : bool
        False unless every criterion of the settings was met.
    reason : str
        Which was not.
    acceptance : float
        Share of proposals that were taken.
    steps, walkers, evaluations : int
        Steps of the kept chain, walkers of an ensemble, points at which the density was computed.
    outcomes : mapping of Outcome to int
        How many simulations ended how.
    seconds : float
    seed : int

    Examples
    --------
    >>> posterior.samples("k").shape == (posterior.draws.shape[0] * posterior.draws.shape[1],)
    True
    >>> entry = posterior.parameters["k"]
    >>> bool(entry.q05 < np.median(posterior.samples("k")) < entry.q95), entry.unit
    (True, 'N/m')
    >>> posterior.r_hat_max < 1.2 and min(posterior.ess_bulk_min, posterior.ess_tail_min) > 100 and posterior.tau > 0
    True
    >>> posterior.noise["position"].sd > 0, len(posterior.warnings) >= len(posterior.fit.warnings)
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
    trace: FloatArray
    diagnoses: Mapping[str, Diagnosis]
    predictive: tuple[Predictive, ...]
    converged: bool
    reason: str
    acceptance: float
    steps: int
    walkers: int
    evaluations: int
    outcomes: Mapping[Outcome, int]
    seconds: float
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

    def __getitem__(self, name: str) -> Estimate:
        return named_estimate(self.parameters, name)

    def samples(self, name: str) -> FloatArray:
        """Draws of one parameter by ``name`` over all ensembles, in its SI unit, shape (ensembles * draws,)."""
        return self.draws[:, :, self.names.index(name)].ravel()

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter: median, standard deviation, quantiles; the model's fixed ones included."""
        table: dict[str, Estimate] = {}
        prior_sd = dict(
            zip(self.calibration.parameters.names, self.calibration.parameters.prior_sd().tolist(), strict=True)
        )
        for name, estimate in self.fit.parameters.items():
            if name not in self.names:
                table[name] = estimate
                continue
            item = self.calibration.parameters[name]
            x = self.samples(name)
            axis = np.log(x) if item.scale == "log" else x / (item.upper - item.lower)
            ratio = float(np.std(axis)) / prior_sd[name]
            q05, q50, q95 = np.quantile(x, [0.05, 0.5, 0.95]).tolist()
            if estimate.status is Status.AT_BOUND:
                table[name] = estimate
                continue
            base = replace(estimate, value=q50, status=self.fit.identifiability.capped(name, status_of(ratio)), note="")
            if base.status is Status.UNIDENTIFIED:
                table[name] = replace(
                    base, sd=None, q05=None, q50=None, q95=None, note="the data says no more of it than the prior"
                )
            else:
                table[name] = replace(base, sd=float(np.std(x)), q05=q05, q50=q50, q95=q95)
        return table | fixed_parameters(self.calibration)

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
        """The keys of result.json that a posterior fills, those of its fit included."""
        base = self.fit.to_dict()
        failures = {o.key: self.fit.outcomes.get(o, 0) + self.outcomes.get(o, 0) for o in Outcome}
        return base | {
            "parameters": {name: e.to_dict() for name, e in self.parameters.items()},
            "noise": noise_table(self.calibration, self.noise),
            "mcmc": {
                "ensembles": self.draws.shape[0],
                "draws": self.steps,
                "walkers": self.walkers,
                "tau": self.tau,
                "r_hat_max": self.r_hat_max,
                "ess_bulk_min": self.ess_bulk_min,
                "ess_tail_min": self.ess_tail_min,
                "seconds": self.seconds,
                "converged": self.converged,
                "reason": self.reason,
                "acceptance": self.acceptance,
                "evaluations": self.evaluations,
                "per_parameter": {
                    name: {"r_hat": d.r_hat, "ess_bulk": d.ess_bulk, "ess_tail": d.ess_tail, "tau": d.tau}
                    for name, d in self.diagnoses.items()
                },
            },
            "failures": failures,
            "warnings": list(self.warnings),
            "seconds": self.fit.seconds + self.seconds,
        }

    def save(self, path: Path | str) -> Path:
        """Write ArviZ InferenceData (netCDF) to ``path``, whole or not at all."""
        from aero_bayes.sample.inferencedata import save

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
        from aero_bayes.sample.inferencedata import to_inference_data

        return to_inference_data(self)

    def predict(
        self,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        draws: int = 200,
        seed: int = 1,
        workers: int | None = 0,
    ) -> RecordingPrediction:
        """What new readings would be, for a recording whether it was fitted or not.

        Parameters
        ----------
        inputs : Recording or mapping of str to array_like, shape (n,)
            As :meth:`Fit.simulate` takes them.
        draws : int
            Draws that are simulated.
        seed : int
            Of the noise that is drawn.
        workers : int, optional
            Worker processes; none beside this one by default, None for all cores.

        Returns
        -------
        RecordingPrediction
            Median, 90 % bands with noise and without, and how the readings lie in them.

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
        """
        from aero_bayes.predict import predict

        return predict(self, inputs, draws=draws, seed=seed, workers=workers)

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
        ax : matplotlib.axes.Axes, optional
            Whose place in a larger figure it takes.
        figure : matplotlib.figure.Figure, optional
            To draw into; a new one by default.
        dark : bool
            Colours for a dark ground.

        Raises
        ------
        InputError
            For a parameter without draws.

        Examples
        --------
        >>> len(posterior.plot(["k", "d"]).axes)
        4
        """
        from aero_bayes.plots import pairs_figure

        units = {name: entry.unit for name, entry in self.parameters.items()}
        by_name = {name: self.draws[:, :, j] for j, name in enumerate(self.names)}
        return pairs_figure(by_name, units, parameters, figure=ax or figure, dark=dark)

    def plot_bands(
        self, recording: str | None = None, *, ax: Axes | None = None, figure: Figure | None = None, dark: bool = False
    ) -> Figure:
        """Draw a fitted recording within the 90 % band of new readings.

        Parameters
        ----------
        recording : str, optional
            Name of a fitted recording; the first by default.
        ax : matplotlib.axes.Axes, optional
            Whose place in a larger figure it takes.
        figure : matplotlib.figure.Figure, optional
            To draw into; a new one by default.
        dark : bool
            Colours for a dark ground.

        Raises
        ------
        InputError
            For a recording that was not fitted.

        Examples
        --------
        >>> posterior.plot_bands().savefig("bands.png")
        """
        from aero_bayes.plots import bands_figure

        return bands_figure(self, recording, figure=ax or figure, dark=dark)

    def to_frame(self) -> pandas.DataFrame:
        """A row for each parameter: median, standard deviation, quantiles (SI), unit, status, prior, bounds.

        Examples
        --------
        >>> bool(posterior.to_frame().loc["k", "q05"] < posterior.to_frame().loc["k", "q95"])
        True
        """
        return estimates_frame(self.parameters)

    def _repr_html_(self) -> str:
        caption = f"{self.calibration.model.name}: R-hat {self.r_hat_max:.4f}, ESS {self.ess_bulk_min:.0f}"
        return estimates_html(self.parameters, caption, self.warnings)

    def __repr__(self) -> str:
        state = "converged" if self.converged else f"not converged ({self.reason})"
        return (
            f"<Posterior {self.calibration.model.name}: {self.draws.shape[0]} ensembles, {self.steps} steps, {state}>"
        )


def sample(
    fit: Fit,
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
    fit : Fit
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
        Told a phase, how far it is (0 to 1), and a line of text.

    Raises
    ------
    CannotFinishError
        If no starting point of finite density can be found.

    Examples
    --------
    >>> settings = aero_bayes.SampleSettings(max_steps=20)  # too few to converge
    >>> short = aero_bayes.sample(fit, settings=settings, workers=0)
    >>> short.converged, short.draws.shape[0]
    (False, 4)
    """
    from aero_bayes.simulation import open_simulator

    settings = settings or SampleSettings()
    settings = replace(settings, draws=draws or settings.draws, ensembles=chains or settings.ensembles)
    if settings.ensembles < 4:
        raise InputError(f"chains: {settings.ensembles} chains cannot be held against each other; expected 4 or more")
    engine: Literal["native", "fmpy"] = "fmpy" if one(fit, Fit, "fit").engine == "fmpy" else "native"
    with ExitStack() as stack:
        # Simulations occupy every core; BLAS threads for matrices of a dozen rows would only fight them for it.
        stack.enter_context(threadpool_limits(limits=1, user_api="blas"))
        simulator = stack.enter_context(open_simulator(fit.calibration.problem(), engine=engine, workers=workers))
        return _sample(fit, settings, seed, checkpoint, progress, simulator)


def _sample(
    fit: Fit,
    settings: SampleSettings,
    seed: int,
    checkpoint: Checkpoint | Path | str | None,
    progress: Progress | None,
    simulator: Simulator,
) -> Posterior:
    began = time.perf_counter()
    joint = fit.joint_target(simulator)
    proposal = WarpedStudentT.of(fit.laplace.mean, fit.laplace.covariance, settings.dof, joint.axes)
    chain = run(joint, proposal, settings, seed, checkpoint=checkpoint, identity=identity(fit), progress=progress)
    if chain.points.shape[1] < 8:
        raise CannotFinishError(f"the time limit of {settings.time_limit:g} s passed before the sampler had settled")
    rng = np.random.default_rng([seed, 1])
    points, density = _thin(chain, settings.draws)
    each = max(1, settings.predictive // len(points))
    rows = np.unique(np.linspace(0, points.shape[1] - 1, each).astype(np.int64))
    predictive = predict(joint, points[:, rows].reshape(-1, points.shape[-1]), rng)
    return Posterior(
        fit=fit,
        names=joint.names,
        draws=_physical(joint, points),
        log_posterior=density,
        trace=_physical(joint, chain.points.mean(axis=2)),
        diagnoses=dict(zip(joint.names, chain.diagnoses, strict=True)),
        predictive=predictive,
        converged=chain.converged,
        reason=chain.reason,
        acceptance=chain.acceptance,
        steps=chain.points.shape[1],
        walkers=chain.points.shape[2],
        evaluations=chain.evaluations,
        outcomes=dict(joint.target.outcomes),
        seconds=max(chain.seconds, time.perf_counter() - began),
        seed=seed,
    )


def identity(fit: Fit) -> str:
    """Hash of what makes a posterior this one: model, data, parameters, noise kinds."""
    return digest(fit.calibration.identity, fit.free, fit.values, fit.noise)


def _thin(chain: Chain, draws: int) -> tuple[FloatArray, FloatArray]:
    """At most ``draws`` points of each ensemble, evenly over steps and walkers: (e, draws, d) and (e, draws)."""
    ensembles, steps, walkers, d = chain.points.shape
    flat = chain.points.reshape(ensembles, steps * walkers, d)
    rows = np.unique(np.linspace(0, steps * walkers - 1, min(draws, steps * walkers)).astype(np.int64))
    return flat[:, rows], chain.log_density.reshape(ensembles, -1)[:, rows]


def _physical(joint: JointTarget, points: FloatArray) -> FloatArray:
    free = len(joint.target.free)
    return np.concatenate(
        [joint.target.parameters.from_search(points[..., :free]), np.exp(points[..., free:])], axis=-1
    )
