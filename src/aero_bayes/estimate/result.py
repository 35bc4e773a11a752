"""The result of a fit: values, intervals, noise and curves, and what a user may do with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from aero_bayes.arguments import require_type
from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise_floor import noise_floors
from aero_bayes.data.recording import Recording
from aero_bayes.display import with_unit
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.diagnosis import Diagnosis, diagnose
from aero_bayes.estimate.exports import (
    OtherTools,
    ValueTrial,
    chosen_estimates,
    noise_table,
    process_noise_table,
    trials_sentence,
)
from aero_bayes.estimate.global_search import StageReport
from aero_bayes.estimate.identifiability import ROUNDED, Estimate, Identifiability, estimates_html
from aero_bayes.estimate.intervals import Laplace, band_factors, laplace_estimates
from aero_bayes.estimate.levenberg_marquardt import FitSettings, Stop
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.log_posterior import CurvatureAdjustment, JointLogPosterior, LogPosterior, NoiseLayout
from aero_bayes.estimate.modes import Mode, modes_sentence
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.noise_estimation import Sensor
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.prediction import FittedPredictor
from aero_bayes.estimate.residual_tests import ResidualReport, check_residuals
from aero_bayes.estimate.simulate import simulate
from aero_bayes.estimate.swarm import SwarmResult, SwarmSummary
from aero_bayes.figures import HasPage, Picture, drawn
from aero_bayes.plain import JsonNumber, JsonTable, picked, plain
from aero_bayes.simulation.interface import Outcome, Simulator, SmoothedStates

Json = dict[str, object]


def rms_by_output(residuals: Sequence[FloatArray], outputs: Sequence[str]) -> dict[str, float]:
    """Compute the root mean square of residuals (n, m) by output; outputs without readings are left out."""
    squares = np.concatenate(list(residuals)) ** 2
    count = np.isfinite(squares).sum(axis=0)
    sizes = np.sqrt(np.nansum(squares, axis=0) / np.maximum(count, 1))
    return {o: float(size) for o, size, n in zip(outputs, sizes, count, strict=True) if n}


def parameter_draws(
    laplace: Laplace, parameters: ParameterSet, values: FloatArray, columns: Sequence[int], draws: int, seed: int
) -> FloatArray:
    """Draw free and noise parameters in SI units from the Gaussian approximation, shape (draws, d)."""
    points, free = laplace.draw(draws, np.random.default_rng(seed)), list(columns)
    low, high = (bound[free] for bound in parameters.box)
    coordinates = np.tile(parameters.to_search(values), (draws, 1))
    coordinates[:, free] = np.clip(points[:, : len(free)], low, high)
    return np.concatenate([parameters.from_search(coordinates)[:, free], np.exp(points[:, len(free) :])], axis=1)


class LocalJson(JsonTable):
    """The bounded local search."""

    iterations: int
    reason: str


class FitJson(JsonTable):
    """The best fit; ``rms`` by role and output, ``interpolation`` of each input between its samples.

    ``start_levels`` are the log-posteriors at which local fits from several starts ended, on fewer samples.
    ``values`` are the listed values of parameters that were each fitted, likeliest first."""

    cost_eq6: JsonNumber = None
    rms: dict[str, dict[str, JsonNumber]] = Field(default_factory=dict)
    interpolation: dict[str, Literal["hold", "linear"]] = Field(default_factory=dict)
    log_likelihood: JsonNumber = None
    log_posterior: JsonNumber = None
    bic: JsonNumber = None
    stages: list[StageReport] = Field(default_factory=list)
    pso: SwarmSummary | None = None
    modes: list[Mode] = Field(default_factory=list)
    values: list[ValueTrial] = Field(default_factory=list)
    local: LocalJson | None = None
    start_levels: list[JsonNumber] = Field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Fit(OtherTools, HasPage):
    """A fitted calibration.

    Parameters
    ----------
    calibration : Calibration
    optimum : Optimum
        Where the search ended, over the free columns.
    laplace : Laplace
        Gaussian approximation of the posterior of free and noise parameters in search coordinates.
    residuals : tuple of ndarray, shape (n, m)
        Measured minus fitted outputs of each recording.
    outcomes : mapping of Outcome to int
        How many simulations ended how.
    values : ndarray, shape (p,)
        SI values of all parameters of the calibration.
    free : tuple of int
        Columns that were fitted; the others keep their start.
    series : tuple of Series
        What was compared, by recording and output, in the order of ``optimum``.
    identifiability : Identifiability
    widening : CurvatureAdjustment, optional
        Widens the likelihood where a residual is not noise.
    log_posterior : float
    fitted : tuple of ndarray, shape (n, m)
        Outputs at the fit, of each recording.
    stages : tuple of StageReport
        Where each stage of the local search ended.
    swarm : SwarmResult, optional
    iterations : int
        Of the local search.
    warnings : tuple of str
        Reasons why intervals may be wrong.
    seconds : float
    settings : FitSettings
        How it was fitted.
    sensors : mapping of str to Sensor
        Encoder counts, by output.
    states : tuple of SmoothedStates
        With process noise, the states of each recording given all its readings, in the order of the model's states.
    modes : tuple of Mode
        Other optima that fit about as well as the one reported.
    solver_difference : mapping of str to float
        RMS by which each output moves at ten times tighter tolerances of the solver, in its SI unit.
    solver_shift : mapping of str to float
        By how many of its standard deviations each free parameter moves with them, to first order.
    rounding_shift : mapping of str to float
        The same for widths over which the model rounds a corner, such as the change of sign of dry friction, if they
        were zero; nothing where it has none.
    start_levels : tuple of float
        Log-posterior of the local fit from each start of the search, on fewer samples and under white noise.
    failed_intervals : mapping of str to str
        What is wrong with an interval that takes the model as linear, by parameter.
    trials : tuple of ValueTrial
        Values that were listed for parameters and each fitted, likeliest first; the first are those of this fit.

    Examples
    --------
    >>> fit["k"].unit, fit["k"].q05 < fit["k"].value == float(fit["k"])
    ('N/m', True)
    >>> list(fit.parameters)[:2]
    ['k', 'd']
    >>> fit.outputs, fit.unidentified, fit.warnings[0].split(":")[0]
    (('position',), (), 'The model does not explain position')
    >>> fit.rms == {"position": fit.rms_by_recording["train"]["position"]}  # m
    True
    >>> bool(np.isclose(fit.cost_eq6, recording.rows * fit.rms["position"] ** 2))
    True
    >>> fit.noise["position"].sd == fit.noise_table()["position"]["sd"] == fit.to_dict()["noise"]["position"]["sd"]
    True
    >>> fit.bic > -2 * fit.log_likelihood and fit.failures["completed"] > 0
    True
    >>> fit.reason.name, str(fit["k"].status), fit["k"].note, fit["k"].recording
    ('CONVERGED', 'identified', '', '')
    >>> fit.modes, fit.modes_sentence, fit.trials_sentence  # one answer, and no listed values
    ((), '', '')
    >>> from aero_bayes.simulation import open_simulator
    >>> with open_simulator(fit.calibration.problem(), workers=0) as simulator:
    ...     target, joint = fit.target(simulator), fit.joint_target(simulator)
    ...     target.free, joint.target.free
    ((0, 1), (0, 1))
    >>> [report.verdict for report in fit.reports], list(fit.floors)
    (['structured'], [('train', 'position')])
    >>> fit.covariance.shape
    (2, 2)
    >>> [row.cause for row in fit.diagnosis if row.found]
    ['model']
    """

    calibration: Calibration
    optimum: Optimum
    laplace: Laplace
    residuals: tuple[FloatArray, ...]
    outcomes: Mapping[Outcome, int]
    values: FloatArray
    free: tuple[int, ...]
    series: tuple[Series, ...]
    identifiability: Identifiability
    widening: CurvatureAdjustment | None
    log_posterior: float
    fitted: tuple[FloatArray, ...]
    stages: tuple[StageReport, ...]
    swarm: SwarmResult | None
    iterations: int
    warnings: tuple[str, ...]
    seconds: float
    settings: FitSettings = field(default_factory=FitSettings)
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    states: tuple[SmoothedStates, ...] = ()
    modes: tuple[Mode, ...] = ()
    solver_difference: Mapping[str, float] = field(default_factory=dict)
    solver_shift: Mapping[str, float] = field(default_factory=dict)
    rounding_shift: Mapping[str, float] = field(default_factory=dict)
    start_levels: tuple[float, ...] = ()
    trials: tuple[ValueTrial, ...] = ()
    failed_intervals: Mapping[str, str] = field(default_factory=dict)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that were fitted, length m."""
        return self.calibration.data.outputs

    @property
    def noise(self) -> Mapping[str, OutputNoise]:
        """Noise of each output."""
        return self.optimum.noise

    @property
    def covariance(self) -> FloatArray:
        """Of the free columns, then of the noise, in search coordinates."""
        return self.laplace.covariance

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm of the likelihood at the fit."""
        return self.optimum.log_likelihood

    @property
    def reason(self) -> Stop:
        """Why the search ended."""
        return self.optimum.reason

    @property
    def cost_eq6(self) -> float:
        """Sum of squared errors (the paper's Eq. 6)."""
        return float(sum(np.nansum(r**2) for r in self.residuals))

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square error by output over all recordings."""
        return rms_by_output(self.residuals, self.outputs)

    @property
    def rms_by_recording(self) -> Mapping[str, Mapping[str, float]]:
        """Root mean square error in the output's SI unit, by recording and output."""
        pairs = zip(self.calibration.data.names, self.residuals, strict=True)
        return {name: rms_by_output([residual], self.outputs) for name, residual in pairs}

    @property
    def bic(self) -> float:
        """Bayesian information criterion, free and noise parameters counted (smaller is better)."""
        return -2.0 * self.log_likelihood + len(self.laplace.mean) * math.log(self.calibration.data.count)

    @property
    def failures(self) -> dict[str, int]:
        """Simulations by how they ended."""
        return {outcome.key: count for outcome, count in self.outcomes.items()}

    def target(self, simulator: Simulator) -> LogPosterior:
        """Return the log-posterior over the free parameters, through a simulator of the calibration's problem."""
        return LogPosterior(self.calibration, simulator, self.values, self.free, widening=self.widening)

    def joint_target(self, simulator: Simulator) -> JointLogPosterior:
        """Return the log-posterior over free and noise parameters, through a ``simulator`` of the same problem."""
        return JointLogPosterior(self.target(simulator), NoiseLayout.of(self.calibration.data, self.noise))

    @cached_property
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter with its Laplace interval, the model's fixed ones included."""
        table = laplace_estimates(self.calibration, self.values, self.free, self.identifiability, self.laplace)
        wrong = {name: note for name, note in self.failed_intervals.items() if table[name].q05 is not None}
        # An interval that is wider by this than by the noise says so.
        table |= {n: table[n].with_note(ROUNDED) for n, s in self.rounding_shift.items() if s > 1.0 and table[n].sd}
        table |= {name: table[name].with_failed_interval(note) for name, note in wrong.items()}
        return table | chosen_estimates(self.trials)

    @cached_property
    def floors(self) -> dict[tuple[str, str], float]:
        """Noise floors by recording and output, where they are known."""
        return noise_floors(self.calibration.data.recordings, self.outputs)

    @cached_property
    def reports(self) -> tuple[ResidualReport, ...]:
        """What is left of each output of each recording, with its tests."""
        return check_residuals(self.calibration, self.series, self.optimum, self.floors)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """What may be behind a residual that is not noise: data, solver, search, noise, model, in this order."""
        return diagnose(self)

    @cached_property
    def verdict(self) -> str:
        """Whether the model explains the recordings, and what else to look at, in a line."""
        name, model = self.calibration.model.name, self.diagnosis["model"]
        told = f"{name} explains the recordings down to the noise."
        if model.found:
            left = f"{model.what[:1].lower()}{model.what[1:]}".removesuffix(".").replace("`", "")
            told = f"{name} does not explain the recordings: {left} ({model.where})."
        row = next((r for r in self.diagnosis if r.found and r.cause not in ("noise", "model")), None)
        return told if row is None else f"{told} What may come from the {row.cause}: {row.sentence}"

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Parameters that were left at their start since the data does not show them."""
        names, steps = self.calibration.parameters.names, self.identifiability.in_steps
        return tuple(name for column, name in enumerate(names) if column not in self.free and name not in steps)

    @property
    def modes_sentence(self) -> str:
        """What a reader should know of other optima; empty where there is none."""
        items = self.calibration.parameters.items
        return modes_sentence(self.modes, [items[j].name for j in self.free if items[j].recording is None])

    @property
    def trials_sentence(self) -> str:
        """Which of the listed values is reported, and how much worse the others are; empty where none are listed."""
        return trials_sentence(self.trials)

    def noise_table(self) -> dict[str, Json]:
        """Write the noise by output: ``sd`` and lag-one ``rho`` at the sample interval, and what they are made of."""
        return noise_table(self.calibration.data, self.noise)

    def to_dict(self) -> Json:
        """Return the keys of result.json that a fit fills."""
        found: Json = plain(
            {
                "parameters": self.parameters,
                "noise": self.noise_table(),
                "process_noise": process_noise_table(self.calibration.process, self.parameters),
                "sensors": self.sensors,
                "fit": picked(
                    FitJson,
                    self,
                    rms={"train": self.rms},
                    interpolation=self.calibration.data.interpolation,
                    pso=self.swarm,
                    values=self.trials,
                    local=picked(LocalJson, self),
                ),
                "identifiability": self.identifiability.to_dict(self.unidentified),
                "failures": self.failures,
                "diagnosis": self.diagnosis.rows,
                "warnings": self.warnings,
                "seconds": self.seconds,
            }
        )
        return found

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
            were, and starts at its own first readings, off by as much as theirs were, or where the fit estimates the
            initial state, as its own beginning tells; without readings, where the model starts.
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
        return simulate(self.calibration, self.values, inputs, self.noise, parameters=parameters, start=start)

    @cached_property
    def predictor(self) -> FittedPredictor:
        """Predicts recordings from draws of parameters; the width of its bands comes from readings that are left out.

        Examples
        --------
        >>> bool(fit.predictor.band_factors[0] >= 1.64)  # standard deviations
        True
        """
        covariance = self.laplace.covariance[: len(self.free), : len(self.free)]
        left = [y - f for y, f in zip(self.calibration.data.raw_readings, self.fitted, strict=True)]
        factors = band_factors(self.calibration, self.series, self.optimum, covariance, left)
        return FittedPredictor(self.calibration, self.values, self.free, self.noise, factors)

    def _parameter_draws(self, draws: int, seed: int) -> FloatArray:
        return parameter_draws(self.laplace, self.calibration.parameters, self.values, self.free, draws, seed)

    def plot(self, recording: str | None = None, *, dark: bool = False) -> Picture:
        """Draw a recording, the fitted outputs and the residuals.

        Parameters
        ----------
        recording : str, optional
            Name of a fitted recording; the first by default.
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture
            Dashed lines: twice the noise floor, between which noise alone leaves 95 % of samples.

        Raises
        ------
        InputError
            For a recording that was not fitted.

        Examples
        --------
        >>> len(fit.plot().panels)  # the force, the position, what is left of it
        3
        """
        return drawn("run_picture", self, recording, dark=dark)

    def _repr_html_(self) -> str:
        caption = f"{self.calibration.model.name}: {self.reason.value}"
        return estimates_html(self.parameters, caption, (self.verdict, *self.warnings))

    def __repr__(self) -> str:
        cells = ", ".join(with_unit(f"{n}={e.value:.4g}", e.unit) for n, e in self.parameters.items())
        return f"<Fit {self.calibration.model.name}: {cells}>"


class HasFit(Protocol):
    """What stands for a fit: the result of a loop, or a posterior."""

    @property
    def fit(self) -> Fit: ...


def fit_of(given: object) -> Fit:
    """Return a fit, or that of a loop's result or a posterior; InputError for anything else."""
    own: Fit = given if isinstance(given, Fit) else getattr(given, "fit", None) or given  # type: ignore[assignment]
    return require_type(own, Fit, "fit")
