"""Settings of the closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from aero_bayes.arguments import names_of, paths_of
from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.parameters import Override
from aero_bayes.estimate.search_settings import GlobalSearchSettings
from aero_bayes.judge.choice import ChoiceSettings
from aero_bayes.search.parts import Parts
from aero_bayes.search.settings import StructureSettings
from aero_bayes.simulation.interface import SolverSettings


@dataclass(frozen=True, repr=False)
class LoopSettings(SettingsDisplay):
    """Settings of the closed loop.

    Parameters
    ----------
    structures, local_fit, global_search, calibration
        Settings of the search over structures, of its local fits, of the fits before and after it, and of the problem.
    effects : tuple of str, optional
        Ids or laws that are tried; all by default.
    exclude : tuple of str
        Ids, ports or laws that are not tried.
    ports, laws : tuple of str, optional
        The only ports and laws that are tried; all by default.
    sources : path or sequence of paths
        Files and package folders that the model is loaded from.
    cache : Path, optional
        Folder of FMUs that are kept between runs; by default ``fmu`` in the folder of the run, removed at the end.
    libraries : path or sequence of paths
        Folders that hold packages which the model uses.
    ripple : bool
        Whether ripple at multiples of the rotor's angle is subtracted from the readings.
    held_out : float
        Last share of each recording that is not fitted but used as test data, if no test recording is given.
    fixed : mapping of str to float
        Values of fixed parameters that differ from those of the model.
    overrides : mapping of str to Override
        Priors and bounds in place of the defaults.
    free : tuple of str, optional
        Parameters of the base model to fit; by default those that its package declares to be searched.
    free_later : tuple of str
        Parameters that are fixed until an effect is added with which the data determine them.
    max_minutes : float
        Time limit of the search; the loop continues with what was found by then, and says so.
    min_share : float
        A term is material if with it the error on left-out readings of an output is at most this share of that without.
    include_smaller : bool
        Whether terms that help and are not material are written into the model, too.
    formulas : bool
        Whether terms that no library lists are sought as products of functions of a place's signals.
    max_error_ratio : float
        Largest ratio of the error on unseen data to that of the fit for a model to count as adequate.
    leave_out : tuple of str
        Parts of the search that are left out, by their names in ``aero_bayes.search.PARTS`` (ablation).
    process_noise : tuple of str, optional
        States that process noise may drive where laws leave structure in the residual; all by default.
    initial_sd : mapping of str to float
        With process noise, how far a state's initial value may be off the model's own: its standard deviation.
    parts : Parts, optional
        Edits, start rules and restarts of the search in place of the standard ones.

    Examples
    --------
    >>> settings = aero_bayes.LoopSettings(free=("k", "d"), exclude=("F",))
    >>> [type(edit).__name__ for edit in settings.search_parts.last_edits]
    ['AddProcessNoise']
    >>> settings.choice.min_share
    0.75
    >>> settings
    LoopSettings(exclude=('F',), free=('k', 'd'))
    """

    structures: StructureSettings = field(default_factory=StructureSettings)
    local_fit: LocalFitSettings = field(default_factory=LocalFitSettings)
    global_search: GlobalSearchSettings = field(default_factory=lambda: GlobalSearchSettings(swarm=None))
    calibration: CalibrationSettings = field(
        default_factory=lambda: CalibrationSettings(
            most_readings=8000, keep_standstill_readings=False, solver=SolverSettings(1e-5, 1e-5)
        )
    )
    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    ports: tuple[str, ...] | None = None
    laws: tuple[str, ...] | None = None
    ripple: bool = True
    held_out: float = 0.3
    sources: tuple[Path, ...] = ()
    cache: Path | None = None
    libraries: tuple[Path, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    overrides: Mapping[str, Override] = field(default_factory=dict)
    free: tuple[str, ...] | None = None
    free_later: tuple[str, ...] = ()
    max_minutes: float = 20.0
    min_share: float = 0.75
    include_smaller: bool = False
    formulas: bool = False
    max_error_ratio: float = 3.0
    leave_out: tuple[str, ...] = ()
    process_noise: tuple[str, ...] | None = None
    initial_sd: Mapping[str, float] = field(default_factory=dict)
    parts: Parts | None = None

    def __post_init__(self) -> None:
        for name in ("sources", "libraries"):
            object.__setattr__(self, name, paths_of(getattr(self, name), name))
        object.__setattr__(self, "cache", None if self.cache is None else Path(self.cache))
        for name in ("free", "effects", "exclude", "ports", "laws", "free_later", "leave_out", "process_noise"):
            given = getattr(self, name)
            object.__setattr__(self, name, given if given is None else names_of(given, name))

    @property
    def search_parts(self) -> Parts:
        """The parts of the search: those that are given, else the standard ones but for what is left out."""
        return self.parts or Parts.of(self.leave_out)

    @property
    def choice(self) -> ChoiceSettings:
        """What counts as a cause."""
        return ChoiceSettings(self.min_share, self.structures.require)
