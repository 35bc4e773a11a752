"""Settings of the search for the optimum of a whole model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from aero_bayes.estimate import swarm as pso
from aero_bayes.estimate.levenberg_marquardt import LocalSettings
from aero_bayes.estimate.staged import Stage

CostKind = Literal["posterior", "weighted", "eq6"]

#: When a local search of a whole model stops unless the caller says otherwise: its intervals need no more digits, and
#: along a kink or at the solver's noise further steps gain nothing.
WHOLE_MODEL_LOCAL = LocalSettings(tolerance=1e-4, max_rejections=15, min_decrease=0.005)


@dataclass(frozen=True)
class GlobalSearchSettings:
    """Settings of the global search."""

    cost: CostKind = "posterior"
    staged: bool = True
    stages: tuple[Stage, ...] | None = None
    swarm: pso.SwarmSettings | None = field(default_factory=pso.SwarmSettings)
    local: LocalSettings = field(default_factory=lambda: WHOLE_MODEL_LOCAL)
    samples: int = 600
    starts: int = 3
    max_correlation_time: float | None = None
    check_noise: bool = True
    good_enough: float = 0.0
