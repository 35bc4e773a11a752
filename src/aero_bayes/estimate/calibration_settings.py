"""Settings of how recordings are turned into a fitting problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from aero_bayes.estimate.initial_states import StartPolicy
from aero_bayes.simulation.interface import Interpolation, SolverSettings

DelayPolicy = Literal["auto", "free", "none"]


@dataclass(frozen=True)
class CalibrationSettings:
    """How recordings are turned into a problem.

    Parameters
    ----------
    outputs : tuple of str, optional
        Outputs to fit; all that were recorded and that the model has by default.
    delay : {"auto", "free", "none"}
        A delay of the inputs: of all by one time, a nuisance parameter of each recording, or of single ones, a
        parameter of the rig. ``auto`` frees it where the input changes and the samples are closer than five times
        ``max_input_delay``.
    max_input_delay : float or mapping of str to float, optional
        Upper bound of the delay in s, or of the delays of single inputs by name; one below zero is a lower bound, for
        an input that acts before it is logged. A delay moves the recorded signal, so that it is exact however long. By
        default what the model's package declares, and where it declares none there
        is no delay.
    initial_states : {"auto", "reading", "estimated"}
        Initial values of states, see :class:`StartPolicy`.
    may_start_at_rest : tuple of str, optional
        Outputs whose state may start anywhere, at rest; other states start at the model's own values unless the
        recording begins in mid-motion. By default what the model's package declares, else every output that is a
        state.
    most_readings : int, optional
        Readings of an output that a recording keeps; beyond it every n-th is kept.
    keep_standstill_readings : bool
        Whether all readings of a counter at standstill are fitted. Comparisons of models use few of them.
    interpolation : {"auto", "hold", "linear"} or mapping
        Whether inputs hold from a sample to the next or run in straight lines, all of them or by name; ``auto`` lets
        the fit decide for each that moves from sample to sample (see :mod:`aero_bayes.estimate.interpolation`).
    solver : SolverSettings

    Examples
    --------
    >>> from aero_bayes.estimate import CalibrationSettings
    >>> settings = aero_bayes.FitSettings(calibration=CalibrationSettings(delay="none"))
    >>> list(aero_bayes.fit(recording, model, parameters=free, settings=settings, workers=0).parameters)
    ['k', 'd', 'position_start']
    """

    outputs: tuple[str, ...] | None = None
    delay: DelayPolicy = "auto"
    max_input_delay: float | Mapping[str, float] | None = None
    initial_states: StartPolicy = "auto"
    may_start_at_rest: tuple[str, ...] | None = None
    most_readings: int | None = None
    keep_standstill_readings: bool = True
    interpolation: Literal["auto", "hold", "linear"] | Mapping[str, Interpolation] = "hold"
    solver: SolverSettings = field(default_factory=SolverSettings)
