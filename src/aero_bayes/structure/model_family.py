"""The model family that the loop searches: a base model, and the same model with laws added."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet
from aero_bayes.estimate.priors import LogUniform, Normal
from aero_bayes.simulation.interface import DiffusionTarget, ParameterTarget, Problem, Simulator, StartTarget
from aero_bayes.simulation.model import Model

OpenSimulator = Callable[[Problem], Simulator]

#: Prior standard deviation of the magnitude of an effect, in nominal values.
MAGNITUDE_PRIOR_FACTOR = 3.0


@dataclass(frozen=True)
class CandidateTerm:
    """A term that the model may lack."""

    id: str
    port: str
    starts: tuple[tuple[float, ...], ...]
    columns: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class ModelWithCandidates:
    """A model with candidate terms built in, all switched off.

    ``parameters`` are those of the candidates, one candidate after the other. ``candidates`` are the terms with the
    number of parameters of each."""

    model: Model
    parameters: tuple[Parameter, ...]
    candidates: tuple[tuple[CandidateTerm, int], ...]


@dataclass(frozen=True, eq=False)
class ExtendedModel:
    """A model with effects, written as Modelica and exported."""

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
    """Basis functions of a learned curve, which is linear in its heights."""

    x: FloatArray
    x_unit: str
    plain: FloatArray
    rows: FloatArray
    unit: str


class ModelFamily(Protocol):
    """What the search and the loop need of a model family. An id names a candidate term."""

    @property
    def base(self) -> str: ...

    @property
    def title(self) -> str: ...

    def base_model(self) -> Model:
        """Return the model without any law added."""
        ...

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """Return priors and bounds that are known beside those that the model declares, by parameter."""
        ...

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Place the candidates, with nominal values from a fit of the base model. Returns their ids."""
        ...

    def refinements(self) -> Mapping[str, str]:
        """Return, for each candidate that refines another one, that one."""
        ...

    def curves(self) -> Mapping[str, str]:
        """Return learned curves, and the variable over which each is learned."""
        ...

    def basis(self, id_: str) -> CurveBasis:
        """Return the basis functions of a learned curve."""
        ...

    def with_candidates(self, ids: Collection[str]) -> ModelWithCandidates:
        """Return the model with some candidates built in, switched off."""
        ...

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> ExtendedModel:
        """Write the model with chosen candidates to ``folder``. ``values`` go by names of the model with candidates."""
        ...

    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """Transfer a calibration of the base model to another model, whose states may have other names."""
        ...

    def describe(self, id_: str) -> str:
        """Return a sentence about a candidate."""
        ...


def calibration_on(calibration: Calibration, model: Model, names: Mapping[str, str]) -> Calibration:
    """Return a calibration with another model. ``names`` gives the names there of states that are named otherwise."""

    def renamed(by_state: Mapping[str, float]) -> dict[str, float]:
        return {names.get(state, state): value for state, value in by_state.items()}

    data = calibration.data.with_experiments(
        replace(e, start=renamed(e.start), start_sd=renamed(e.start_sd)) for e in calibration.data.experiments
    )
    parameters = tuple(
        replace(p, target=replace(p.target, state=names.get(p.target.state, p.target.state)))
        if isinstance(p.target, StartTarget | DiffusionTarget)
        else p
        for p in calibration.parameters
    )
    process = calibration.simulated.process
    if process is not None:
        process = replace(process, diffusion=renamed(process.diffusion))
    simulated = replace(calibration.simulated, model=model, process=process)
    return replace(calibration, data=data, simulated=simulated, parameters=ParameterSet(parameters))


def effect_parameter(
    name: str, unit: str, description: str, bounds: tuple[float, float], scale: float, default: float
) -> Parameter:
    """Return the parameter of an effect, with its prior: normal about zero, log-uniform where its
    bounds are positive."""
    low, high = bounds
    target = ParameterTarget(name)
    if low > 0.0:
        return Parameter(name, unit, default, low, high, LogUniform(low, high), "log", description, target)
    prior = Normal(0.0, MAGNITUDE_PRIOR_FACTOR * scale)
    return Parameter(name, unit, default, low, high, prior, "linear", description, target)


def to_significant_digits(value: float, digits: int = 4) -> float:
    """Return a number rounded to significant digits, for the text of a model."""
    return float(f"{value:.{digits}g}")
