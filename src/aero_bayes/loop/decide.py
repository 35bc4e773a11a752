"""What to make of the evidence: an explanation leaves little, and it holds on data that it has not seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.check.structure import TIMES_FLOOR, ResidualReport, those_structured
from aero_bayes.errors import CannotFinishError
from aero_bayes.loop.conclusion import CANNOT, Conclusion, nothing_added
from aero_bayes.loop.extend import add_effects
from aero_bayes.loop.judge import Prediction, surely_worse
from aero_bayes.loop.learn import learn
from aero_bayes.loop.rounds import Selection
from aero_bayes.loop.search import Found
from aero_bayes.loop.stand import Held
from aero_bayes.loop.workbench import Workbench
from aero_bayes.show import listed

#: A model that leaves less than this share of the error on data that was not fitted carries over to it.
CARRIES_OVER = 0.1
#: What other effects may leave of it in some output, to be named where those found first do not carry over; and how
#: many are tried.
PLAINLY, MOST = 0.5, 6
#: The same where they leave far more than noise.
PARTLY = 0.25
#: Share of the unseen error that what is named may leave in some output, where it leaves structure too. Structure that
#: is less than so much above the noise is not seen.
VISIBLY = 0.9
#: Share of what fewer effects leave of the unseen that more may leave to be named though chance could have it so.
MUCH = 2.0 / 3.0
#: What they may leave then, in standard deviations of the readings: a model that is lost either way tells nothing.
FOLLOWS = 1.0 / 3.0
#: How many times the unseen error a curve may leave in some output where it leaves less in none.
WORSE = 1.05
#: How many standard deviations of its own uncertainty a prediction may be off on data that was not fitted.
SENSITIVE = 4.0


def decide(bench: Workbench, found: Found) -> Conclusion:
    """Name the effects, else a learned curve, else leave the model as it is; what is named must carry over.

    What the engineer required is added whatever the evidence.
    """
    selection = found.selection
    if bench.settings.attribute.require:
        return add_effects(bench, found)
    refused, hardly = "", None
    if selection.effects and not _incomplete(found, bench.settings.left_over):
        named, refused = _added(bench, found)
        if named is not None and not refused:
            hardly = _what_carries_over(bench, found, named)
            if hardly.effects:
                return hardly
        elif (other := _other(bench, found)) is not None:
            return _what_carries_over(bench, found, other)
    tried = learn(bench, found) if refused or those_structured(found.left) else None
    if tried is not None:
        if (curve := _learned(bench, found, tried)) is not None:
            return curve
        found = replace(found, selection=replace(selection, rounds=tried.rounds))
    if hardly is not None:
        return replace(hardly, found=found)
    if refused and (part := _partial(bench, found)) is not None:
        return _what_carries_over(bench, found, part)
    return _as_it_stands(bench, found, refused)


def _as_it_stands(bench: Workbench, found: Found, refused: str) -> Conclusion:
    """Nothing is added; a model that fits is adequate only if it is not astray."""
    plain = nothing_added(bench, found, refused)
    if plain.outcome == "adequate" and (off := _astray(bench, found, plain)):
        unseen = (
            f"What was fitted asks for no more, but on data that was not, the model is far off: {off}. What was fitted "
            "does not show what is missing, or does not fix the parameters well enough."
        )
        return replace(plain, outcome="unexplained", sentence=unseen)
    if plain.outcome == "adequate" and (far := _far(bench, found, plain)):
        return _said_sensitive(plain, far)
    return plain


def _said_sensitive(told: Conclusion, far: Mapping[tuple[str, str], float]) -> Conclusion:
    sensitive = (
        f"Data that was not fitted is sensitive to the parameters: {_in_words(far)}, as their uncertainty lets expect."
    )
    return replace(told, sentence=f"{told.sentence} {sensitive}")


def _what_carries_over(bench: Workbench, found: Found, named: Conclusion) -> Conclusion:
    """What is named, no more of it than predicts the unseen better; where some structure is left, surely so, if at all.

    While structure is left the noise is not known, and evidence is surer of itself than it should be. Half of the
    unseen error is not had by chance.
    """
    named = _no_more_than_needed(bench, found, named)
    if not _is_open(named):
        return named
    sure = surely_worse(found.before, named.after, bench.recordings)
    if sure and not _visible(named.reports):
        return named
    if _plainly_better(found.before, named.after, VISIBLY if sure else PLAINLY):
        return named
    explain = "explain" if len(named.effects) > 1 else "explains"
    sentence = (
        f"The residual is structured; {listed([effect.id for effect in named.effects])} {explain} part of it where it "
        "was fitted, but data that was not is predicted hardly better. The missing physics is something else, or the "
        "parameters are not the best ones."
    )
    return replace(nothing_added(bench, found, ""), outcome="unexplained", sentence=sentence)


def _loses(before: Prediction, after: Prediction) -> bool:
    """Whether what was not fitted is predicted no better in any output, and plainly worse in some."""
    pairs = [(before.test[key].rms, error.rms) for key, error in after.test.items()]
    return all(new >= old for old, new in pairs) and any(new > WORSE * old for old, new in pairs)


def _is_open(named: Conclusion) -> bool:
    """Whether structure is left, and unseen data can say more."""
    return bool(named.after.test) and bool(those_structured(named.reports))


def _visible(reports: Sequence[ResidualReport]) -> list[ResidualReport]:
    """Those with structure that stands out of the noise: noise that is no simple process leaves a little too."""
    return [report for report in those_structured(reports) if report.ratio >= 1.0 / VISIBLY]


def _no_more_than_needed(bench: Workbench, found: Found, named: Conclusion) -> Conclusion:
    """What is named, or fewer effects that surely predict the unseen better; while structure is left, not worse."""
    count = len(named.effects)
    fewer = [held for held in _fits(found) if 0 < len(held.effects) < count]
    for _, held, after in sorted(_predicted(bench, fewer), key=lambda one: (len(one[1].effects), one[0])):
        worse = surely_worse(after, named.after, bench.recordings) or _plainly_better(after, named.after, MUCH)
        enough = _is_open(named) or surely_worse(named.after, after, bench.recordings)
        if enough and not worse and (kept := _with(bench, found, held)[0]) is not None:
            return kept
    return named


def _other(bench: Workbench, found: Found) -> Conclusion | None:
    """What explains what was fitted as well, or stood after an earlier round, and plainly carries over."""
    for held in _fits(found)[:MOST]:
        named, refused = _with(bench, found, held)
        if named is None or refused:
            continue
        if _plainly_better(found.before, named.after):
            return named
    return None


def _learned(bench: Workbench, found: Found, selection: Selection) -> Conclusion | None:
    """A curve that explains what no listed law does, and carries over."""
    if not selection.effects:
        return None
    found = replace(found, selection=selection, left=found.base.report(selection.held))
    if _incomplete(found, bench.settings.left_over):
        return None
    named, refused = _added(bench, found)
    if named is None or refused or _loses(found.before, named.after):
        return None
    told = _what_carries_over(bench, found, named)
    return told if told.effects else None


def _partial(bench: Workbench, found: Found) -> Conclusion | None:
    """What is no whole explanation, but predicts data that was not fitted several times better.

    That is a discovery: such a gain is not had by chance. What it leaves is said.
    """
    predicted = _predicted(bench, [found.selection.held, *_fits(found)][: MOST + 1])
    bar = found.before.log_unseen + math.log(PLAINLY)
    for _, held, _ in sorted((one for one in predicted if one[0] < bar), key=lambda one: one[0]):
        named, _ = _added(bench, replace(found, selection=_only(found.selection, held)))
        if named is None or not _follows(bench, named):
            continue
        if _plainly_better(found.before, named.after, PARTLY):
            return replace(named, sentence=f"{named.sentence} More is missing than that.")
    return None


def _follows(bench: Workbench, named: Conclusion) -> bool:
    """Whether every reading that was not fitted is followed, not only missed by less."""
    recordings = (*bench.recordings.train, *bench.recordings.test)
    spread = {(r.name, o): float(np.nanstd(y)) for r in recordings for o, y in r.outputs.items()}
    return all(error.rms < FOLLOWS * spread[key] for key, error in named.after.test.items())


def _predicted(bench: Workbench, fits: Sequence[Held]) -> list[tuple[float, Held, Prediction]]:
    """Fits as the search left them with what they leave of unseen data; those that cannot be simulated there not."""
    found = []
    for held in fits:
        with suppress(CannotFinishError):
            after = bench.unseen.predict(held.stand.study.calibration, held.optimum)
            found.append((after.log_unseen, held, after))
    return found


def _added(bench: Workbench, found: Found) -> tuple[Conclusion | None, str]:
    """The model with the selected effects, and where it is astray; None where it cannot be simulated over all data."""
    try:
        named = add_effects(bench, found)
    except CannotFinishError:
        return None, CANNOT
    far, refused = _far(bench, found, named), _astray(bench, found, named)
    return (_said_sensitive(named, far) if far and not refused else named), refused


def _fits(found: Found) -> list[Held]:
    """What the rounds chose, and what was as good, likeliest first; not what was selected in the end."""
    selection = found.selection
    fits = {frozenset(selection.effects): selection.held}
    for r in selection.rounds:
        for s in r.scores if r.chosen is not None else ():
            if s.held is not None and (s is r.chosen or s.candidate.id in r.equivalent):
                fits.setdefault(frozenset(s.held.effects), s.held)
    others = [held for held in list(fits.values())[1:] if len(held.effects) <= len(selection.effects)]
    return sorted(others, key=lambda held: -held.log_evidence)


def _with(bench: Workbench, found: Found, held: Held) -> tuple[Conclusion | None, str]:
    """Other effects named in place of those selected, where they explain what was fitted."""
    selection = found.selection
    part = replace(found, selection=_only(selection, held), left=found.base.report(held))
    if _incomplete(part, bench.settings.left_over):
        return None, ""
    named, refused = _added(bench, part)
    if named is None:
        return None, refused
    more = [effect for effect in selection.effects if effect not in held.effects]
    beside = " beside" if len(held.effects) + len(more) == len(selection.effects) else ""
    do = "do" if len(more) > 1 else "does"
    told = f"{named.sentence} {listed(more)}, found{beside} at first, {do} not surely carry over better."
    return replace(named, sentence=told), refused


def _only(selection: Selection, held: Held) -> Selection:
    """Another fit selected, with what the data cannot tell from its effects."""
    same = tuple(ids for ids in selection.equivalent if set(ids) & set(held.effects))
    return replace(selection, held=held, equivalent=same)


def _plainly_better(before: Prediction, after: Prediction, share: float = PLAINLY) -> bool:
    """Whether the error on data that was not fitted is far smaller in some output, and in none larger.

    An output that the missing effect does not reach, such as another motor's speed, has nothing to gain.
    """
    pairs = [(before.test[key], error) for key, error in after.test.items()]
    gained = any(error.rms < share * old.rms for old, error in pairs)
    return gained and all(error.rms <= old.rms + error.sd for old, error in pairs)


def _incomplete(found: Found, left_over: float) -> bool:
    """Whether so much is left beside the named effects that they are not the explanation.

    That is so if structure is left to see, and either most of what exceeded the noise floor is still there, in all or
    in an output that is far from its floor, or the structure would gain a good part of what the effects have gained.
    """
    structured = _visible(found.left)
    if not structured:
        return False
    gained = found.selection.held.log_evidence - found.selection.base.log_evidence
    left = sum(
        max((t.statistic - t.freedom) / 2.0 for t in report.tests if t.name != "autocorrelation")
        for report in structured
    )
    before = {(report.recording, report.output): report for report in found.base.reports}
    far = [report for report in structured if report.ratio > TIMES_FLOOR]
    return (
        _excess(found.left) > left_over * _excess(found.base.reports)
        or any(_excess([r]) > left_over * _excess([before[r.recording, r.output]]) for r in far)
        or left > left_over * gained
    )


def _excess(reports: Sequence[ResidualReport]) -> float:
    """Squared error above the noise floors, in squared floors, summed over outputs and recordings."""
    return sum(max(report.ratio**2 - 1.0, 0.0) for report in reports)


def _astray(bench: Workbench, found: Found, extended: Conclusion) -> str:
    """Where a model is farther off on data that was not fitted than its parameters' uncertainty explains; empty where
    it is not."""
    far = _far(bench, found, extended)
    if not far:
        return ""
    unsure = bench.unseen.uncertainty_of(extended.calibration, extended.refit)
    before, after = found.before.test, extended.after.test
    # What is sensitive excuses nothing that made it worse.
    excused = {
        key for key in far
        if after[key].rms <= min(SENSITIVE * unsure[key], before[key].rms + after[key].sd)
    }  # fmt: skip
    return _in_words({key: ratio for key, ratio in far.items() if key not in excused})


def _far(bench: Workbench, found: Found, extended: Conclusion) -> dict[tuple[str, str], float]:
    """How many times what the fit leaves a model is off on data that was not fitted, where that is too much."""
    settled = {(r.recording, r.output): r.rms for r in extended.reports if r.verdict == "adequate"}
    far: dict[tuple[str, str], float] = {}
    for (name, output), error in extended.after.test.items():
        own = [rms for (_, other), rms in settled.items() if other == output]
        expected = max([extended.refit.noise[output].sd, found.base.floors.get((name, output), 0.0), *own])
        carries_over = error.rms < CARRIES_OVER * found.before.test[name, output].rms
        if error.rms > bench.settings.astray * expected and not carries_over:
            far[name, output] = error.rms / expected
    return far


def _in_words(far: Mapping[tuple[str, str], float]) -> str:
    """Outputs with the worst of their ratios."""
    worst: dict[str, float] = {}
    for (_, output), ratio in far.items():
        worst[output] = max(ratio, worst.get(output, 0.0))
    return ", ".join(f"{output} ({ratio:.2g} times what the fit leaves)" for output, ratio in worst.items())
