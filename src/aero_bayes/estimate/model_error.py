"""Noise of each output at a fit, and outputs whose residuals no noise describes: what it leaves is correlated."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import combinations_with_replacement

from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.sensors import OutputNoise, correlation_p_value, is_rotor_speed, ripple_means, whiten
from aero_bayes.sensors.noise_estimation import estimate_noise
from aero_bayes.sensors.whiteness import FALSE_ALARM_RATE


def correlated_outputs(objective: Objective, here: Optimum, noise: Mapping[str, OutputNoise]) -> set[str]:
    """Find outputs whose innovations are correlated over time, or with another output of the same recording.

    Sensors have noise of their own each. What two outputs have in common, and what one-step predictions leave of the
    past, is an error of the model. Outputs whose noise the user declares white are taken at that word."""
    units = objective.calibration.model.units
    turning = {s.experiment for s in objective.series if is_rotor_speed(s.measured, units[s.output])}
    innovations = []
    for series, residual in zip(objective.series, here.evaluation.residual, strict=True):
        rows, _ = whiten(residual[None], series.sampling, noise[series.output])
        rotor = series.experiment in turning
        innovations.append(ripple_means(rows[0], series.sampling.interval) if rotor else rows[0])
    pairs = [
        (j, k)
        for j, k in combinations_with_replacement(range(len(innovations)), 2)
        if objective.series[j].experiment == objective.series[k].experiment
        and innovations[j].size == innovations[k].size
    ]
    found: set[str] = set()
    for j, k in pairs:
        if correlation_p_value(innovations[j], innovations[k]) < FALSE_ALARM_RATE / len(pairs):
            found |= {objective.series[j].output, objective.series[k].output}
    return {output for output in found if objective.calibration.noise.kind(output) == "auto"}


def estimate_output_noise(
    objective: Objective, here: Optimum, white_outputs: Collection[str] = ()
) -> dict[str, OutputNoise]:
    """Estimate noise by its exact likelihood; for ``white_outputs``, weighted by their residual, by its RMS."""
    calibration, found = objective.calibration, dict(objective.calibration.known_noise)
    scale = dict(zip(calibration.data.outputs, calibration.data.scale.tolist(), strict=True))
    for output in (o for o in objective.outputs if o not in calibration.known_noise):
        own = [k for k, s in enumerate(objective.series) if s.output == output]
        white = output in white_outputs
        n = estimate_noise(
            [objective.series[k].sampling.time for k in own],
            [objective.series[k].sampling.equalised(here.evaluation.residual[k]) for k in own],
            "white" if white else calibration.noise.kind(output),
            here.noise[output],
            max(calibration.data.floors.get(output, 0.0), 1e-7 * scale[output]),
        )
        if (spread := calibration.data.spreads.get(output)) is not None:
            n = replace(n, sd_white=n.sd_white * spread.widening, sd_ou=n.sd_ou * spread.widening)
        found[output] = replace(n, model_error=True) if white else n
    return found
