"""A simulation study of a proposed experiment: whether fits to it are as accurate as expected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.design.information import Engine, ExperimentPredictor
from aero_bayes.design.propose import Design
from aero_bayes.design.separation import Separation
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import Fit, OutputNoise, ParameterSet
from aero_bayes.estimate.levenberg_marquardt import FixedCost, LocalSettings, QuadraticModel, levenberg_marquardt
from aero_bayes.progress import Progress
from aero_bayes.simulation.interface import Experiment, Outcome, Simulator
from aero_bayes.simulation.workers import WorkerPool

#: Predicted decrease of the cost, in nats, at which a refit has converged: less is lost in the error of the solver, and
#: it moves a parameter by a seventh of its standard deviation at most.
REFIT_TOLERANCE = 1e-2


@dataclass(frozen=True)
class GainCheck:
    """Errors of the parameters in simulated repetitions of an experiment.

    ``expected`` and ``realised`` are, by parameter, the error after over the standard deviation before; a realised
    value over ``repeats`` repetitions is itself uncertain by ``1 / sqrt(2 repeats)`` of it."""

    expected: Mapping[str, float]
    realised: Mapping[str, float]
    repeats: int
    failures: int

    @property
    def agrees(self) -> bool:
        """Whether every realised error is within four standard errors of what was expected."""
        margin = 4.0 / (2.0 * max(self.repeats - self.failures, 1)) ** 0.5
        return all(abs(self.realised[n] / e - 1.0) < margin for n, e in self.expected.items())

    def to_dict(self) -> dict[str, object]:
        return {
            "expected": dict(self.expected),
            "realised": dict(self.realised),
            "repeats": self.repeats,
            "failures": self.failures,
            "agrees": self.agrees,
        }


def check_gain(
    design: Design,
    fit: Fit,
    *,
    repeats: int = 20,
    seed: int = 1,
    engine: Engine = "native",
    workers: int | None = None,
    progress: Progress | None = None,
) -> GainCheck:
    """Draw true values from the posterior, simulate recordings of the experiment, and fit these.

    The prior of each fit is the Gaussian approximation of the posterior. The delay of the new recording is fitted as
    well."""
    rng = np.random.default_rng(seed)
    with WorkerPool(workers) as pool:
        predictor = ExperimentPredictor(fit, design.time, design.limits, engine, workers, pool)
        errors = []
        for k, child in enumerate(rng.spawn(repeats)):
            if progress is not None:
                progress("simulated check", k / repeats, "")
            error = _repetition(predictor, design, child)
            if error is not None:
                errors.append(error)
        if not errors:
            raise CannotFinishError("no repetition of the proposed experiment could be simulated and fitted")
        slope = predictor.shared.jacobian(predictor.values)
        realised = np.sqrt(np.mean(np.square(errors), axis=0)) * slope
        before = np.array([e.sd_before for e in design.expected])
        after = np.array([e.sd_after for e in design.expected])
        names = predictor.shared.names
        return GainCheck(
            dict(zip(names, (after / before).tolist(), strict=True)),
            dict(zip(names, (realised / before).tolist(), strict=True)),
            repeats,
            repeats - len(errors),
        )


def _repetition(predictor: ExperimentPredictor, design: Design, rng: np.random.Generator) -> FloatArray | None:
    """Return errors of the shared parameters in search coordinates, or None."""
    truth = predictor.draws(1, rng)[0]
    delay = predictor.delay
    late = float(rng.uniform(delay.lower, delay.upper)) if delay is not None else predictor.delay_value
    noise = [predictor.fit.noise[name] for name in predictor.fit.calibration.data.outputs]
    experiment = simulated_experiment(predictor, design, np.append(truth, late), noise, rng)
    found = refit_experiment(predictor, experiment, noise) if experiment is not None else None
    return None if found is None else found[0] - predictor.shared.to_search(truth)


def simulated_experiment(
    predictor: ExperimentPredictor,
    proposed: Design | Separation,
    values: FloatArray,
    noise: Sequence[OutputNoise],
    rng: np.random.Generator,
) -> Experiment | None:
    """Simulate a recording of a proposed experiment."""
    outputs = predictor.fit.calibration.data.outputs
    experiment = replace(predictor.experiment(proposed.values, proposed.time), outputs=outputs)
    with predictor.open(predictor.problem([experiment])) as simulator:
        result = simulator.simulate(values[None])
    if result.outcomes[0, 0] != Outcome.OK:
        return None
    readings = result.outputs[0][0] + np.stack([_simulate_noise(proposed.time, n, rng) for n in noise], axis=1)
    return replace(experiment, measured=readings)


def refit_experiment(
    predictor: ExperimentPredictor, experiment: Experiment, noise: Sequence[OutputNoise]
) -> tuple[FloatArray, float] | None:
    """Find the posterior mode of the shared parameters in search coordinates, from a Gaussian prior and new readings.

    The second value is the negative log-posterior there, without the normalisation of the prior. None if the fit did
    not converge."""
    shared, count = predictor.shared, len(predictor.shared)
    free = ParameterSet((*shared, *((predictor.delay,) if predictor.delay is not None else ())))
    precision = np.zeros((len(free), len(free)))
    precision[:count, :count] = predictor.precision()
    centre = np.append(shared.to_search(predictor.values), np.zeros(len(free) - count))
    rows = np.array([[[n.as_row() for n in noise]]])
    known = (centre, precision)
    with predictor.open(predictor.problem([experiment])) as simulator:

        def quadratic(point: FloatArray) -> QuadraticModel | None:
            return _posterior(simulator, free, point, known, rows, predictor.delay_value)

        start = centre.copy()
        if predictor.delay is not None:
            start = _best_delay(simulator, free, centre, rows)
        result = levenberg_marquardt(FixedCost(quadratic), start, *free.box, LocalSettings(tolerance=REFIT_TOLERANCE))
    return (result.point[:count], result.cost) if result.reason.converged else None


def _best_delay(simulator: Simulator, free: ParameterSet, centre: FloatArray, noise: FloatArray) -> FloatArray:
    """Start with the delay at the best of a grid: its likelihood has a local optimum between any two samples."""
    low, high = free.box
    starts = np.tile(centre, (21, 1))
    starts[:, -1] = np.linspace(low[-1], high[-1], 21)
    found = simulator.log_likelihood(free.from_search(starts), noise).log_likelihood[:, 0]
    return np.asarray(starts[int(np.argmax(found))])


def _posterior(
    simulator: Simulator,
    free: ParameterSet,
    point: FloatArray,
    known: tuple[FloatArray, FloatArray],
    noise: FloatArray,
    delay: float,
) -> QuadraticModel | None:
    """Compute the negative log-posterior at a point (p,); ``known`` is the mean and the precision of the prior."""
    centre, precision = known
    values = free.from_search(point[None])
    full = values if len(free) == len(simulator.problem.targets[0]) else np.append(values, [[delay]], axis=1)
    data = simulator.gauss_newton(full, noise, active=range(len(free)))
    slope = free.jacobian(values)[0]
    away = point - centre
    cost = -float(data.log_likelihood[0]) + 0.5 * float(away @ precision @ away)
    if not np.isfinite(cost):
        return None
    hessian = data.hessian[0] * np.outer(slope, slope) + precision
    return QuadraticModel(cost, data.gradient[0] * slope + away @ precision, hessian)


def _simulate_noise(time: FloatArray, noise: OutputNoise, rng: np.random.Generator) -> FloatArray:
    """Draw white and Ornstein-Uhlenbeck noise at increasing times (n,)."""
    out = noise.sd_white * rng.standard_normal(time.size)
    if noise.sd_ou > 0.0:
        rho = np.exp(-np.diff(time) / noise.tau)
        kick = noise.sd_ou * rng.standard_normal(time.size)
        slow = kick[0]
        out[0] += slow
        for k in range(1, time.size):
            slow = rho[k - 1] * slow + np.sqrt(1.0 - rho[k - 1] ** 2) * kick[k]
            out[k] += slow
    return out
