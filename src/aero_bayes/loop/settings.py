"""How the closed loop works: one object for all that a user may choose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from aero_bayes.arguments import names_of, paths_of
from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.calibration import CalibrationSettings
from aero_bayes.estimate.global_search import GlobalSearchSettings
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.parameters import Override
from aero_bayes.judge.checks import Check
from aero_bayes.search.parts import Parts
from aero_bayes.search.settings import StructureSettings
from aero_bayes.simulation.interface import SolverSettings


@dataclass(frozen=True, repr=False)
class LoopSettings(SettingsDisplay):
    """How the loop works.

    Parameters
    ----------
    structures, climb, ascent, calibration
        Settings of the search, of each local fit, of whole fits, and of the problem.
    effects : tuple of str, optional
        Ids or laws to consider; all by default.
    exclude : tuple of str
        Ids, ports or laws that are not considered.
    ports, laws : tuple of str, optional
        The only ones that are; all by default.
    sources : path or sequence of paths
        Files and package folders that the model is loaded from.
    cache : Path, optional
        Where FMUs are kept between runs; by default ``fmu`` in the run's own folder, until the loop has ended.
    libraries : path or sequence of paths
        Folders that hold packages which the model uses.
    ripple : bool
        Whether ripple locked to a rotor is taken out of the readings.
    held_out : float
        Share of each recording, at its end, that is kept from the fit where no test recording is given.
    fixed : mapping of str to float
        Model parameters held at other values than the model's own.
    overrides : mapping of str to Override
        Priors and bounds in place of the defaults.
    seed : int
    free : tuple of str, optional
        Parameters of the base model to fit; by default those that its package declares to be searched.
    undecided : tuple of str
        Parameters that are held until a first effect lets the data tell them.
    search_samples : int
        Samples on which candidates are compared where an input changes more than twice as often; the model that comes
        out is fitted to all.
    max_minutes : float
        Time for the search; what it has found by then is what is judged, and it is said where it ended.
    left_over : float
        Share of the squared error above the noise floor that may be left beside named terms; beyond it they are not
        named.
    times_fitted : float
        How many times what the fit leaves the error on unseen data may be; beyond it terms are not named.
    leave_out : tuple of str
        Parts of the search that are left out, by the names in ``aero_bayes.search.PARTS``; to see what each is worth.
    parts : Parts, optional
        Edits, start rules and restarts of the search in place of the standard ones.
    checks : tuple of Check, optional
        What a structure has to pass, in place of the standard checks.

    Examples
    --------
    >>> settings = aero_bayes.LoopSettings(free=("k", "d"), exclude=("F",))
    >>> settings, settings.allows("F"), settings.allows("v")
    (LoopSettings(exclude=('F',), free=('k', 'd')), False, True)
    """

    structures: StructureSettings = field(default_factory=StructureSettings)
    climb: LocalFitSettings = field(default_factory=LocalFitSettings)
    ascent: GlobalSearchSettings = field(default_factory=lambda: GlobalSearchSettings(swarm=None))
    calibration: CalibrationSettings = field(
        default_factory=lambda: CalibrationSettings(
            most_readings=8000, standing=False, solver=SolverSettings(1e-5, 1e-5)
        )
    )
    seed: int = 1
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
    undecided: tuple[str, ...] = ()
    search_samples: int = 5000
    max_minutes: float = 20.0
    left_over: float = 0.3
    times_fitted: float = 3.0
    leave_out: tuple[str, ...] = ()
    parts: Parts | None = None
    checks: tuple[Check, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("sources", "libraries"):
            object.__setattr__(self, name, paths_of(getattr(self, name), name))
        object.__setattr__(self, "cache", None if self.cache is None else Path(self.cache))
        for name in ("free", "effects", "exclude", "ports", "laws", "undecided", "leave_out"):
            given = getattr(self, name)
            object.__setattr__(self, name, given if given is None else names_of(given, name))

    def allows(self, port: str) -> bool:
        """Whether the engineer lets anything be found at a port."""
        return port not in self.exclude and (self.ports is None or port in self.ports)
