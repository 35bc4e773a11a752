"""What a fit found: typed, with units, ready for a report."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.data import Recording
from aero_bayes.display import table_html, with_unit
from aero_bayes.errors import InputError
from aero_bayes.estimate import cost as costs
from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.global_search import FittedStage
from aero_bayes.estimate.identifiability import Identifiability, Status
from aero_bayes.estimate.laplace import Laplace
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.staged import Stage
from aero_bayes.estimate.swarm import SwarmResult
from aero_bayes.estimate.target import CurvatureAdjustment, JointTarget, NoiseLayout, Target
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.sensors.whiteness import block_variance_ratio
from aero_bayes.sensors.whitening import innovations
from aero_bayes.simulation.interface import Outcome, ParameterTarget, Simulator
from aero_bayes.simulation.model import Model
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
Json = dict[str, object]
_NO_SPREAD: tuple[float | None, float | None, float | None, float | None] = (None, None, None, None)


@dataclass(frozen=True)
class Estimate:
    """One parameter as a reader sees it; spread and quantiles are None where the data says nothing of it."""

    name: str
    value: float
    sd: float | None
    q05: float | None
    q50: float | None
    q95: float | None
    unit: str
    status: Status
    description: str = ""
    prior: str = ""
    start: float | None = None
    lower: float | None = None
    upper: float | None = None
    note: str = ""
    recording: str = ""

    def __float__(self) -> float:
        return self.value

    def to_dict(self) -> Json:
        """The entry of result.json."""
        return {key: (str(v) if isinstance(v, Status) else v) for key, v in self.__dict__.items() if key != "name"}


@dataclass(frozen=True)
class StageReport:
    """Where a stage of the local search ended: cost, values and RMS error by output."""

    stage: Stage
    cost: float
    values: Mapping[str, float]
    rms: Mapping[str, float]

    def to_dict(self) -> Json:
        return {
            "parameters": list(self.stage.parameters),
            "outputs": list(self.stage.outputs),
            "cost": self.cost,
            "values": dict(self.values),
            "rms": dict(self.rms),
        }


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted calibration.

    Parameters
    ----------
    calibration : Calibration
    values : ndarray, shape (p,)
        SI values of all parameters of the calibration.
    free : tuple of int
        Columns that were fitted; the others keep their start.
    optimum : Optimum
        Where the search ended, over the free columns.
    series : tuple of Series
        What was compared, by recording and output, in the order of ``optimum``.
    identifiability : Identifiability
    laplace : Laplace
        Gaussian approximation of the posterior of free and noise parameters in search coordinates.
    spread : CurvatureAdjustment, optional
        How much wider than its likelihood the posterior is, where a residual is no noise.
    log_posterior : float
    fitted, residuals : tuples of ndarray, shape (n, m)
        Outputs at the fit, and measured minus fitted, of each recording.
    stages : tuple of StageReport
        Where each stage of the local search ended.
    swarm : SwarmResult, optional
    iterations : int
        Of the local search.
    outcomes : mapping of Outcome to int
        How many simulations ended how.
    warnings : tuple of str
        What a reader must know before trusting an interval.
    seconds : float
    engine : str
        What simulated.
    sensors : mapping of str to dict
        Ripple and encoder counts, by output, as result.json takes them.

    Examples
    --------
    >>> fit["k"].unit == "N/m", float(fit["k"]) == fit.value("k")
    (True, True)
    >>> fit.parameters["k"].unit, fit.parameters["k"].q05 < fit.value("k") == fit.named["k"]
    ('N/m', True)
    >>> fit.outputs, fit.held, fit.warnings[0].split(":")[0]
    (('position',), (), 'The model does not explain position')
    >>> fit.rms == {"position": fit.rms_by_recording["train"]["position"]}  # m
    True
    >>> bool(np.isclose(fit.cost_eq6, recording.rows * fit.rms["position"] ** 2))
    True
    >>> fit.noise["position"].sd == fit.noise_table()["position"]["sd"] == fit.to_dict()["noise"]["position"]["sd"]
    True
    >>> fit.bic > -2 * fit.log_likelihood and fit.failures["completed"] > 0
    True
    >>> fit.reason.name, str(fit.status(0)), fit.note(0), fit.own_recording(0)
    ('CONVERGED', 'identified', '', '')
    >>> from aero_bayes.simulation import open_simulator
    >>> with open_simulator(fit.calibration.problem(), workers=0) as simulator:
    ...     target, joint = fit.target(simulator), fit.joint_target(simulator)
    ...     target.free, joint.target.free
    ((0, 1, 2), (0, 1, 2))
    >>> fit.covariance.shape
    (3, 3)
    """

    calibration: Calibration
    values: FloatArray
    free: tuple[int, ...]
    optimum: Optimum
    series: tuple[Series, ...]
    identifiability: Identifiability
    laplace: Laplace
    spread: CurvatureAdjustment | None
    log_posterior: float
    fitted: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    stages: tuple[StageReport, ...]
    swarm: SwarmResult | None
    iterations: int
    outcomes: Mapping[Outcome, int]
    warnings: tuple[str, ...]
    seconds: float
    engine: str = "native"
    sensors: Mapping[str, Json] = field(default_factory=dict)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that were fitted, length m."""
        return self.calibration.outputs

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

    def target(self, simulator: Simulator) -> Target:
        """The log-posterior over the free parameters, through a simulator of the calibration's problem."""
        return Target(self.calibration, simulator, self.values, self.free, spread=self.spread)

    def joint_target(self, simulator: Simulator) -> JointTarget:
        """The log-posterior over the free and the noise parameters, through a ``simulator`` of the same problem."""
        return JointTarget(self.target(simulator), NoiseLayout.of(self.calibration, self.noise))

    @property
    def cost_eq6(self) -> float:
        """Sum of squared errors (the paper's Eq. 6)."""
        return costs.eq6(self.residuals)

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square error by output over all recordings."""
        return costs.rms_overall(self.residuals, self.outputs)

    @property
    def rms_by_recording(self) -> Mapping[str, Mapping[str, float]]:
        """Root mean square error in the output's SI unit, by recording and output."""
        return costs.rms_table(self.residuals, self.calibration.names, self.outputs)

    @property
    def bic(self) -> float:
        """Bayesian information criterion, free and noise parameters counted (smaller is better)."""
        return -2.0 * self.log_likelihood + len(self.laplace.mean) * float(np.log(self.calibration.counts.sum()))

    @property
    def failures(self) -> dict[str, int]:
        """Simulations by how they ended."""
        return {outcome.key: count for outcome, count in self.outcomes.items()}

    def __getitem__(self, name: str) -> Estimate:
        return named_estimate(self.parameters, name)

    def value(self, name: str) -> float:
        """SI value of a parameter by its ``name``; InputError for one that is not there."""
        return float(self.values[self.calibration.parameters.index(name)])

    @property
    def named(self) -> dict[str, float]:
        """SI values by name."""
        return dict(zip(self.calibration.parameters.names, self.values.tolist(), strict=True))

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter with its Laplace interval, the model's fixed ones included."""
        table = {}
        for j, item in enumerate(self.calibration.parameters):
            spread = self._spread(j) if self.status(j) in (Status.IDENTIFIED, Status.WEAK) else _NO_SPREAD
            table[item.name] = Estimate(
                item.name, float(self.values[j]), *spread, item.unit, self.status(j), item.description,
                item.prior.describe(item.unit), item.start, item.lower, item.upper, self.note(j),
                self.own_recording(item.recording),
            )  # fmt: skip
        return table | fixed_parameters(self.calibration)

    @property
    def held(self) -> tuple[str, ...]:
        """Parameters that were left at their start since the data does not show them."""
        names = self.calibration.parameters.names
        return tuple(name for column, name in enumerate(names) if column not in self.free)

    def own_recording(self, index: int | None) -> str:
        """Name of the recording with an ``index`` that a parameter has to itself; empty for all, or the only one."""
        names = self.calibration.names
        return names[index] if index is not None and len(names) > 1 else ""

    def status(self, column: int) -> Status:
        """How well the data determines a column."""
        name = self.calibration.parameters.names[column]
        if column in self.free:
            return self.identifiability.status[name]
        return Status.UNIDENTIFIED

    def note(self, column: int) -> str:
        """Why a column has no interval, if so."""
        item = self.calibration.parameters.items[column]
        if item.name in self.identifiability.no_effect:
            return "changes no recorded output; left at its start"
        if column not in self.free:
            return "not visible in this data; left at its start"
        if self.status(column) is Status.UNIDENTIFIED:
            return "the data says no more of it than the prior"
        if self.status(column) is Status.AT_BOUND:
            return "ended on a bound of its search: no interval from there; widen the bound or look at the model"
        return ""

    def _spread(self, column: int) -> tuple[float, float, float, float]:
        item, position = self.calibration.parameters.items[column], self.free.index(column)
        mean, sd = self.laplace.mean[position], self.laplace.sd[position]
        u = mean + sd * np.array([-1.6448536269514722, 0.0, 1.6448536269514722])
        slope = float(self.calibration.parameters.jacobian(self.values)[column])
        x = np.exp(u) if item.scale == "log" else u * (item.upper - item.lower)
        low, middle, high = np.clip(x, item.lower, item.upper).tolist()
        return float(sd * slope), low, middle, high

    def noise_table(self) -> dict[str, Json]:
        """Noise by output: ``sd`` and lag-one ``rho`` at the sample interval, and what they are made of."""
        return noise_table(self.calibration, self.noise)

    def to_dict(self) -> Json:
        """The keys of result.json that a fit fills."""
        swarm = self.swarm
        return {
            "parameters": {name: e.to_dict() for name, e in self.parameters.items()},
            "noise": self.noise_table(),
            "sensors": dict(self.sensors),
            "fit": {
                "cost_eq6": self.cost_eq6,
                "rms": {"train": self.rms},
                "interpolation": self.calibration.interpolation,
                "log_likelihood": self.log_likelihood,
                "log_posterior": self.log_posterior,
                "bic": self.bic,
                "stages": [s.to_dict() for s in self.stages],
                "pso": None
                if swarm is None
                else {
                    "evaluations": swarm.evaluations,
                    "history": swarm.history.tolist(),
                    "failures": swarm.failures,
                    "reason": swarm.reason,
                },
                "local": {"iterations": self.iterations, "reason": self.reason.value},
            },
            "identifiability": self.identifiability.to_dict(self.held),
            "failures": self.failures,
            "warnings": list(self.warnings),
            "seconds": self.seconds,
        }

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
            A recording, whose readings only say where it starts; or ``time`` in s and every input in its SI unit. A
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
        from aero_bayes.predict import simulate

        return simulate(self, inputs, parameters=parameters, start=start)

    @property
    def calibrated(self) -> CalibratedModel:
        """The model with all values of the fit, as Modelica; InputError where its source is not known.

        Examples
        --------
        >>> fit.calibrated.write("fitted").name
        'Rig_fitted.mo'
        """
        return calibrated_model(self.calibration, self.values, self.parameters)

    def export_fmu(self, path: Path | str) -> Path:
        """Write the FMU of the model with all values of the fit.

        Parameters
        ----------
        path : path
            The FMU; it appears whole or not at all.

        Raises
        ------
        InputError
            For a model that was given as an FMU: its values cannot be changed in there.

        Examples
        --------
        >>> fitted = aero_bayes.load_model(fit.export_fmu("Rig_fitted.fmu"))
        >>> round(fitted.parameter("k").start, 1)
        54.9
        """
        return self.calibrated.export_fmu(path)

    def plot(
        self, recording: str | None = None, *, ax: Axes | None = None, figure: Figure | None = None, dark: bool = False
    ) -> Figure:
        """Draw a recording, what the fit makes of it, and what is left.

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

        Returns
        -------
        matplotlib.figure.Figure
            Dashed lines: twice the noise floor, between which noise alone leaves 95 % of samples.

        Raises
        ------
        InputError
            For a recording that was not fitted.

        Examples
        --------
        >>> len(fit.plot().axes)  # the force, the position, what is left of it
        3
        """
        from aero_bayes.plots import fit_figure

        return fit_figure(self, recording, figure=ax or figure, dark=dark)

    def to_frame(self) -> pandas.DataFrame:
        """A row for each parameter: value, standard deviation, quantiles (SI), unit, status, prior, bounds.

        Examples
        --------
        >>> fit.to_frame().loc["k", ["unit", "status"]].to_list()
        ['N/m', 'identified']
        """
        return estimates_frame(self.parameters)

    def _repr_html_(self) -> str:
        return estimates_html(self.parameters, f"{self.calibration.model.name}: {self.reason.value}", self.warnings)

    def __repr__(self) -> str:
        cells = ", ".join(with_unit(f"{n}={e.value:.4g}", e.unit) for n, e in self.parameters.items())
        return f"<Fit {self.calibration.model.name}: {cells}>"


def named_estimate(table: Mapping[str, Estimate], name: str) -> Estimate:
    """An entry of a table of parameters; InputError with the nearest name for one that is not there."""
    if name not in table:
        raise InputError(f"no parameter {name!r}{known_names_hint(str(name), table)}")
    return table[name]


def held_because(model: Model, fixed: Collection[str]) -> dict[str, str]:
    """Why parameters of a model are not searched, by name."""
    return {name: "held at the value that the configuration gives" for name in fixed} | dict(model.declared.fixed)


def fixed_parameters(calibration: Calibration) -> dict[str, Estimate]:
    """Model parameters that nobody searched, with the reason where it is known."""
    searched = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    reasons = held_because(calibration.model, calibration.fixed)
    table = {}
    for v in calibration.model.parameters:
        value, note = calibration.fixed.get(v.name, v.start), reasons.get(v.name)
        if v.name not in searched and note is not None and value is not None:
            table[v.name] = Estimate(
                v.name, float(value), None, None, None, None, v.unit, Status.FIXED, v.description, note=note
            )
    return table


def noise_table(calibration: Calibration, noise: Mapping[str, OutputNoise]) -> dict[str, Json]:
    """Noise by output as result.json wants it."""
    interval = float(np.median(np.concatenate([np.diff(e.time) for e in calibration.experiments])))
    return {
        name: {"sd": n.sd, "rho": n.rho(interval), "sd_white": n.sd_white, "sd_ou": n.sd_ou, "tau_s": n.tau}
        for name, n in noise.items()
    }


def stage_report(end: FittedStage, parameters: ParameterSet, series: Sequence[Series]) -> StageReport:
    """A stage of an ascent as a reader sees it."""
    squares: dict[str, list[FloatArray]] = {}
    own = [s for s in series if s.output in end.stage.outputs]
    for s, residual in zip(own, end.optimum.evaluation.residual, strict=True):
        squares.setdefault(s.output, []).append(residual)
    rms = {o: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for o, parts in squares.items()}
    values = parameters.from_search(end.optimum.coordinates)
    return StageReport(end.stage, end.cost, dict(zip(parameters.names, values.tolist(), strict=True)), rms)


def structure_warnings(
    calibration: Calibration, residuals: Sequence[FloatArray], noise: Mapping[str, OutputNoise]
) -> tuple[str, ...]:
    """One sentence for each output whose residual the sensors cannot explain."""
    units = {v.name: v.unit for v in calibration.model.outputs}
    lines = []
    for k, name in enumerate(calibration.outputs):
        n, unit = noise[name], units.get(name, "")
        if n.model_error:
            lines.append(
                f"The model does not explain {name}: its residual of {n.sd:.3g} {unit} is not sensor noise. The fit "
                "weights it as least squares does. Its intervals are enlarged because the residual is not white; a "
                "systematic error of the model can still lie outside of them."
            )
            continue
        white = [innovations(e.time, r[:, k], n) for e, r in zip(calibration.experiments, residuals, strict=True)]
        excess = block_variance_ratio(np.concatenate(white))
        if excess > 2.0:
            lines.append(
                f"The residual of {name} changes more slowly than its noise model allows: averages have {excess:.1f} "
                "times the expected variance, so that its intervals are too narrow."
            )
    return tuple(lines)


def estimates_html(table: Mapping[str, Estimate], caption: str, warnings: Sequence[str] = ()) -> str:
    """A parameter table for a notebook."""
    rows = []
    for e in table.values():
        span = "" if e.q05 is None or e.q95 is None else f"{e.q05:.4g} to {e.q95:.4g}"
        rows.append((e.name, f"{e.value:.4g}", span, e.unit, str(e.status), e.prior))
    return table_html(("parameter", "value", "90 % interval", "unit", "status", "prior"), rows, caption, warnings)


def estimates_frame(table: Mapping[str, Estimate]) -> pandas.DataFrame:
    """A parameter table as a data frame, a row a parameter."""
    import pandas

    rows = {name: {**e.to_dict(), "status": str(e.status)} for name, e in table.items()}
    return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")
