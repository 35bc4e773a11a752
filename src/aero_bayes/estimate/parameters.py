"""Unknown parameters: values in SI units, bounds and priors, and the scaled coordinates in which they are searched."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arguments import names_of
from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.fittable import default_bounds, first_given, model_bound, no_parameter_text
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Prior, Uniform, search_sd
from aero_bayes.simulation.interface import ParameterTarget, ProblemTarget
from aero_bayes.simulation.model import Model

#: Distance from a bound, as a share of the box, at which a parameter counts as lying on it.
BOUND_TOLERANCE = 1e-6
#: Share of its upper bound to which a parameter at zero is moved where its sensitivity is needed.
ZERO_OFFSET = 1e-9
#: Least curvature of a prior, in search coordinates.
MIN_PRIOR_CURVATURE = 1e-9
Scale = Literal["log", "linear"]


@dataclass(frozen=True)
class JointPrior:
    """Mean and covariance of several parameters, of their logarithms where these are searched."""

    names: tuple[str, ...]
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Parameter:
    """One unknown number."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    prior: Prior
    scale: Scale
    description: str
    target: ProblemTarget
    recording: int | None = None
    free_if_identified: bool = False
    per_recording: bool = False
    starts: tuple[str, ...] = ()
    shared_with: tuple[int, ...] = ()
    joint: JointPrior | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise InputError(f"{self.name}: bounds {self.lower:g} to {self.upper:g} are not a finite interval")
        if not self.lower <= self.start <= self.upper:
            raise InputError(
                f"{self.name}: start {self.start:g} {self.unit} lies outside its bounds, "
                f"{self.lower:g} to {self.upper:g}"
            )
        if self.scale == "log" and self.lower <= 0.0:
            raise InputError(f"{self.name}: a logarithmic axis needs a positive lower bound, not {self.lower:g}")
        object.__setattr__(self, "prior", self.prior.bounded(self.lower, self.upper))

    def acts_in(self, recording: int | None) -> bool:
        """Return whether it belongs to a recording, by its index."""
        return self.recording in (None, recording) or recording in self.shared_with


def prior_curvature(second: FloatArray) -> FloatArray:
    """Compute the curvature (k, k) of negative log-priors from their second derivatives (k,); never singular."""
    return np.diag(np.maximum(-second, MIN_PRIOR_CURVATURE))


@dataclass(frozen=True)
class ParameterSet:
    """The columns of a parameter matrix, with the change between SI units and search coordinates.

    On a ``log`` axis the coordinate is the natural logarithm of the value in its SI unit; on a ``linear`` axis it is
    the value over the width of its bounds. Standard deviations of coordinates are thus of comparable size."""

    items: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for item in self.items:
            if item.name in seen:
                raise InputError(f"parameter {item.name} is given twice")
            seen.add(item.name)

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __getitem__(self, name: str) -> Parameter:
        return self.items[self.index(name)]

    def __contains__(self, name: object) -> bool:
        return any(item.name == name for item in self.items)

    def index(self, name: str) -> int:
        """Return the column of a parameter."""
        for j, item in enumerate(self.items):
            if item.name == name:
                return j
        raise InputError(f"no parameter {name}; there are {', '.join(self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(item.name for item in self.items)

    @property
    def start(self) -> FloatArray:
        """Starting values in SI units, shape (p,)."""
        return np.array([item.start for item in self.items])

    @property
    def logarithmic(self) -> NDArray[np.bool_]:
        """Which search coordinates (p,) are logarithms."""
        return np.array([item.scale == "log" for item in self.items], dtype=bool)

    @cached_property
    def _joint(self) -> tuple[FloatArray, FloatArray, float]:
        """Return mean (p,) and coupling (p, p) in search coordinates, and the logarithm of the density's constant.

        With the parameters' own priors it makes the normal density of a joint prior; parameters that it has beside
        these are integrated out."""
        mean, coupling, constant = np.zeros(len(self)), np.zeros((len(self), len(self))), 0.0
        columns = [j for j, p in enumerate(self.items) if p.joint is not None and p.recording is None]
        if len(columns) > 1:
            joint = cast(JointPrior, self.items[columns[0]].joint)
            rows = [joint.names.index(cast(str, getattr(self.items[j].target, "name", ""))) for j in columns]
            unit = 1.0 / self._width[columns]
            covariance = np.array(joint.covariance)[np.ix_(rows, rows)] * unit[:, None] * unit[None, :]
            sizes = np.diag(covariance)
            mean[columns] = np.array(joint.mean)[rows] * unit
            coupling[np.ix_(columns, columns)] = np.linalg.inv(covariance) - np.diag(1.0 / sizes)
            constant = -0.5 * float(np.linalg.slogdet(covariance / np.sqrt(np.outer(sizes, sizes)))[1])
        return mean, coupling, constant

    @property
    def coupling(self) -> FloatArray:
        """What a joint prior adds to the curvature of the negative log-priors of single parameters, shape (p, p)."""
        return self._joint[1]

    def log_coupling(self, coordinates: FloatArray) -> FloatArray:
        """Compute what a joint prior adds to the log-densities of single parameters, shape (...,) for (..., p)."""
        mean, coupling, constant = self._joint
        off = np.asarray(coordinates, dtype=np.float64) - mean
        return np.asarray(constant - 0.5 * np.einsum("...i,ij,...j->...", off, coupling, off))

    def prior_curvature(self, second: FloatArray, columns: Sequence[int]) -> FloatArray:
        """Compute the curvature (k, k) of the negative log-prior over columns from ``prior_derivatives``' second."""
        kept = list(columns)
        return prior_curvature(second[kept]) + self.coupling[np.ix_(kept, kept)]

    @property
    def _width(self) -> FloatArray:
        return np.array([1.0 if item.scale == "log" else item.upper - item.lower for item in self.items])

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds in search coordinates, shape (p,) each."""
        return (
            self.to_search(np.array([item.lower for item in self.items])),
            self.to_search(np.array([item.upper for item in self.items])),
        )

    def on_bound(self, coordinates: FloatArray) -> NDArray[np.bool_]:
        """Return which search coordinates (p,) lie on a bound."""
        low, high = self.box
        return np.asarray(np.minimum(coordinates - low, high - coordinates) <= BOUND_TOLERANCE * (high - low))

    def revived(self, coordinates: FloatArray, columns: Sequence[int]) -> FloatArray:
        """Search coordinates (p,) with those of ``columns`` that lie on a bound back at their start.

        A factor that a fit has driven to zero has a zero sensitivity, from which no further fit could move it."""
        ended = self.on_bound(coordinates) & np.isin(np.arange(len(self)), columns)
        return np.where(ended, self.to_search(self.start), coordinates)

    def to_search(self, values: FloatArray) -> FloatArray:
        """Search coordinates of SI values, shape (..., p)."""
        values = np.asarray(values, dtype=np.float64)
        log = self.logarithmic
        return np.where(log, np.log(np.where(log, values, 1.0)), values / self._width)

    def from_search(self, coordinates: FloatArray) -> FloatArray:
        """Convert search coordinates to SI values, shape (..., p), clipped by one rounding to the bounds."""
        coordinates = np.asarray(coordinates, dtype=np.float64)
        log = self.logarithmic
        values = np.where(log, np.exp(np.where(log, coordinates, 0.0)), coordinates * self._width)
        low, high = self.box
        inside = (coordinates >= low) & (coordinates <= high)
        clipped = np.clip(values, [item.lower for item in self.items], [item.upper for item in self.items])
        return np.where(inside, clipped, values)

    def away_from_zero(self, values: FloatArray, active: Sequence[int]) -> FloatArray:
        """Move active parameters at a lower bound of zero slightly above it, in SI values (..., p).

        The sensitivities of a law vanish where its magnitude is exactly zero."""
        lifted = values.copy()
        for j in active:
            item = self.items[j]
            if item.lower == 0.0:
                lifted[..., j] = np.maximum(lifted[..., j], ZERO_OFFSET * item.upper)
        return lifted

    def jacobian(self, values: FloatArray) -> FloatArray:
        """Compute the derivative of each value with respect to its own coordinate, shape (..., p)."""
        values = np.asarray(values, dtype=np.float64)
        return np.where(self.logarithmic, values, self._width)

    def log_prior(self, coordinates: FloatArray) -> FloatArray:
        """Compute the log-density of the priors in search coordinates, shape (n,) for coordinates (n, p)."""
        coordinates = np.atleast_2d(coordinates)
        low, high = self.box
        inside = np.all((coordinates >= low) & (coordinates <= high), axis=1)
        values = self.from_search(coordinates[inside])
        density = np.sum(np.log(self.jacobian(values)), axis=1)
        for j, item in enumerate(self.items):
            density = density + item.prior.log_pdf(values[:, j])
        total = np.full(len(coordinates), -np.inf)
        total[inside] = density + self.log_coupling(coordinates[inside])
        return total

    def prior_derivatives(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the first and second derivative of the log-prior by each search coordinate, shape (..., p).

        The second is of the parameters' own priors."""
        coordinates = np.asarray(coordinates, dtype=np.float64)
        values = self.from_search(coordinates)
        slope = self.jacobian(values)
        first, second = np.empty(values.shape), np.empty(values.shape)
        for j, item in enumerate(self.items):
            d1, d2 = item.prior.derivatives(values[..., j])
            first[..., j] = d1 * slope[..., j]
            second[..., j] = d2 * slope[..., j] ** 2
        log = self.logarithmic
        mean, coupling, _ = self._joint
        return first + log - (coordinates - mean) @ coupling, second + np.where(log, first, 0.0)

    def sample_prior(self, rng: np.random.Generator, size: int) -> FloatArray:
        """Draw from the priors in SI units, shape (size, p)."""
        drawn = np.stack([item.prior.sample(rng, size) for item in self.items], axis=1)
        mean, coupling, _ = self._joint
        columns = np.flatnonzero(coupling.any(axis=1))
        if columns.size:
            precision = coupling[np.ix_(columns, columns)] + np.diag(self.prior_sd()[columns] ** -2.0)
            points = np.tile(mean, (size, 1))
            points[:, columns] = rng.multivariate_normal(mean[columns], np.linalg.inv(precision), size)
            drawn[:, columns] = self.from_search(np.clip(points, *self.box))[:, columns]
        return drawn

    def prior_sd(self) -> FloatArray:
        """Compute the standard deviation of each prior in search coordinates, shape (p,)."""
        return np.array([search_sd(p.prior, p.lower, p.upper, p.scale) for p in self.items])

    def with_start(self, values: FloatArray) -> ParameterSet:
        """Return the same parameters with other starting values."""
        return ParameterSet(tuple(replace(p, start=float(v)) for p, v in zip(self.items, values, strict=True)))

    def without(self, names: Sequence[str]) -> ParameterSet:
        """Return the parameters without some of them."""
        return ParameterSet(tuple(p for p in self.items if p.name not in names))

    def extended(self, more: Sequence[Parameter]) -> ParameterSet:
        """Return the parameters followed by more."""
        return ParameterSet(self.items + tuple(more))


@dataclass(frozen=True)
class ParameterSpec:
    """Start, bounds, prior or scale of a parameter in place of the model's own; None keeps the model's.

    Parameters
    ----------
    start, lower, upper : float, optional
        Where the search starts, and its bounds, in SI units.
    prior : Prior, optional
    scale : {"log", "linear"}, optional
        Axis of the search; ``log`` where the lower bound is positive.
    free_if_identified : bool
        Free it only if the data show it.
    per_recording : bool
        Fit a value of its own for each recording; results call them ``C@recording``.
    joint : JointPrior, optional
        Correlation of its prior with those of others, see :func:`with_joint_prior`.
    values : tuple, optional
        Do not search, but fit with each of these: numbers, True and False, names of enumeration literals.

    Examples
    --------
    >>> parameters_from_model(model, overrides={"k": ParameterSpec(start=40.0, lower=10.0)})["k"].lower
    10.0
    """

    start: float | None = None
    lower: float | None = None
    upper: float | None = None
    prior: Prior | None = None
    scale: Scale | None = None
    free_if_identified: bool = False
    per_recording: bool = False
    joint: JointPrior | None = None
    values: tuple[bool | int | float | str, ...] | None = None


#: How a caller may specify a parameter: not at all, by a start, by bounds, by a prior, by all of them, or by
#: ``{"values": [...]}``.
GivenParameter = (
    ParameterSpec | Prior | tuple[float, float] | float | Mapping[str, Sequence[bool | int | float | str]] | None
)
#: Which parameters a caller searches.
ChosenParameters = ParameterSet | str | Sequence[str] | Mapping[str, GivenParameter]


def chosen_parameters(model: Model, chosen: ChosenParameters, known: Mapping[str, ParameterSpec]) -> ParameterSet:
    """Return the parameters to search, as a caller names them."""
    if isinstance(chosen, ParameterSet):
        return chosen
    if not isinstance(chosen, Mapping):
        return parameters_from_model(model, names_of(chosen, "parameters"), known)
    overrides = {name: _override(name, spec, known.get(name, ParameterSpec())) for name, spec in chosen.items()}
    return parameters_from_model(model, tuple(overrides), overrides)


def _override(name: str, spec: GivenParameter, known: ParameterSpec) -> ParameterSpec:
    if spec is None or isinstance(spec, ParameterSpec):
        return spec or known
    if isinstance(spec, int | float):
        return replace(known, start=float(spec))
    if isinstance(spec, Sequence) and len(spec) == 2 and all(isinstance(bound, int | float) for bound in spec):
        lower, upper = map(float, spec)
        return replace(known, lower=lower, upper=upper, scale=known.scale if lower > 0.0 else "linear")
    if not hasattr(spec, "log_pdf"):
        raise InputError(
            f"parameters: {name}: expected (lower, upper), a start, a prior or a ParameterSpec, got {spec!r}"
        )
    return replace(known, prior=cast(Prior, spec))


def parameters_from_model(
    model: Model, free: Sequence[str] | None = None, overrides: Mapping[str, ParameterSpec] | None = None
) -> ParameterSet:
    """Make parameters of a model, by name, with bounds and start from the model unless overridden.

    Parameters
    ----------
    model : Model
    free : sequence of str, optional
        Which to search; by default those that ``overrides`` names.
    overrides : mapping of str to ParameterSpec

    Returns
    -------
    ParameterSet
        In the order of ``free``, in SI units.

    Raises
    ------
    InputError
        For a name that the model lacks, a parameter without finite bounds, or a start outside them.

    Examples
    --------
    >>> parameters_from_model(model, ["k", "d"]).names
    ('k', 'd')
    """
    overrides = overrides or {}
    known = {variable.name: variable for variable in model.parameters}
    items = []
    for name in free if free is not None else tuple(overrides):
        if name not in known:
            raise InputError(no_parameter_text(model, name))
        variable, override = known[name], overrides.get(name, ParameterSpec())
        start = first_given(override.start, variable.start, variable.nominal)
        if start is None:
            none = f"{name}: the model gives it no value to start a search from;"
            raise InputError(
                f'{none} give one, as by parameters={{"{name}": 1.0}}', f"{none} [parameters.{name}] value can"
            )
        lower, upper = default_bounds(
            start, first_given(override.lower, model_bound(variable.minimum, start)),
            first_given(override.upper, model_bound(variable.maximum, start)), variable.nominal,
        )  # fmt: skip
        if not lower < upper:
            raise InputError(f"{name}: lower bound {lower:g} is not below upper bound {upper:g}")
        if override.prior is not None and override.lower is None and override.upper is None:
            lower, upper = max(lower, override.prior.lower), min(upper, override.prior.upper)
        scale = override.scale or ("log" if lower > 0.0 else "linear")
        prior = override.prior or (LogUniform(lower, upper) if scale == "log" else Uniform(lower, upper))
        items.append(
            Parameter(
                name, variable.unit, start, lower, upper, prior, scale, variable.description,
                ParameterTarget(name), free_if_identified=override.free_if_identified,
                per_recording=override.per_recording, joint=override.joint,
            )
        )  # fmt: skip
    return ParameterSet(tuple(items))


#: Draws for each parameter that a covariance needs at least.
MIN_DRAWS_EACH = 10


def with_joint_prior(parameters: ParameterSet, draws: Mapping[str, FloatArray]) -> ParameterSet:
    """Return the parameters with a common normal prior for those of which draws (n,) of a posterior are given (SI).

    So the posterior of one experiment is the prior of the next.
    Mean and covariance are those of the logarithms where the axis of the search is logarithmic."""
    shared = [p for p in parameters if p.name in draws]
    if not shared:
        there = ", ".join(draws)
        raise InputError(f"the posterior has none of the parameters {', '.join(parameters.names)}; it has {there}")
    values = np.stack([np.asarray(draws[p.name], dtype=float).ravel() for p in shared])
    if values.shape[1] < MIN_DRAWS_EACH * len(shared):
        raise InputError(f"the posterior has {values.shape[1]} draws, expected {MIN_DRAWS_EACH * len(shared)} or more")
    log = np.array([p.scale == "log" for p in shared])
    if (values[log] <= 0.0).any():
        raise InputError("the posterior has draws at or below zero of a parameter that is positive here")
    axes = np.where(log[:, None], np.log(np.where(log[:, None], values, 1.0)), values)
    mean, covariance = axes.mean(axis=1), np.atleast_2d(np.cov(axes))
    joint = JointPrior(tuple(p.name for p in shared), tuple(mean.tolist()), tuple(map(tuple, covariance.tolist())))
    found = []
    for p in parameters:
        if p.name in joint.names:
            k = joint.names.index(p.name)
            sd = float(np.sqrt(covariance[k, k]))
            prior = LogNormal(float(np.exp(mean[k])), sd) if p.scale == "log" else Normal(float(mean[k]), sd)
            start = float(np.clip(np.exp(mean[k]) if p.scale == "log" else mean[k], p.lower, p.upper))
            p = replace(p, prior=prior, start=start, joint=joint)
        found.append(p)
    return ParameterSet(tuple(found))
