"""The model family that the loop searches: a base model, and the same model with laws added."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.parameters import Parameter, ParameterSet
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
    process = calibration.process
    if process is not None:
        process = replace(process, diffusion=renamed(process.diffusion))
    return replace(calibration, data=data, model=model, process=process, parameters=ParameterSet(parameters))


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
