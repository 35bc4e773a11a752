"""What the loop concludes: an outcome, the model behind it with its fit, and the sentence that says why."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from aero_bayes.check.structure import TIMES_FLOOR, ResidualReport, those_structured
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum
from aero_bayes.loop.judge import Prediction, gain_text
from aero_bayes.loop.result import FoundEffect, LoopOutcome
from aero_bayes.loop.search import Found
from aero_bayes.loop.workbench import Workbench
from aero_bayes.physics.kin import Extension
from aero_bayes.show import listed

#: Why something found is refused that stops the simulation of other data.
CANNOT = "it cannot be simulated there"


@dataclass(frozen=True, eq=False)
class Conclusion:
    """One way to end the loop.

    ``found`` is the evidence that it rests on, with the selection that it names. ``written`` is the extended model,
    None where nothing is added. ``refit`` is the last fit, of ``calibration``; ``reports`` is what it leaves and
    ``after`` what it predicts.
    """

    found: Found
    outcome: LoopOutcome
    sentence: str
    written: Extension | None
    effects: tuple[FoundEffect, ...]
    calibration: Calibration
    refit: Optimum
    reports: tuple[ResidualReport, ...]
    after: Prediction


def nothing_added(bench: Workbench, found: Found, refused: str) -> Conclusion:
    """Leave the model as it is, either because it is adequate or because what was found is no explanation.

    ``refused`` says where the named effects are far off on data that was not fitted; empty where they are not, or
    where none is named.
    """
    base, selection = found.base, found.selection
    after = found.before
    adequate = not selection.effects and not those_structured(base.reports)
    sentence = _sentence(found, refused)
    if selection.effects and refused != CANNOT:
        sentence += _what_they_gain(bench, found)
    return Conclusion(
        found, "adequate" if adequate else "unexplained", sentence, None, (), base.plain, base.fit, base.reports, after
    )


def _what_they_gain(bench: Workbench, found: Found) -> str:
    """What effects that are not named gain all the same where nothing was fitted; empty if nothing."""
    held = found.selection.held
    with suppress(CannotFinishError):
        after = bench.unseen.predict(held.stand.study.calibration, held.optimum)
        if after.log_unseen < found.before.log_unseen:
            them = "them" if len(held.effects) > 1 else "it"
            return f" With {them} all the same, {gain_text(found.before, after, bench.units)}"
    return ""


def _how(report: ResidualReport) -> str:
    """What tells that a residual is no noise."""
    if report.ratio > TIMES_FLOOR or not report.tests:
        return "is far from it"
    plainest = min(report.tests, key=lambda t: t.p_value).name
    return {"autocorrelation": "is not white", "slow": "drifts"}.get(plainest, f"depends on {plainest}")


def _sentence(found: Found, refused: str) -> str:
    """Why nothing is added."""
    selection = found.selection
    best = listed(selection.effects)
    explain, is_ = ("explain", "are") if len(selection.effects) > 1 else ("explains", "is")
    if refused == CANNOT:
        return (
            f"The residual is structured; {best} {explain} it where it was fitted, but with {best} "
            "the model cannot be simulated on data that was not."
        )
    if refused:
        return (
            f"The residual is structured; {best} {explain} it where it was fitted but {is_} far off on data that was "
            f"not: {refused}. The missing physics is something else."
        )
    if selection.effects:
        left = ", ".join(sorted({r.output for r in those_structured(found.left)}))
        return (
            f"The residual is structured; {best} {explain} part of it, but what is left in {left} says that the "
            "missing physics is something else."
        )
    first = selection.rounds[0] if selection.rounds else None
    structured = those_structured(found.base.reports)
    if structured:
        worst = max(structured, key=lambda r: r.ratio)
        return (
            f"The residual of {worst.output} is structured ({worst.ratio:.2g} times the noise floor; it "
            f"{_how(worst)}), but no effect of the catalogue explains it: {first.why if first else 'none was tried'}."
        )
    return f"The model is adequate for these recordings: {first.why if first else 'the residual is noise'}."
