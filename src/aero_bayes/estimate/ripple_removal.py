"""Subtract ripple that is locked to a rotor from the readings of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.sensors.ripple import Ripple, find_ripples

FloatArray = NDArray[np.float64]


def without_ripple(
    calibration: Calibration, fitted: Sequence[FloatArray]
) -> tuple[Calibration, dict[str, dict[str, Ripple]]]:
    """Return the calibration with ripple locked to a rotor subtracted, and what was subtracted by recording and output.

    ``fitted`` holds the outputs (n, m) of each experiment. The calibration is the same where nothing was found.
    """
    units = {v.name: v.unit for v in calibration.model.outputs}
    by_output = [units.get(o, "") for o in calibration.outputs]
    experiments, found = [], {}
    for experiment, name, y, f in zip(
        calibration.experiments, calibration.names, calibration.measured, fitted, strict=True
    ):
        own = find_ripples(experiment.time, y, f, calibration.outputs, by_output)
        cleaned = y.copy()
        for output, ripple in own.items():
            cleaned[:, calibration.outputs.index(output)] -= ripple.values
        if own:
            found[name] = own
        experiments.append(replace(experiment, measured=cleaned))
    return (replace(calibration, experiments=tuple(experiments)) if found else calibration), found
