"""The row of the noise: its form in each output."""

from __future__ import annotations

from typing import cast

from aero_bayes.diagnosis.left_over import LeftOver
from aero_bayes.display import join_names, with_unit
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.noise_report import noise_by_recording
from aero_bayes.estimate.result import Fit

#: Share of rounding in the variance of a residual from which it is told: below, the noise smooths the steps.
MIN_ROUNDED_SHARE = 0.25


def check_noise(fit: Fit, left: LeftOver) -> DiagnosisRow:
    """Tell which outputs have noise that is not white."""
    unequal = fit.calibration.data.spreads
    if unequal:
        return _unequal_row(fit)
    if left.reports and all(report.exact for report in left.reports):
        sizes = ", ".join(f"{o} {rms:.1g}" for o, rms in fit.rms.items())
        return DiagnosisRow("noise", False, f"There is no noise at all: what is left ({sizes}) is rounding.")
    rounded = _rounded(fit)
    if rounded:
        units = fit.calibration.model.units
        where = ", ".join(f"{o}: steps of {with_unit(f'{step:.3g}', units.get(o, ''))}" for o, step in rounded.items())
        return DiagnosisRow("noise", True, f"{join_names(list(rounded))} is rounded to coarse counts.", where)
    correlated = {o: n for o, n in fit.noise.items() if n.kind == "ou"}
    if not correlated:
        return DiagnosisRow("noise", False, "The noise was taken as white in every output.")
    return DiagnosisRow(
        "noise", True, f"The noise of {join_names(list(correlated))} is correlated over time.",
        ", ".join(f"{o}: over {n.tau:.3g} s" for o, n in correlated.items()), "Intervals use it.",
    )  # fmt: skip


def _rounded(fit: Fit) -> dict[str, float]:
    """Find steps of the outputs whose rounding is a large part of their residual."""
    counts = {o: cast("dict[str, float]", entry["encoder"]) for o, entry in fit.sensors.items() if "encoder" in entry}
    return {o: own["step"] for o, own in counts.items() if own["share"] >= MIN_ROUNDED_SHARE}


def _unequal_row(fit: Fit) -> DiagnosisRow:
    """Tell which outputs have noise that differs from reading to reading, and by how much."""
    units = fit.calibration.model.units
    kinds, where = [], []
    for output, spread in fit.calibration.data.spreads.items():
        unit = units.get(output, "")
        if spread.scales:
            kinds.append(f"The noise of {output} differs by recording.")
            own = noise_by_recording(fit.calibration.data, output, fit.noise[output].sd)
            where.append(f"{output}: " + ", ".join(f"{with_unit(f'{sd:.2g}', unit)} in {r}" for r, sd in own.items()))
        if spread.kind == "relative":
            kinds.append(f"The noise of {output} grows with the reading.")
            base = f"{'-' if spread.base < 0.0 else '+'} {with_unit(f'{abs(spread.base):.2g}', unit)}"
            where.append(f"{output}: sd = {spread.per_unit:.2g} |{output}| {base}")
        elif spread.kind == "student":
            kinds.append(f"The noise of {output} has heavy tails.")
            where.append(
                f"{output}: Student t of scale {spread.base:.2g} {unit}, {spread.freedom:.2g} degrees of freedom"
            )
    return DiagnosisRow("noise", True, " ".join(kinds), "; ".join(where), "Fit and intervals use it.")
