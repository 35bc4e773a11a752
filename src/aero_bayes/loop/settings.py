"""Settings of the closed loop."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from aero_bayes.arguments import names_of
from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.fit_settings import FitSettings
from aero_bayes.estimate.parameters import ChosenParameters
from aero_bayes.simulation.interface import SolverSettings


@dataclass(frozen=True, repr=False)
class LoopSettings(SettingsDisplay):
    """Settings of the closed loop.

    Parameters
    ----------
    fit : FitSettings, optional
        How the first model and the extended one are fitted; by default as the fit was that is given, else by a local
        search.
    parameters : sequence of str, mapping or ParameterSet, optional
        What is fitted of the first model, as for :func:`aero_bayes.fit`; by default what the given fit found free, else
        what the model's package declares to be searched. The others may be found to have a wrong value.
    solver : SolverSettings
        Of the simulations of the loop, which compares models: it is coarser than that of a fit.
    most_readings : int
        Readings of an output that a recording keeps; beyond it every n-th is kept.
    effects : tuple of str, optional
        Ids or laws that are tried; all by default.
    exclude : tuple of str
        Ids, ports or laws that are not tried.
    require : tuple of str
        Ids of terms that have to be in the model.
    ports, laws : tuple of str, optional
        The only ports and laws that are tried; all by default.
    max_effects : int
        Terms that are added at most.
    held_out : float
        Last share of each recording that is not fitted but used as test data, if no test recording is given.
    cache : Path, optional
        Folder of FMUs that are kept between runs; by default ``fmu`` in the folder of the run, removed at the end.
    max_minutes : float
        Time limit of the search; the loop continues with what was found by then, and says so.
    max_error_ratio : float
        Largest ratio of the error on unseen data to that of the fit for a model to count as adequate.

    Examples
    --------
    >>> settings = aero_bayes.LoopSettings(parameters=("k", "d"), exclude=("F",))
    >>> settings.fitting.calibration.most_readings
    8000
    >>> settings
    LoopSettings(parameters=('k', 'd'), exclude=('F',))
    """

    fit: FitSettings | None = None
    parameters: ChosenParameters | None = None
    solver: SolverSettings = field(default_factory=lambda: SolverSettings(1e-5, 1e-5))
    most_readings: int = 8000
    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    require: tuple[str, ...] = ()
    ports: tuple[str, ...] | None = None
    laws: tuple[str, ...] | None = None
    max_effects: int = 3
    held_out: float = 0.3
    cache: Path | None = None
    max_minutes: float = 20.0
    max_error_ratio: float = 3.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "cache", None if self.cache is None else Path(self.cache))
        for name in ("effects", "exclude", "require", "ports", "laws"):
            given = getattr(self, name)
            object.__setattr__(self, name, given if given is None else names_of(given, name))

    @property
    def fitting(self) -> FitSettings:
        """How models are fitted in the loop: with its solver, and of a counter at standstill few readings only."""
        fit = self.fit or FitSettings(method="local")
        calibration = replace(
            fit.calibration, most_readings=self.most_readings, keep_standstill_readings=False, solver=self.solver
        )
        return replace(fit, calibration=calibration)
