"""What sensors add that is neither white nor slow: ripple locked to the rotor, and the counts of an encoder."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.data.noise import quantisation_step
from aero_bayes.inference.quantisation import Quantisation, describe_counts
from aero_bayes.inference.result import Fit, Json
from aero_bayes.inference.ripple import Ripple

#: Share of the residual's variance below which the rounding of a converter is not worth a word.
LEAST_SHARE = 1e-3


def describe_sensors(fit: Fit, ripple: Mapping[str, Mapping[str, Ripple]], *, subtracted: bool) -> dict[str, Json]:
    """What a fit shows of its sensors, by output, as result.json takes it.

    Parameters
    ----------
    fit : Fit
    ripple : mapping of str to mapping of str to Ripple
        What was found, by recording and output.
    subtracted : bool
        Whether the fit is to readings without it.

    Returns
    -------
    dict
        For each output that shows either: ``ripple`` by recording (amplitude and log-evidence of each order, noise with
        and without it), and ``encoder`` (quantum, what rounding adds, and whether the exact likelihood of counts would
        say more than a Gaussian) of the first recording that is read in counts.
    """
    table: dict[str, Json] = {}
    for output in fit.outputs:
        entry: Json = {}
        found = {name: outputs[output].to_dict() for name, outputs in ripple.items() if output in outputs}
        if found:
            entry["ripple"], entry["ripple_subtracted"] = found, subtracted
        counts = next((c for k in range(len(fit.calibration.experiments)) if (c := _counts(fit, output, k))), None)
        if counts is not None:
            entry["encoder"] = counts.to_dict()
        if entry:
            table[output] = entry
    return table


def _counts(fit: Fit, output: str, recording: int) -> Quantisation | None:
    column = fit.outputs.index(output)
    readings, residual = fit.calibration.measured[recording][:, column], fit.residuals[recording][:, column]
    if not np.isfinite(readings).any():
        return None
    step = quantisation_step(readings)
    if step is None or step**2 / 12.0 < LEAST_SHARE * float(np.nanmean(residual**2)):
        return None
    return describe_counts(fit, output, recording)
