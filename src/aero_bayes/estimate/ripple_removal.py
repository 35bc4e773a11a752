"""Subtract ripple that is locked to a rotor from the readings of outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.sensors.ripple import Ripple, find_ripples
from aero_bayes.simulation.model import Model


def without_ripple(
    data: MeasuredData, model: Model, fitted: Sequence[FloatArray]
) -> tuple[MeasuredData, dict[str, dict[str, Ripple]]]:
    """Return the data with ripple locked to a rotor subtracted, and what was subtracted by recording and output."""
    by_output = [model.units[o] for o in data.outputs]
    experiments, found = [], {}
    for experiment, name, y, f in zip(data.experiments, data.names, data.measured, fitted, strict=True):
        own = find_ripples(experiment.time, y, f, data.outputs, by_output)
        cleaned = y.copy()
        for output, ripple in own.items():
            cleaned[:, data.outputs.index(output)] -= ripple.values
        if own:
            found[name] = own
        experiments.append(replace(experiment, measured=cleaned))
    return (data.with_experiments(experiments) if found else data), found
