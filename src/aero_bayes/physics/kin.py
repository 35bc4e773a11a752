"""What a closed loop asks of a model: its relatives with effects, and what to call them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.estimate.priors import LogUniform, Normal
from aero_bayes.simulation import Model
from aero_bayes.simulation.interface import ParameterTarget, Problem, Simulator

OpenSimulator = Callable[[Problem], Simulator]

#: An effect's magnitude is expected within so many of its typical scales (one standard deviation).
SPREAD = 3.0


@dataclass(frozen=True)
class Candidate:
    """An effect that the model may lack: the columns that switch it on, and values (SI units) to start them from.

    The first column is its magnitude. One that ``refines`` another is not searched for; it may take that one's place
    once that one is found.
    """

    id: str
    port: str
    columns: tuple[int, ...]
    starts: tuple[tuple[float, ...], ...]
    refines: str = ""


@dataclass(frozen=True, eq=False)
class Offer:
    """A model with every candidate switched off; ``parameters`` are theirs, in the order of the candidates' columns."""

    model: Model
    parameters: tuple[Parameter, ...]
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class Extension:
    """A model with effects, written and exported.

    ``parameters`` are the new ones; ``names`` gives, by the id of an effect, its parameters' names in the offer and
    here, in the same order; ``widths`` its smoothing constants.
    """

    name: str
    path: Path
    text: str
    diff: str
    model: Model
    parameters: tuple[Parameter, ...]
    names: Mapping[str, tuple[tuple[str, str], ...]]
    widths: Mapping[str, Mapping[str, float]]


class Family(Protocol):
    """A model and its relatives."""

    @property
    def base(self) -> str: ...

    @property
    def title(self) -> str: ...

    def plain(self) -> Model:
        """The model itself."""
        ...

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """What is known of its parameters beside what it declares."""
        ...

    def offer(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> Offer:
        """The model with all its candidates, once it has been fitted as it stands."""
        ...

    def extend(self, chosen: Sequence[Candidate], values: Mapping[str, float], folder: Path) -> Extension:
        """The model with chosen candidates, at values by the names of the offer, written to ``folder``."""
        ...

    def summary(self, id_: str) -> str:
        """An effect in words."""
        ...


def magnitude(
    name: str, unit: str, description: str, bounds: tuple[float, float], scale: float, default: float
) -> Parameter:
    """A parameter of an effect, off at its start where zero switches the effect off."""
    low, high = bounds
    target = ParameterTarget(name)
    if low > 0.0:
        return Parameter(name, unit, default, low, high, LogUniform(low, high), "log", description, target)
    prior = Normal(0.0, SPREAD * scale)
    return Parameter(name, unit, default, low, high, prior, "linear", description, target)
