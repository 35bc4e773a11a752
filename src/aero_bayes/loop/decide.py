"""What to make of the evidence: an explanation leaves little, and it holds on data that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aero_bayes.check.structure import ResidualReport
from aero_bayes.loop.conclusion import Conclusion, nothing_added
from aero_bayes.loop.extend import add_curve, add_effects
from aero_bayes.loop.judge import Prediction
from aero_bayes.loop.search import Found
from aero_bayes.loop.workbench import Workbench

#: A model that leaves less than this share of the error on data that was not fitted carries over to it.
CARRIES_OVER = 0.1
#: What a part of the effects may leave of it in some output, to be named where all of them together do not carry over.
PLAINLY = 0.5


def decide(bench: Workbench, found: Found) -> Conclusion:
    """Name the effects, else a learned curve, else leave the model as it is; what is named must carry over.

    What the engineer required is added whatever the evidence.
    """
    selection, rival = found.selection, found.rival
    if bench.settings.attribute.require:
        return add_effects(bench, found)
    if rival.curve is not None:
        return add_curve(bench, found, rival.curve)
    refused = ""
    if selection.effects and rival.moment is None and not _incomplete(found, bench.settings.left_over):
        named = add_effects(bench, found)
        refused = _astray(found, named, bench.settings.astray)
        if not refused:
            return named
        best = rival.best_curve
        if best is not None and best.refit.log_evidence > selection.base.log_evidence + selection.rounds[0].threshold:
            learned = add_curve(bench, found, best)
            if not _astray(found, learned, bench.settings.astray):
                return learned
        fewer = _fewer(bench, found)
        if fewer is not None:
            return fewer
    return nothing_added(bench, found, refused)


def _fewer(bench: Workbench, found: Found) -> Conclusion | None:
    """What stood after an earlier round, where all effects together do not carry over but those plainly do."""
    selection = found.selection
    chosen = [r.chosen.held for r in selection.rounds if r.chosen is not None and r.chosen.held is not None]
    tried = {frozenset(selection.effects)}
    for held in sorted(chosen, key=lambda h: -h.log_evidence):
        if frozenset(held.effects) in tried or len(held.effects) > len(selection.effects):
            continue
        tried.add(frozenset(held.effects))
        left = found.base.report(held)
        part = replace(found, selection=replace(selection, held=held, equivalent=()), left=left)
        if _incomplete(part, bench.settings.left_over):
            continue
        named = add_effects(bench, part)
        if _plainly_better(found.before, named.after) and not _astray(part, named, bench.settings.astray):
            return named
    return None


def _plainly_better(before: Prediction, after: Prediction) -> bool:
    """Whether the error on data that was not fitted is far smaller in some output, and in none larger.

    An output that the missing effect does not reach, such as another motor's speed, has nothing to gain.
    """
    pairs = [(before.test[key], error) for key, error in after.test.items()]
    gained = any(error.rms < PLAINLY * old.rms for old, error in pairs)
    return gained and all(error.rms <= old.rms + error.sd for old, error in pairs)


def _incomplete(found: Found, left_over: float) -> bool:
    """Whether so much is left beside the named effects that they are not the explanation.

    That is so if structure is left, and either most of what exceeded the noise floor is still there, or the structure
    would gain a good part of what the effects have gained.
    """
    structured = [report for report in found.left if report.verdict == "structured"]
    if not structured:
        return False
    gained = found.selection.held.log_evidence - found.selection.base.log_evidence
    left = sum(
        max((t.statistic - t.freedom) / 2.0 for t in report.tests if t.name != "autocorrelation")
        for report in structured
    )
    return _excess(found.left) > left_over * _excess(found.base.reports) or left > left_over * gained


def _excess(reports: Sequence[ResidualReport]) -> float:
    """Squared error above the noise floors, in squared floors, summed over outputs and recordings."""
    return sum(max(report.ratio**2 - 1.0, 0.0) for report in reports)


def _astray(found: Found, extended: Conclusion, most: float) -> str:
    """Where the extended model is far off on data that was not fitted; empty where it is not."""
    settled = {(r.recording, r.output): r.rms for r in extended.reports if r.verdict == "adequate"}
    off: dict[str, float] = {}
    for (name, output), error in extended.after.test.items():
        own = [rms for (_, other), rms in settled.items() if other == output]
        expected = max([extended.refit.noise[output].sd, found.base.floors.get((name, output), 0.0), *own])
        carries_over = error.rms < CARRIES_OVER * found.before.test[name, output].rms
        if error.rms > most * expected and not carries_over:
            off[output] = max(error.rms / expected, off.get(output, 0.0))
    return ", ".join(f"{output} ({ratio:.2g} times what the fit leaves)" for output, ratio in off.items())
