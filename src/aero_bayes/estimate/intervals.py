"""Laplace approximation of the posterior, how much wider it is where the residual is no noise, intervals and bands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import polar
from scipy.special import ndtri, stdtrit

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Estimate, Identifiability, Status, fixed_parameters
from aero_bayes.estimate.local_fit import Optimum, parameter_covariance
from aero_bayes.estimate.log_posterior import CurvatureAdjustment, NoiseLayout
from aero_bayes.estimate.noise import OutputNoise, residual_correlation_time
from aero_bayes.estimate.noise_estimation import log_density
from aero_bayes.estimate.objective import Objective, Series
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH, StartTarget

Readings = NDArray[np.int_]

#: Least curvature, as a share of that of all readings.
MIN_CURVATURE_SHARE = 1e-12
#: Blocks of a recording, and readings that one has at least.
BLOCK_COUNT, MIN_BLOCK_READINGS = 20, 4


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """A fit to first order about its optimum."""

    slopes: FloatArray
    residual: FloatArray
    prior: FloatArray

    @classmethod
    def of(cls, optimum: Optimum, parameters: ParameterSet, moving: Sequence[int]) -> LinearisedFit:
        """Linearise an optimum over some of its free columns, given by their places among them."""
        second = parameters.prior_derivatives(optimum.coordinates)[1]
        prior = parameters.prior_curvature(second, [optimum.free[k] for k in moving])
        return cls(optimum.whitened.slopes[list(moving)], optimum.whitened.residual, prior)

    @property
    def leverage(self) -> FloatArray:
        """How much each reading determines the parameters (N,); the sum is at most their number."""
        curvature = self.slopes @ self.slopes.T + self.prior
        return np.asarray(np.einsum("kn,kn->n", self.slopes, np.linalg.pinv(curvature, hermitian=True) @ self.slopes))

    def without(
        self, cells: Sequence[Readings], windows: Sequence[slice] | None = None, least: float = MIN_CURVATURE_SHARE
    ) -> Iterator[tuple[Readings, FloatArray]]:
        """Leave each block out in turn: its readings, and the step of the parameters without it.

        At the optimum the gradient of the log-posterior is zero, so that without block ``b`` it is ``-S_b r_b``, and
        the Newton step is ``-H_b^-1 S_b r_b`` with the curvature ``H_b`` of what remains."""
        slopes, residual = self.slopes, self.residual
        own = np.array([slopes[:, cell] @ slopes[:, cell].T for cell in cells])
        whole = self.prior + own.sum(axis=0)
        unit = 1.0 / np.sqrt(np.diag(whole))
        for window in windows or [slice(k, k + 1) for k in range(len(cells))]:
            block = np.concatenate(cells[window])
            # Sum the other cells: a difference would lose a direction that only this block determines.
            rest = self.prior + own[: window.start].sum(axis=0) + own[window.stop :].sum(axis=0)
            values, vectors = np.linalg.eigh(rest * np.outer(unit, unit))
            pull = vectors.T @ (unit * (slopes[:, block] @ residual[block]))
            yield block, -unit * (vectors @ (pull / np.maximum(values, least)))


def blocks_of_time(series: Sequence[Series], leverage: FloatArray, count: int, least: int) -> list[list[Readings]]:
    """Cut the readings of each recording into blocks of time, all outputs together.

    Blocks have equal shares of readings and of leverage (N,), so that the fit without one of them is close to the full
    fit and its linearisation holds."""
    found = []
    for e in sorted({s.experiment for s in series}):
        readings = sum(s.sampling.size for s in series if s.experiment == e)
        cells = time_cells(series, leverage, e, max(min(count, readings // least), 1))
        found.append([cell for cell in cells if cell.size])
    return found


def time_cells(series: Sequence[Series], leverage: FloatArray, recording: int, count: int) -> list[Readings]:
    """Cut readings of one recording (columns of the whitened slopes) into ``count`` cells, one after the other.

    Each cell holds the same sum of the number of readings and of their leverage (N,), both as shares of the
    recording's. So no cell is empty unless one reading outweighs it, and a transient that tells much is cut into many.
    """
    first = np.concatenate(([0], np.cumsum([s.sampling.size for s in series])))
    own = [k for k, s in enumerate(series) if s.experiment == recording]
    columns = np.concatenate([np.arange(first[k], first[k + 1]) for k in own])
    columns = columns[np.argsort(np.concatenate([series[k].sampling.time for k in own]), kind="stable")]
    share = leverage[columns] / max(float(leverage[columns].sum()), 1e-300) + 1.0 / columns.size
    cell = np.minimum((np.cumsum(share) - 0.5 * share) / share.sum() * count, count - 1).astype(np.int64)
    edges = np.searchsorted(cell, np.arange(count + 1)).tolist()
    return [columns[a:b] for a, b in pairwise(edges)]


#: Blocks that the readings are cut into, and steps in which a block moves by its own length.
JACKKNIFE_BLOCKS, STEPS = 10, 12
#: Least share of the information on a direction that counts as left when a block is left out: a transient that tells
#: more than half has no counterpart, and how far the estimates would move without it says nothing.
MIN_INFORMATION_LEFT = 0.5


def jackknife_covariance(series: Sequence[Series], slopes: FloatArray, residual: FloatArray) -> FloatArray:
    """Compute the covariance of least-squares estimates by leaving out moving blocks of time, all outputs together.

    Slopes ``S`` (p, N) are scaled to unit information, ``S S' = I``, so that without a block the estimates move, to
    first order, by ``(I - S_b S_b')^-1 S_b r_b``. Blocks are whole recordings
    where there are ten or more."""
    recordings = sorted({s.experiment for s in series})
    count = max(round(STEPS * JACKKNIFE_BLOCKS / len(recordings)), STEPS)
    linear = LinearisedFit(slopes, residual, np.zeros((len(slopes), len(slopes))))
    cells = [cell for e in recordings for cell in time_cells(series, linear.leverage, e, count)]
    starts = [k * count + first for k in range(len(recordings)) for first in range(count - STEPS + 1)]
    windows = [slice(a, a + STEPS) for a in starts]
    moved = np.array([step for _, step in linear.without(cells, windows, MIN_INFORMATION_LEFT)])
    blocks = len(cells) / STEPS
    widening = float(stdtrit(blocks - 1.0, 0.95) / ndtri(0.95)) ** 2
    return np.asarray((blocks - 1.0) * widening * moved.T @ moved / len(moved))


@dataclass(frozen=True)
class Laplace:
    """Mean (d,) and covariance (d, d) of free parameters, then noise parameters; ``names`` in that order.

    Mean and covariance of a Gaussian are orthogonal parameters, so the two blocks do not mix."""

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray
    parameters: int

    @property
    def sd(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance))

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw from the Gaussian in search coordinates, shape (count, d)."""
        sizes, axes = np.linalg.eigh(self.covariance)
        return np.asarray(
            self.mean + rng.standard_normal((count, self.mean.size)) * np.sqrt(np.maximum(sizes, 0.0)) @ axes.T
        )


def curvature_adjustment(objective: Objective, optimum: Optimum) -> CurvatureAdjustment | None:
    """Return how much wider than its likelihood the posterior is.

    None where noise describes the residuals of all outputs."""
    if not optimum.free or not any(optimum.noise[s.output].model_error for s in objective.series):
        return None
    items = [objective.parameters.items[j] for j in optimum.free]
    unit = ParameterSet(tuple(items)).prior_sd()
    slopes = optimum.whitened.slopes * unit[:, None]
    own = np.array([item.recording is not None for item in items])
    # With the own parameters readjusted to each change of the shared ones.
    follow = -np.linalg.pinv(slopes[own] @ slopes[own].T, hermitian=True) @ (slopes[own] @ slopes[~own].T)
    shared = slopes[~own] + follow.T @ slopes[own]
    values, vectors = np.linalg.eigh(shared @ shared.T)
    seen = values > 1e-10 * max(float(values.max(initial=0.0)), 1e-300)
    axes, root = vectors[:, seen], np.sqrt(values[seen])
    covariance = jackknife_covariance(objective.series, (axes / root).T @ shared, optimum.whitened.residual)
    sizes, directions = np.linalg.eigh(covariance)
    sizes = np.maximum(sizes, 1.0)
    narrowed = (
        np.eye(len(values))
        + (axes / root) @ ((directions / np.sqrt(sizes)) @ directions.T - np.eye(len(sizes))) @ (axes * root).T
    )
    adjusted = np.zeros((len(items), len(items)))
    kept = 1.0 / np.sqrt(np.median(sizes)) if sizes.size else 1.0
    adjusted[np.ix_(~own, ~own)] = narrowed
    adjusted[np.ix_(own, own)] = kept * np.eye(int(own.sum()))
    adjusted[np.ix_(own, ~own)] = follow @ narrowed - kept * follow
    # Of all maps M with M' H M = H' (H before, H' after), the symmetric one moves points least: optimal transport
    # between Gaussians (Olkin & Pukelsheim, 1982, Linear Algebra Appl. 48, 257). As H' <= H, it only contracts. Others
    # carry what a strong direction moves into a weak one, far beyond the prior.
    values, vectors = np.linalg.eigh(slopes @ slopes.T)
    full = np.where(values > 1e-10 * max(float(values.max(initial=0.0)), 1e-300), np.sqrt(np.maximum(values, 0.0)), 1.0)
    stretch = polar((vectors * full) @ vectors.T @ adjusted @ (vectors * full) @ vectors.T)[1]
    inverse = (vectors / full) @ vectors.T
    scaled = inverse @ stretch @ inverse
    here = optimum.coordinates[list(optimum.free)]
    prior = ParameterSet(tuple(items)).prior_derivatives(here)[0]
    return CurvatureAdjustment(here, scaled * unit[:, None] / unit[None, :], prior)


def widened_covariance(objective: Objective, optimum: Optimum) -> FloatArray:
    """Compute the covariance of the free columns' posterior, in search coordinates."""
    items = ParameterSet(tuple(objective.parameters.items[j] for j in optimum.free))
    information = optimum.whitened.information
    if (widening := curvature_adjustment(objective, optimum)) is not None:
        information = widening.map.T @ information @ widening.map
    second = items.prior_derivatives(optimum.coordinates[list(optimum.free)])[1]
    return parameter_covariance(information + items.prior_curvature(second, range(len(items))), items.prior_sd())


def with_robust_covariance(objective: Objective, optimum: Optimum) -> Optimum:
    """Return the optimum with the covariance that its residuals ask for, where they are no noise."""
    wrong = any(optimum.noise[s.output].model_error for s in objective.series)
    return replace(optimum, covariance=widened_covariance(objective, optimum)) if wrong else optimum


def noise_covariance(
    layout: NoiseLayout,
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    noise: Mapping[str, OutputNoise],
    step: float = 0.02,
) -> FloatArray:
    """Compute the covariance of the noise parameters' logarithms, from second differences of their log-posterior."""
    centre = layout.pack(noise)
    size = layout.size
    hessian = np.zeros((size, size))
    owner = [name.removeprefix("noise.").rpartition(".")[0] for name in layout.names]

    def value(output: str, point: FloatArray) -> float:
        k = layout.outputs.index(output)
        estimate = layout.estimates(point)[output]
        density = sum(log_density(t, r[:, k], estimate) for t, r in zip(times, residuals, strict=True))
        return density + float(layout.log_prior(point[None])[0])

    for a in range(size):
        for b in range(a + 1):
            if owner[a] != owner[b]:
                continue
            ea, eb = step * np.eye(size)[a], step * np.eye(size)[b]
            corners = [value(owner[a], centre + sa * ea + sb * eb) for sa in (1, -1) for sb in (1, -1)]
            hessian[a, b] = hessian[b, a] = -(corners[0] - corners[1] - corners[2] + corners[3]) / (4.0 * step**2)
    # Where a run fails a density may not be finite: the prior's width is what is left.
    values, vectors = np.linalg.eigh(np.where(np.isfinite(hessian), hessian, 0.0))
    floor = 1.0 / layout.sigma**2
    return np.asarray((vectors / np.maximum(values, floor)) @ vectors.T)


#: Share of new readings that a band holds.
BAND_SHARE = 0.9
#: Standard deviations from which an initial value is told to be none of rest.
REST_DEVIATIONS = 3.0
#: Average length of a block that is left out, in correlation times of the residual.
BLOCK_LENGTH = 2.0


def band_factors(
    calibration: Calibration,
    series: Sequence[Series],
    optimum: Optimum,
    covariance: FloatArray,
    residuals: Sequence[FloatArray],
) -> FloatArray:
    """Compute the half-width of the 90 % band of each output, in standard deviations of a predicted reading."""
    if calibration.process is not None:  # the filter says how much each reading differs from its prediction
        return np.full(len(calibration.data.outputs), NORMAL_HALF_WIDTH)
    assert optimum.evaluation.slopes is not None
    slopes = optimum.evaluation.slopes
    fitted = [residuals[s.experiment][s.sampling.index, s.column] for s in series]
    changes = _leave_out_changes(calibration, series, optimum)
    factors = np.full(len(calibration.data.outputs), NORMAL_HALF_WIDTH)
    for column, output in enumerate(calibration.data.outputs):
        own = [k for k, s in enumerate(series) if s.column == column]
        if not own:
            continue
        noise = optimum.noise[output].sd
        sds = [np.sqrt(noise**2 + np.einsum("kn,kl,ln->n", slopes[k], covariance, slopes[k])) for k in own]
        inside = np.concatenate([np.abs(fitted[k]) / sd for k, sd in zip(own, sds, strict=True)])
        outside = [np.abs(fitted[k] - changes[k]) / sd for k, sd in zip(own, sds, strict=True)]
        factors[column] = max(
            NORMAL_HALF_WIDTH, float(np.quantile(inside, BAND_SHARE)), conformal_quantile(outside, BAND_SHARE)
        )
    return factors


def conformal_quantile(scores: Sequence[FloatArray], share: float) -> float:
    """Compute the value that a new score exceeds with probability ``1 - share`` at most, from correlated scores."""
    every = np.concatenate(scores)
    independent = every.size / residual_correlation_time(scores)
    return float(np.quantile(every, min(share * (1.0 + 1.0 / independent), 1.0)))


def _leave_out_changes(calibration: Calibration, series: Sequence[Series], optimum: Optimum) -> list[FloatArray]:
    """Compute the change of each fitted output (n,) when the recording, or the only one's block, is left out.

    Initial values and delays that belong to one recording stay as fitted to all its readings."""
    assert optimum.evaluation.slopes is not None
    parameters = calibration.parameters
    shared = [k for k, j in enumerate(optimum.free) if parameters.items[j].recording is None]
    linear = LinearisedFit.of(optimum, parameters, shared)
    plain = np.concatenate([by[shared] for by in optimum.evaluation.slopes], axis=1)
    changes = np.zeros(plain.shape[1])
    for readings, step in linear.without(_parts(series, linear.leverage, optimum)):
        changes[readings] = step @ plain[:, readings]
    return np.split(changes, np.cumsum([s.sampling.size for s in series])[:-1])


def _parts(series: Sequence[Series], leverage: FloatArray, optimum: Optimum) -> list[Readings]:
    """Return what is left out in turn: each recording.

    Of a single one, blocks that are long beside the residual's memory."""
    lengths = [residual_correlation_time([r]) for r in optimum.evaluation.residual]
    least = math.ceil(BLOCK_LENGTH * sum(lengths))
    by_recording = blocks_of_time(series, leverage, BLOCK_COUNT, max(least, MIN_BLOCK_READINGS))
    if len(by_recording) > 1:
        return [np.concatenate(blocks) for blocks in by_recording]
    return by_recording[0]


_NO_INTERVAL: tuple[float | None, float | None, float | None, float | None] = (None, None, None, None)


def laplace_estimates(
    calibration: Calibration,
    values: FloatArray,
    free: tuple[int, ...],
    identifiability: Identifiability,
    laplace: Laplace,
) -> dict[str, Estimate]:
    """Compute value, central 90 % interval and status of every parameter, the model's fixed ones included.

    The interval is that of the Gaussian in search coordinates, mapped to SI units. Parameters that the data do not
    determine, and those on a bound of their search, get none."""
    slopes = calibration.parameters.jacobian(values)
    recordings = calibration.data.names
    table = {}
    for column, item in enumerate(calibration.parameters):
        status = identifiability.status[item.name] if column in free else Status.UNIDENTIFIED
        interval = _NO_INTERVAL
        if status in (Status.IDENTIFIED, Status.WEAK):
            position = free.index(column)
            mean, sd = laplace.mean[position], laplace.sd[position]
            u = mean + sd * np.array([-NORMAL_HALF_WIDTH, 0.0, NORMAL_HALF_WIDTH])
            x = np.exp(u) if item.scale == "log" else u * (item.upper - item.lower)
            low, middle, high = np.clip(x, item.lower, item.upper).tolist()
            interval = float(sd * slopes[column]), low, middle, high
        table[item.name] = Estimate(
            item.name, float(values[column]), *interval, item.unit, status, item.description,
            item.prior.describe(item.unit), item.start, item.lower, item.upper,
            _note(status, column in free, item.name, identifiability)
            or _off_start(item, calibration, values[column], interval[0]),
            recordings[item.recording] if item.recording is not None and len(recordings) > 1 else "",
        )  # fmt: skip
    return table | fixed_parameters(calibration)


def _note(status: Status, free: bool, name: str, identifiability: Identifiability) -> str:
    """Say why a parameter has no interval; empty if it has one."""
    if name in identifiability.in_steps:
        return identifiability.in_steps[name].note
    if name in identifiability.no_effect:
        return "changes no recorded output; left at its start"
    if not free:
        return "not visible in this data; left at its start"
    if status is Status.UNIDENTIFIED:
        return "the data says no more of it than the prior"
    if status is Status.AT_BOUND:
        return "ended on a bound of its search: no interval from there; widen the bound or look at the model"
    if name in identifiability.with_held:
        return identifiability.with_held[name]
    together = (m for d in identifiability.flat if name in d.members for m in d.members)
    if fixed := [m for m in dict.fromkeys(together) if identifiability.status[m] is Status.AT_BOUND]:
        return f"the interval holds with {join_names(fixed)} on its bound only"
    if status is Status.WEAK:
        others = [m for d in identifiability.flat if name in d.members for m in d.members if m != name]
        share = f"its interval is {100.0 * identifiability.ratio[name]:.0f} % as wide as the prior's"
        return f"seen only together with {join_names(list(dict.fromkeys(others)))}" if others else share
    return ""


def _off_start(item: Parameter, calibration: Calibration, value: float, sd: float | None) -> str:
    """Say that a state did not start where the model says; empty for any other parameter, and one that was read."""
    if not isinstance(item.target, StartTarget) or not sd or item.recording is None:
        return ""
    state = item.target.state
    start = next((s.start or 0.0 for s in calibration.model.states if s.name == state), value)
    off = abs(value - start) / sd
    if state in calibration.data.experiments[item.recording].start or off < REST_DEVIATIONS:
        return ""
    return f"the model starts at {start:.5g}, which is {off:.1f} standard deviations off"
