"""The result of a fit: values, intervals, noise and curves, and what a user may do with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aero_bayes.diagnosis_backend import diagnosis_of
from aero_bayes.display import with_unit
from aero_bayes.estimate.calibrated_model import CalibratedModel, calibrated_model
from aero_bayes.estimate.diagnosis import Diagnosis
from aero_bayes.estimate.fitted_simulation import FittedSimulation
from aero_bayes.estimate.identifiability import Identifiability
from aero_bayes.estimate.laplace_estimates import laplace_estimates
from aero_bayes.estimate.modes import Mode, modes_sentence
from aero_bayes.estimate.noise_report import noise_table, process_noise_table
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.other_tools import OtherTools
from aero_bayes.estimate.parameter_estimates import Estimate, estimates_html
from aero_bayes.estimate.stage_report import StageReport
from aero_bayes.estimate.swarm import SwarmResult
from aero_bayes.estimate.target import CurvatureAdjustment, JointTarget, NoiseLayout, Target
from aero_bayes.estimate.value_comparison import ValueTrial, chosen_estimates, trials_sentence
from aero_bayes.plot_backend import describe_figure_parameters, plot_backend
from aero_bayes.simulation.interface import Simulator
from aero_bayes.simulation.smoothing import SmoothedStates

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
Json = dict[str, object]


@dataclass(frozen=True, eq=False)
class Fit(FittedSimulation, OtherTools):
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
    spread : CurvatureAdjustment, optional
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
    engine : {"native", "fmpy"}
        Simulation engine.
    sensors : mapping of str to dict
        Ripple and encoder counts, by output, as result.json takes them.
    states : tuple of SmoothedStates
        With process noise, the states of each recording given all its readings, in the order of the model's states.
    modes : tuple of Mode
        Other optima that fit about as well as the one reported.
    solver_difference : mapping of str to float
        RMS by which each output moves at ten times tighter tolerances of the solver, in its SI unit.
    solver_shift : mapping of str to float
        By how many of its standard deviations each free parameter moves with them, to first order.
    start_levels : tuple of float
        Log-posterior of the local fit from each start of the search, on fewer samples and under white noise.
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
    ((0, 1, 2), (0, 1, 2))
    >>> fit.covariance.shape
    (3, 3)
    >>> [row.cause for row in fit.diagnosis if row.found]
    ['model']
    """

    values: FloatArray
    free: tuple[int, ...]
    series: tuple[Series, ...]
    identifiability: Identifiability
    spread: CurvatureAdjustment | None
    log_posterior: float
    fitted: tuple[FloatArray, ...]
    stages: tuple[StageReport, ...]
    swarm: SwarmResult | None
    iterations: int
    warnings: tuple[str, ...]
    seconds: float
    engine: str = "native"
    sensors: Mapping[str, Json] = field(default_factory=dict)
    states: tuple[SmoothedStates, ...] = ()
    modes: tuple[Mode, ...] = ()
    solver_difference: Mapping[str, float] = field(default_factory=dict)
    solver_shift: Mapping[str, float] = field(default_factory=dict)
    start_levels: tuple[float, ...] = ()
    trials: tuple[ValueTrial, ...] = ()

    def target(self, simulator: Simulator) -> Target:
        """Return the log-posterior over the free parameters, through a simulator of the calibration's problem."""
        return Target(self.calibration, simulator, self.values, self.free, spread=self.spread)

    def joint_target(self, simulator: Simulator) -> JointTarget:
        """Return the log-posterior over free and noise parameters, through a ``simulator`` of the same problem."""
        return JointTarget(self.target(simulator), NoiseLayout.of(self.calibration, self.noise))

    @cached_property
    def parameters(self) -> dict[str, Estimate]:
        """Every parameter with its Laplace interval, the model's fixed ones included."""
        table = laplace_estimates(self.calibration, self.values, self.free, self.identifiability, self.laplace)
        return table | chosen_estimates(self.trials)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """What may be behind a residual that is not noise: data, solver, search, noise, model, in this order."""
        return diagnosis_of(self)

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
        """Noise by output: ``sd`` and lag-one ``rho`` at the sample interval, and what they are made of."""
        return noise_table(self.calibration, self.noise)

    def to_dict(self) -> Json:
        """Return the keys of result.json that a fit fills."""
        return {
            "parameters": {name: e.to_dict() for name, e in self.parameters.items()},
            "noise": self.noise_table(),
            "process_noise": process_noise_table(self.calibration.process, self.parameters),
            "sensors": dict(self.sensors),
            "fit": {
                "cost_eq6": self.cost_eq6,
                "rms": {"train": self.rms},
                "interpolation": self.calibration.interpolation,
                "log_likelihood": self.log_likelihood,
                "log_posterior": self.log_posterior,
                "bic": self.bic,
                "stages": [s.to_dict() for s in self.stages],
                "pso": self.swarm.to_dict() if self.swarm is not None else None,
                "modes": [{"values": m.values, "share": m.share} for m in self.modes],
                "values": [t.to_dict() for t in self.trials],
                "local": {"iterations": self.iterations, "reason": self.reason.value},
            },
            "identifiability": self.identifiability.to_dict(self.unidentified),
            "failures": self.failures,
            "diagnosis": self.diagnosis.to_list(),
            "warnings": list(self.warnings),
            "seconds": self.seconds,
        }

    @property
    def calibrated(self) -> CalibratedModel:
        """The model with all values of the fit, as Modelica; InputError where its source is not known.

        Examples
        --------
        >>> fit.calibrated.write("fitted").name
        'Rig_fitted.mo'
        """
        return calibrated_model(
            self.calibration, self.values, self.parameters, chosen=self.trials[0].modifiers if self.trials else None
        )

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

    @describe_figure_parameters
    def plot(
        self, recording: str | None = None, *, ax: Axes | None = None, figure: Figure | None = None, dark: bool = False
    ) -> Figure:
        """Draw a recording, the fitted outputs and the residuals.

        Parameters
        ----------
        recording : str, optional
            Name of a fitted recording; the first by default.

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
        return plot_backend().fit_figure(self, recording, figure=ax or figure, dark=dark)

    def _repr_html_(self) -> str:
        return estimates_html(self.parameters, f"{self.calibration.model.name}: {self.reason.value}", self.warnings)

    def __repr__(self) -> str:
        cells = ", ".join(with_unit(f"{n}={e.value:.4g}", e.unit) for n, e in self.parameters.items())
        return f"<Fit {self.calibration.model.name}: {cells}>"
