"""A cheaper problem with nearly the same optimum: few samples, and few changes of the inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.thinning import rows_of_first_readings, thin
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, Simulator

#: Largest error of an output due to averaged inputs, at the starting values, as a share of its range.
MAX_AVERAGING_ERROR = 0.05
#: Where averages are too coarse, changes of the input per sample asked for in the part that is used in full.
CHANGES_PER_SAMPLE = 2
#: Limits of the solver for a search of the whole box: steps per sample, least number of steps, relative tolerance.
STEPS_PER_SAMPLE, MIN_STEPS, LOOSE_TOLERANCE = 10, 5000, 1e-4


def with_few_samples(calibration: Calibration, simulator: Simulator, samples: int) -> Calibration:
    """Return the calibration with about ``samples`` samples of each recording, and inputs that change about as rarely.

    An input that changes at every sample makes the solver restart there, however few outputs are asked for. So it is
    averaged over blocks where the outputs stay close, else only the beginning of the recording is used."""
    data = calibration.data
    thinned = replace(calibration, data=data.thinned(samples))
    if max(s.time.size for e in data.experiments for s in e.inputs or (_CONSTANT_INPUT,)) <= 2 * samples:
        return thinned
    averaged = replace(calibration, data=data.with_experiments(_averaged(e, samples) for e in thinned.data.experiments))
    if _close(calibration, simulator, averaged):
        return averaged
    changes = CHANGES_PER_SAMPLE * samples
    shorter = data.with_experiments(thin(_beginning(e, changes), changes) for e in data.experiments)
    return replace(calibration, data=shorter)


def with_loose_solver(calibration: Calibration) -> Calibration:
    """Allow few solver steps and a loose tolerance, since models in the whole box may be very stiff."""
    samples = max(e.time.size for e in calibration.data.experiments)
    simulated, steps = calibration.simulated, max(STEPS_PER_SAMPLE * samples, MIN_STEPS)
    solver = replace(simulated.solver, max_steps=steps, relative_tolerance=LOOSE_TOLERANCE)
    return replace(calibration, simulated=replace(simulated, solver=solver))


_CONSTANT_INPUT = InputSignal("", np.zeros(1), np.zeros(1))


def _averaged(experiment: Experiment, samples: int) -> Experiment:
    return replace(experiment, inputs=tuple(_blocks(signal, samples) for signal in experiment.inputs))


def _blocks(signal: InputSignal, samples: int) -> InputSignal:
    """Return an input averaged over blocks of equal length."""
    if signal.time.size <= 2 * samples:
        return signal
    held = signal.interpolation == "hold"
    start, stop = signal.time[1 if held else 0], signal.time[-1]
    edges = np.linspace(start, stop, samples + 1)
    heights = signal.values[:-1] if held else 0.5 * (signal.values[:-1] + signal.values[1:])
    area = np.concatenate(([0.0], np.cumsum(heights * np.diff(signal.time))))
    means = np.diff(np.interp(edges, signal.time, area)) / np.diff(edges)
    if not held:
        return replace(signal, time=0.5 * (edges[1:] + edges[:-1]), values=means)
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
    experiments = zip(calibration.data.experiments, averaged.data.experiments, strict=True)
    for full, part, (e, c) in zip(whole.outputs, few.outputs, experiments, strict=True):
        rows = np.searchsorted(e.time, c.time)
        error = np.sqrt(np.mean((full[0, rows] - part[0]) ** 2, axis=0))
        if np.any(error > MAX_AVERAGING_ERROR * np.maximum(np.ptp(full[0], axis=0), 1e-300)):
            return False
    return True


def _beginning(experiment: Experiment, changes: int) -> Experiment:
    """Return the beginning of an experiment, until its inputs have changed ``changes`` times."""
    ends = [s.time[changes] for s in experiment.inputs if s.time.size > changes]
    if not ends:
        return experiment
    rows = max(int(np.searchsorted(experiment.time, min(ends))), 2)
    if experiment.measured is not None:
        rows = max(rows, rows_of_first_readings(experiment.measured))
    last = float(experiment.time[rows - 1])
    inputs = []
    for s in experiment.inputs:
        count = max(int(np.searchsorted(s.time, last, side="right")), 1)
        inputs.append(replace(s, time=s.time[:count], values=s.values[:count]))
    return replace(experiment.at_samples(slice(rows)), inputs=tuple(inputs))
