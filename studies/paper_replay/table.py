"""Table 1, row by row: the paper's five models in their variants, then the models fitted to all outputs at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from paper_replay.evaluator import ModelEvaluator
from paper_replay.published import FMINCON, PSO, PSO_DATASHEET, TABLE_PARAMETERS, TRANSFER, UNOPTIMISED, Published
from paper_replay.result import JOINT, PAPER, RERUN, SCALED, Details, ReplayRow, Variant

FloatArray = NDArray[np.float64]

#: A second rerun of the fourth model.
INTERIOR_POINT = replace(FMINCON, label="fmincon interior")
LINEAR_LAW, QUADRATIC_LAW = "Linear law", "Quadratic law"
_DATASHEET = {name: UNOPTIMISED.parameters[name] for name in ("R_a", "L_a")}


def build(
    linear: ModelEvaluator, transfer: ModelEvaluator, details: Details
) -> tuple[tuple[ReplayRow, ...], dict[str, FloatArray]]:
    """Build all rows, and the pitch of those that Fig. 6 shows."""
    swarm, scaled = details.swarm[-1].values, details.swarm_scaled[-1].values
    line, interior, exact = (ends[-1].values for ends in (details.line_search, details.interior_point, details.exact))
    entries: list[tuple[Published, Variant, ModelEvaluator, Mapping[str, float], str]] = [
        (UNOPTIMISED, PAPER, linear, UNOPTIMISED.model_values, "linear law, as the units say"),
        (PSO, PAPER, linear, PSO.model_values, "the rotor hardly turns"),
        (PSO, RERUN, linear, swarm, "8 particles, linear axes"),
        (PSO, SCALED, linear, scaled, "8 particles, log axes"),
        (PSO_DATASHEET, PAPER, linear, PSO_DATASHEET.model_values, "the rotor hardly turns"),
        (PSO_DATASHEET, RERUN, linear, dict(swarm) | _DATASHEET, "R_a and L_a put back"),
        (PSO_DATASHEET, SCALED, linear, dict(scaled) | _DATASHEET, "R_a and L_a put back"),
        (FMINCON, PAPER, linear, FMINCON.model_values, "only J_r + J_s acts"),
        (FMINCON, RERUN, linear, line, "steps of 0.1, line search"),
        (INTERIOR_POINT, RERUN, linear, interior, "steps of 0.1, linear axes"),
        (FMINCON, SCALED, linear, exact, "exact slopes, log axes"),
        (TRANSFER, PAPER, transfer, transfer.start, "0.0011 N·m/V, no motor in it"),
    ]
    rows, pitch = [], {}
    for published, variant, evaluator, values, note in entries:
        outputs = evaluator.simulate(evaluator.vector(values))[0]
        errors = dict(zip(evaluator.outputs, (evaluator.measured - outputs).T, strict=True))
        row = _row(published.label, variant, values, note, errors)
        if variant == PAPER:
            row = replace(row, paper_fitness=published.fitness)
            pitch[published.label] = outputs[:, evaluator.outputs.index("theta")]
        rows.append(row)
    for label, fit, note in (
        (LINEAR_LAW, details.linear, "c_m, D_p, K_sp, delay free too"),
        (QUADRATIC_LAW, details.quadratic, "k_d in N·m·s²/rad², k_t in N·s²/rad²"),
    ):
        known = {name: estimate.value for name, estimate in fit.parameters.items() if estimate.value is not None}
        rows.append(_row(label, JOINT, known, note, dict(zip(fit.outputs, fit.residuals[0].T, strict=True))))
    pitch["Joint fit"] = details.quadratic.fitted[0][:, details.quadratic.outputs.index("theta")]
    return tuple(rows), pitch


def _row(
    label: str, variant: Variant, values: Mapping[str, float], note: str, errors: Mapping[str, FloatArray]
) -> ReplayRow:
    """Make a row from the errors of each output; a simulation that failed has no fitness and says so."""
    shown = {name: float(values[name]) for name in TABLE_PARAMETERS if name in values}
    if any(np.isnan(error).all() for error in errors.values()):
        return ReplayRow(label, variant, shown, None, None, f"the simulation failed; {note}", {})
    rms = {name: float(np.sqrt(np.nanmean(error**2))) for name, error in errors.items()}
    return ReplayRow(label, variant, shown, float(np.nansum(errors["theta"] ** 2)), None, note, rms)
