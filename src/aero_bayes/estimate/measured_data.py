"""What was measured, as experiments that a simulator repeats: readings, their names and limits, and fewer of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.reading_spread import SpreadModel
from aero_bayes.simulation.interface import Experiment, Interpolation

#: Readings of an output that a beginning holds at least.
FIRST_READINGS = 20


def rows_of_first_readings(measured: FloatArray, least: int = FIRST_READINGS) -> int:
    """Return how many rows hold the first ``least`` readings of every output (n, m), or all that it has."""
    counts = np.cumsum(np.isfinite(measured), axis=0)
    enough = counts >= np.minimum(counts[-1], least)
    return int(np.argmax(enough, axis=0).max()) + 1 if measured.size else 0


def thin(experiment: Experiment, samples: int) -> Experiment:
    """Return the experiment on every n-th of its sample times, about ``samples`` of them.

    An output that is read less often than the others keeps up to as many readings of its own."""
    every = -(-experiment.time.size // samples)
    if every <= 1:
        return experiment
    rows = np.arange(0, experiment.time.size, every)
    if experiment.measured is not None:
        own = [np.flatnonzero(np.isfinite(column)) for column in experiment.measured.T]
        kept = np.isfinite(experiment.measured[rows]).sum(axis=0)
        seldom = [r for r, count in zip(own, kept, strict=True) if count < 0.5 * min(r.size, samples)]
        for readings in seldom:
            rows = np.union1d(rows, readings[:: -(-readings.size // samples)])
    return experiment.at_samples(rows)


@dataclass(frozen=True)
class MeasuredData:
    """The experiments that a model is fitted to."""

    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    recordings: tuple[Recording, ...] = ()
    floors: Mapping[str, float] = field(default_factory=dict)
    spreads: Mapping[str, SpreadModel] = field(default_factory=dict)

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.experiments[0].outputs

    @property
    def interpolation(self) -> dict[str, Interpolation]:
        """What each input does between its samples, by name: linear where it is in any recording."""
        signals = [signal for e in self.experiments for signal in e.inputs]
        return {s.name: s.interpolation for s in sorted(signals, key=lambda s: s.interpolation == "linear")}

    @property
    def measured(self) -> tuple[FloatArray, ...]:
        """Measurements of each experiment, shape (n, m)."""
        return tuple(readings_of(e) for e in self.experiments)

    @property
    def readings(self) -> tuple[FloatArray, ...]:
        """Everything that was read at the experiments' times, (n, m), also what does not count (a standing encoder)."""
        pairs = zip(self.measured, self.raw_readings, strict=True)
        return tuple(np.where(np.isnan(measured), raw, measured) for measured, raw in pairs)

    @property
    def raw_readings(self) -> tuple[FloatArray, ...]:
        """What was recorded at the experiments' times, (n, m)."""
        if not self.recordings:
            return self.measured
        found = []
        for recording, experiment in zip(self.recordings, self.experiments, strict=True):
            rows = np.searchsorted(recording.time, experiment.time)
            gap = np.full(recording.rows, np.nan)
            found.append(np.column_stack([recording.outputs.get(o, gap)[rows] for o in experiment.outputs]))
        return tuple(found)

    @cached_property
    def scale(self) -> FloatArray:
        """Range of each output over all recordings, shape (m,): what its errors are compared with before any fit."""
        stacked = np.concatenate(self.measured)
        spread = np.fmax.reduce(stacked, axis=0) - np.fmin.reduce(stacked, axis=0)
        return np.where(spread > 0.0, spread, 1.0)

    @property
    def stop(self) -> float:
        """When the longest recording ends, in s."""
        return max(float(e.time[-1]) for e in self.experiments)

    @cached_property
    def intervals(self) -> tuple[float, ...]:
        """Sample interval of each experiment in s."""
        return tuple(float(np.median(np.diff(e.time))) for e in self.experiments)

    @property
    def count(self) -> int:
        """Number of readings of all outputs."""
        return sum(int(np.isfinite(y).sum()) for y in self.measured)

    def with_experiments(self, experiments: Iterable[Experiment]) -> MeasuredData:
        """Return the same data with its experiments changed, as many as there are."""
        return replace(self, experiments=tuple(experiments))

    def with_known_noise(self, noise: NoiseModel) -> MeasuredData:
        """Return the data with the relative noise of each recording, where outputs have a declared one in each."""
        names = [(r.part_of or r.name) for r in self.recordings]
        found = self
        for k, output in enumerate(self.outputs):
            sds = noise.sd_by_recording(output, names)
            if sds is None:
                continue
            base = math.sqrt(sum(sd * sd for sd in sds) / len(sds))
            scales = tuple(sd / base for sd in sds)
            spreads = [np.ones(y.shape) if e.spread is None else e.spread.copy()
                       for e, y in zip(found.experiments, found.measured, strict=True)]  # fmt: skip
            for spread, scale in zip(spreads, scales, strict=True):
                spread[:, k] = scale
            experiments = tuple(replace(e, spread=s) for e, s in zip(found.experiments, spreads, strict=True))
            models = {**found.spreads, output: SpreadModel("constant", base, scales=scales)}
            found = replace(found, experiments=experiments, spreads=models)
        return found

    def beginning(self, share: float) -> MeasuredData:
        """Keep the first ``share`` of each recording's samples, at least twenty readings an output, or a quarter."""
        counts = [int(np.isfinite(y).sum(axis=0).max(initial=0)) for y in self.measured]
        least = [min(FIRST_READINGS, -(-n // 4)) for n in counts]
        rows = [
            max(int(share * len(y)), rows_of_first_readings(y, n)) for y, n in zip(self.measured, least, strict=True)
        ]
        return self.with_experiments(e.at_samples(slice(n)) for e, n in zip(self.experiments, rows, strict=True))

    def thinned(self, samples: int) -> MeasuredData:
        """Keep at most about ``samples`` sample times of each recording; inputs stay as they are."""
        return self.with_experiments(thin(e, samples) for e in self.experiments)


def readings_of(experiment: Experiment) -> FloatArray:
    """Return what was measured, shape (n, m)."""
    if experiment.measured is None:
        raise InputError("an experiment without measurements cannot be fitted")
    return experiment.measured
