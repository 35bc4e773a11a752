"""Settings of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.levenberg_marquardt import LocalSettings
from aero_bayes.estimate.listed_values import ListedValue
from aero_bayes.estimate.search_settings import WHOLE_MODEL_LOCAL, CostKind, GlobalSearchSettings
from aero_bayes.estimate.staged import Stage
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.sensors.noise import NoiseModel

Engine = Literal["native", "fmpy"]


@dataclass(frozen=True, repr=False)
class FitSettings(SettingsDisplay):
    """How a fit is done.

    Parameters
    ----------
    method : {"pso+local", "pso", "local"}
        ``pso+local``: the swarm, then the local search from its best particles.
    cost : {"posterior", "weighted", "eq6"}
        What is minimised: the negative log-posterior, with correlated noise where the data show it; squared errors
        weighted by each output's white noise; or the paper's Eq. 6, squared errors as they are. The last two leave
        the priors out.
    staged : bool
        Let the local search fit in the direction of causality before it fits all together.
    stages : tuple of Stage, optional
        Stages in place of those that the model's own structure gives.
    pso : SwarmSettings
        Of the particle swarm.
    local : LocalSettings
        Of each local search of the whole model, as given.
    swarm_samples : int
        Samples a recording that the swarm sees.
    starts : int
        Particles that the local search starts from, besides the starting values.
    calibration : CalibrationSettings
    noise : NoiseModel
    engine : {"native", "fmpy"}
    fixed : mapping of str to float
        Model parameters held at other values than the model's own.
    values : mapping of str to sequence
        Values of parameters that are each fitted, and compared: numbers, True and False, enumeration literals.

    Examples
    --------
    >>> aero_bayes.FitSettings(method="local").global_search.swarm is None  # no particle swarm first
    True
    """

    method: Literal["pso+local", "pso", "local"] = "pso+local"
    cost: CostKind = "posterior"
    staged: bool = True
    stages: tuple[Stage, ...] | None = None
    pso: SwarmSettings = field(default_factory=SwarmSettings)
    local: LocalSettings = field(default_factory=lambda: WHOLE_MODEL_LOCAL)
    swarm_samples: int = 600
    starts: int = 3
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    noise: NoiseModel = field(default_factory=NoiseModel)
    engine: Engine = "native"
    fixed: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, Sequence[ListedValue]] = field(default_factory=dict)

    @property
    def global_search(self) -> GlobalSearchSettings:
        """Settings of the search for the optimum."""
        swarm = self.pso if self.method != "local" else None
        local = self.local if self.method != "pso" else replace(self.local, iterations=0)
        return GlobalSearchSettings(self.cost, self.staged, self.stages, swarm, local, self.swarm_samples, self.starts)
