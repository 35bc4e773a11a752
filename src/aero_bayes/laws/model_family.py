"""What a closed loop asks of a model: its relatives with effects, and what to call them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet
from aero_bayes.estimate.priors import LogUniform, Normal
from aero_bayes.simulation import Model
from aero_bayes.simulation.interface import ParameterTarget, Problem, Simulator, StartTarget

FloatArray = NDArray[np.float64]
OpenSimulator = Callable[[Problem], Simulator]

#: Prior standard deviation of an effect's magnitude, in typical scales.
MAGNITUDE_PRIOR_FACTOR = 3.0


@dataclass(frozen=True)
class CandidateTerm:
    """A term that the model may lack: values (SI units) to start its parameters from, and their columns in a model.

    The first is its magnitude. One without starts is linear in its parameters, off where all are zero.
    """

    id: str
    port: str
    starts: tuple[tuple[float, ...], ...]
    columns: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class ModelWithCandidates:
    """A model with candidates switched off; ``parameters`` are theirs, so many of each as ``candidates`` say."""

    model: Model
    parameters: tuple[Parameter, ...]
    candidates: tuple[tuple[CandidateTerm, int], ...]


@dataclass(frozen=True, eq=False)
class ExtendedModel:
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


@dataclass(frozen=True, eq=False)
class CurveBasis:
    """What a learned curve is made of.

    ``x`` (n,) is the signal in ``x_unit``; ``plain`` (n,) what the port gives where all heights are zero and ``rows``
    (k, n) what each height adds for one of it, in ``unit``.
    """

    x: FloatArray
    x_unit: str
    plain: FloatArray
    rows: FloatArray
    unit: str


class ModelFamily(Protocol):
    """A model and its relatives."""

    @property
    def base(self) -> str: ...

    @property
    def title(self) -> str: ...

    def base_model(self) -> Model:
        """The model itself."""
        ...

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """What is known of its parameters beside what it declares."""
        ...

    @property
    def extra_terms_are_free(self) -> bool:
        """Whether a model that has more candidates than asked for costs no more."""
        ...

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Ids of all candidates, once the model has been fitted as it stands."""
        ...

    def candidate_groups(self) -> tuple[tuple[str, ...], ...]:
        """The candidates in groups that are best tried on one model."""
        ...

    def refinements(self) -> Mapping[str, str]:
        """For each candidate that refines another, that one."""
        ...

    def curves(self) -> Mapping[str, str]:
        """Candidates that learn a curve where no effect is known, and over which variable each."""
        ...

    def basis(self, id_: str) -> CurveBasis:
        """Of a candidate that learns a curve."""
        ...

    def with_candidates(self, ids: Collection[str]) -> ModelWithCandidates:
        """The model with some candidates."""
        ...

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> ExtendedModel:
        """The model with chosen candidates, at values by the names of the offers, written to ``folder``."""
        ...

    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """A calibration of the model held against a relative of it, whose states may have other names."""
        ...

    def describe(self, id_: str) -> str:
        """An effect in words."""
        ...


def calibration_on(calibration: Calibration, model: Model, names: Mapping[str, str]) -> Calibration:
    """A calibration held against a relative of its model, in which some states have other ``names``."""
    experiments = tuple(
        replace(e, start={names.get(s, s): v for s, v in e.start.items()}) for e in calibration.experiments
    )
    parameters = tuple(
        replace(p, target=StartTarget(names.get(p.target.state, p.target.state)))
        if isinstance(p.target, StartTarget)
        else p
        for p in calibration.parameters
    )
    return replace(calibration, model=model, experiments=experiments, parameters=ParameterSet(parameters))


def effect_parameter(
    name: str, unit: str, description: str, bounds: tuple[float, float], scale: float, default: float
) -> Parameter:
    """A parameter of an effect, off at its start where zero switches the effect off."""
    low, high = bounds
    target = ParameterTarget(name)
    if low > 0.0:
        return Parameter(name, unit, default, low, high, LogUniform(low, high), "log", description, target)
    prior = Normal(0.0, MAGNITUDE_PRIOR_FACTOR * scale)
    return Parameter(name, unit, default, low, high, prior, "linear", description, target)


def to_significant_digits(value: float, digits: int = 4) -> float:
    """As it is written into a model: no more digits than a fit knows."""
    return float(f"{value:.{digits}g}")
