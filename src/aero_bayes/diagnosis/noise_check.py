"""The row of the noise: its form in each output."""

from __future__ import annotations

from aero_bayes.display import join_names
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit


def check_noise(fit: Fit) -> DiagnosisRow:
    """Tell which outputs have noise that is not white."""
    correlated = {o: n for o, n in fit.noise.items() if n.kind == "ou"}
    if not correlated:
        return DiagnosisRow("noise", False, "The noise was taken as white in every output.")
    return DiagnosisRow(
        "noise", True, f"The noise of {join_names(list(correlated))} is correlated over time.",
        ", ".join(f"{o}: over {n.tau:.3g} s" for o, n in correlated.items()), "Intervals use it.",
    )  # fmt: skip
