"""Outputs whose residuals no noise describes, because what is left after the noise is correlated."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations_with_replacement

from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.objective import Objective
from aero_bayes.sensors import OutputNoise, correlation_p_value, is_rotor_speed, ripple_means, whiten
from aero_bayes.sensors.whiteness import FALSE_ALARM_RATE


def correlated_outputs(objective: Objective, here: Optimum, noise: Mapping[str, OutputNoise]) -> set[str]:
    """Outputs whose innovations are correlated over time, or with those of another output of the same recording.

    Sensors have noise of their own each. What two outputs have in common, and what one-step predictions leave of the
    past, is an error of the model. Outputs whose noise the user declares white are taken at that word.
    """
    units = {v.name: v.unit for v in objective.calibration.model.outputs}
    turning = {s.experiment for s in objective.series if is_rotor_speed(s.measured, units.get(s.output, ""))}
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
