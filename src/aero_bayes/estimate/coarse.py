"""A cheaper problem that leads a search to the same valley: few samples, and few changes of the input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.calibration import Calibration, thin
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, Simulator

FloatArray = NDArray[np.float64]

#: Error of an output at the start, as a share of its range, up to which averaged inputs are good enough.
CLOSE = 0.05
#: Samples of a stretch that is taken in full where averaged inputs are not, as a multiple of the samples asked for.
STRETCH = 3
#: Steps a sample, and tolerance, of a simulation that only leads the way.
STEPS, TOLERANCE = 10, 1e-4


def leading(calibration: Calibration, simulator: Simulator, samples: int) -> Calibration:
    """The calibration on about ``samples`` samples a recording, whose simulations cost as little.

    An input that changes at every sample makes an engine restart there however few outputs are asked for: it is
    averaged over blocks where the outputs stay close, else only the beginning of the recording is used.

    Parameters
    ----------
    calibration : Calibration
    simulator : Simulator
        Of the calibration's problem.
    samples : int
    """
    # A search of the whole box meets models that are far too fast: each is given up after a few steps a sample.
    hurried = replace(calibration.solver, max_steps=STEPS * STRETCH * samples, relative_tolerance=TOLERANCE)
    calibration = replace(calibration, solver=hurried)
    thinned = calibration.thinned(samples)
    if max(s.time.size for e in calibration.experiments for s in e.inputs or (_STILL,)) <= 2 * samples:
        return thinned
    averaged = replace(thinned, experiments=tuple(_averaged(e, samples) for e in thinned.experiments))
    if _close(calibration, simulator, averaged):
        return averaged
    return replace(calibration, experiments=tuple(_beginning(e, STRETCH * samples) for e in calibration.experiments))


_STILL = InputSignal("", np.zeros(1), np.zeros(1))


def _averaged(experiment: Experiment, samples: int) -> Experiment:
    return replace(experiment, inputs=tuple(_blocks(signal, samples) for signal in experiment.inputs))


def _blocks(signal: InputSignal, samples: int) -> InputSignal:
    """A held input by its averages over blocks of equal length."""
    if signal.interpolation != "hold" or signal.time.size <= 2 * samples:
        return signal
    start, stop = signal.time[1], signal.time[-1]
    edges = np.linspace(start, stop, samples + 1)
    area = np.concatenate(([0.0], np.cumsum(signal.values[:-1] * np.diff(signal.time))))
    means = np.diff(np.interp(edges, signal.time, area)) / np.diff(edges)
    return replace(
        signal,
        time=np.concatenate(([signal.time[0]], edges)),
        values=np.concatenate(([signal.values[0]], means, [signal.values[-1]])),
    )


def _close(calibration: Calibration, simulator: Simulator, averaged: Calibration) -> bool:
    from aero_bayes.simulation import open_simulator

    start = calibration.parameters.start[np.newaxis]
    whole = simulator.simulate(start)
    with open_simulator(averaged.problem(), workers=1) as other:
        few = other.simulate(start)
    if np.any(whole.outcomes != Outcome.OK) or np.any(few.outcomes != Outcome.OK):
        return False
    for full, part, e, c in zip(whole.outputs, few.outputs, calibration.experiments, averaged.experiments, strict=True):
        rows = np.searchsorted(e.time, c.time)
        error = np.sqrt(np.mean((full[0, rows] - part[0]) ** 2, axis=0))
        if np.any(error > CLOSE * np.maximum(np.ptp(full[0], axis=0), 1e-300)):
            return False
    return True


def _beginning(experiment: Experiment, samples: int) -> Experiment:
    if experiment.time.size <= samples:
        return experiment
    stop = experiment.time[samples - 1]
    inputs = tuple(
        replace(s, time=s.time[: (n := int(np.searchsorted(s.time, stop, side="right")))], values=s.values[:n])
        for s in experiment.inputs
    )
    measured = experiment.measured[:samples] if experiment.measured is not None else None
    return thin(replace(experiment, time=experiment.time[:samples], measured=measured, inputs=inputs), samples)
