"""Settings of the closed loop."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from aero_bayes.arguments import names_of
from aero_bayes.display import SettingsDisplay
from aero_bayes.errors import InputError
from aero_bayes.estimate.fit_settings import FitSettings
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.parameters import ChosenParameters
from aero_bayes.estimate.progressive_horizon import GOOD_FIT_RATIO
from aero_bayes.estimate.search_settings import GlobalSearchSettings
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.judge.judge import ChoiceSettings
from aero_bayes.search.parts import Parts
from aero_bayes.search.settings import StructureSettings
from aero_bayes.simulation.interface import SolverSettings


@dataclass(frozen=True, repr=False)
class LoopSettings(SettingsDisplay):
    """Settings of the closed loop.

    Parameters
    ----------
    fit : FitSettings, optional
        How the first model and the extended one are fitted; by default as the fit was that is given, else by a local
        search. It has no process noise.
    parameters : sequence of str, mapping or ParameterSet, optional
        What is fitted of the first model, as for :func:`aero_bayes.fit`; by default what the given fit found free, else
        what the model's package declares to be searched. One with ``free_if_identified`` is fixed until an effect is
        added with which the data determine it.
    structures, local_fit
        Settings of the search over structures, and of its local fits.
    solver : SolverSettings
        Of the simulations of the loop, which compares models: it is coarser than that of a fit.
    most_readings : int
        Readings of an output that a recording keeps; beyond it every n-th is kept.
    effects : tuple of str, optional
        Ids or laws that are tried; all by default.
    exclude : tuple of str
        Ids, ports or laws that are not tried.
    ports, laws : tuple of str, optional
        The only ports and laws that are tried; all by default.
    cache : Path, optional
        Folder of FMUs that are kept between runs; by default ``fmu`` in the folder of the run, removed at the end.
    held_out : float
        Last share of each recording that is not fitted but used as test data, if no test recording is given.
    max_minutes : float
        Time limit of the search; the loop continues with what was found by then, and says so.
    min_share : float
        A term is material if with it the error on left-out readings of an output is at most this share of that without.
    include_smaller : bool
        Whether terms that help and are not material are written into the model, too.
    max_error_ratio : float
        Largest ratio of the error on unseen data to that of the fit for a model to count as adequate.
    leave_out : tuple of str
        Parts of the search that are left out, by their names in ``aero_bayes.search.PARTS``.
    parts : Parts, optional
        Edits, start rules and restarts of the search in place of the standard ones.

    Examples
    --------
    >>> settings = aero_bayes.LoopSettings(parameters=("k", "d"), exclude=("F",))
    >>> [type(restart).__name__ for restart, _ in settings.search_parts.restarts]
    ['GrowingHorizon', 'DeclaredValues']
    >>> settings.choice.min_share
    0.75
    >>> settings.fitting.calibration.most_readings, settings.global_search.swarm is None
    (8000, True)
    >>> settings
    LoopSettings(parameters=('k', 'd'), exclude=('F',))
    """

    fit: FitSettings | None = None
    parameters: ChosenParameters | None = None
    structures: StructureSettings = field(default_factory=StructureSettings)
    local_fit: LocalFitSettings = field(default_factory=LocalFitSettings)
    solver: SolverSettings = field(default_factory=lambda: SolverSettings(1e-5, 1e-5))
    most_readings: int = 8000
    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    ports: tuple[str, ...] | None = None
    laws: tuple[str, ...] | None = None
    held_out: float = 0.3
    cache: Path | None = None
    max_minutes: float = 20.0
    min_share: float = 0.75
    include_smaller: bool = False
    max_error_ratio: float = 3.0
    leave_out: tuple[str, ...] = ()
    parts: Parts | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "cache", None if self.cache is None else Path(self.cache))
        for name in ("effects", "exclude", "ports", "laws", "leave_out"):
            given = getattr(self, name)
            object.__setattr__(self, name, given if given is None else names_of(given, name))
        if self.fit is not None and self.fit.noise.process:
            raise InputError(
                "the loop fits without process noise: leave out [noise.process], which fit and posterior take"
            )

    @property
    def fitting(self) -> FitSettings:
        """How models are fitted in the loop: with its solver, and of a counter at standstill few readings only."""
        fit = self.fit or FitSettings(method="local")
        calibration = replace(
            fit.calibration, most_readings=self.most_readings, keep_standstill_readings=False, solver=self.solver
        )
        return replace(fit, calibration=calibration)

    @property
    def global_search(self) -> GlobalSearchSettings:
        """Of the fits before and after the search over structures.

        A swarm with settings of its own always runs, another one where no local fit is good.
        """
        own = self.fitting
        return replace(own.global_search, good_enough=GOOD_FIT_RATIO if own.pso == SwarmSettings() else 0.0)

    @property
    def search_parts(self) -> Parts:
        """The parts of the search: those that are given, else the standard ones but for what is left out."""
        return self.parts or Parts.of(self.leave_out)

    @property
    def choice(self) -> ChoiceSettings:
        """What counts as a cause."""
        return ChoiceSettings(self.min_share, self.structures.require)
