"""What the loop says: the model first, then what may be claimed of each of its terms."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from aero_bayes.check.residual_tests import ResidualReport, structured_residuals
from aero_bayes.display import join_names, with_unit
from aero_bayes.judge.prediction import Prediction, describe_error_change
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.decide import Decision
from aero_bayes.loop.extend import ExtendedFit
from aero_bayes.loop.first_fit import FirstFit
from aero_bayes.loop.found_effect import FoundEffect
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.loop.steps import Step, fall, steps_of
from aero_bayes.search.search import Search

#: Alternatives that are listed by name.
MAX_NAMED = 3
#: Share of the squared residual in a tenth of a recording from which it is one disturbance.
DISTURBANCE_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class Ended:
    """How a loop ended: the first fit, the search, what was decided on it, and the fit of the extended model."""

    first: FirstFit
    search: Search
    decision: Decision
    extended: ExtendedFit | None

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        return steps_of(self.search.table, self.decision, self.search.library.required)


def extended_sentence(context: LoopContext, ended: Ended, before: Prediction) -> str:
    """The model, the error before and after, and what is claimed of each term."""
    extended = ended.extended
    assert extended is not None
    effects = sorted(extended.effects, key=lambda e: e.kind)  # what has a name first
    change = describe_error_change(before, extended.after, context.units)
    known = all(e.claim == "law" for e in effects)
    text = f"The model {'lacks' if known else 'was extended by'} {join_names([e.id for e in effects])}: {change}"
    text += "".join(f" {_claim_sentence(e)}" for e in effects)
    text += refused_sentence(ended.decision)
    left = structured_residuals(extended.reports)
    return text + (
        f" Structure remains in the residual of {join_names(sorted({r.output for r in left}))}." if left else ""
    )


def refused_sentence(decision: Decision) -> str:
    """How many models unseen recordings refused; empty for none."""
    count = len(decision.refused)
    return f" Unseen recordings refused {count} model{'s' * (count > 1)} before it." if count else ""


def _claim_sentence(effect: FoundEffect) -> str:
    """What is claimed of a term."""
    if effect.claim is None:
        return f"{effect.id} is there as required."
    others = [one.id for one in effect.alternatives]
    named = join_names(others if len(others) <= MAX_NAMED else [*others[:MAX_NAMED], f"{len(others) - MAX_NAMED} more"])
    text = f"With {effect.id} the error of {effect.share_of} on left-out readings {fall(effect.share, effect.share_sd)}"
    if not others or effect.claim == "law":
        like = f", which looks like {effect.looks_like}" if effect.looks_like else ""
        no_law = f", but no law says what this curve is{like}" if effect.kind == "free_form" else ""
        return f"{text}; nothing else that was tried does as well{no_law}."
    told = {
        "place": "at the same place, so that the place is known and not the law",
        "one of": "so that the data do not tell which it is",
    }
    does = "do" if len(others) > 1 else "does"
    return f"{text}; {named} {does} as well{', ' if effect.claim == 'one of' else ' '}{told[effect.claim]}."


def none_sentence(ended: Ended, structured: Sequence[str], far: Mapping[str, float]) -> str:
    """Why nothing was added."""
    if far:
        ratios = ", ".join(f"{output} ({ratio:.2g} times the error of the fit)" for output, ratio in far.items())
        return (
            f"The model fits the training data, but its error on unseen data is far larger: {ratios}. The training "
            "data do not show the missing effect, or do not determine the parameters well enough."
        )
    if not structured:
        return "The model is adequate for these recordings: it leaves no more than what the sensors add."
    first, decision, steps = ended.first, ended.decision, ended.steps
    reports = [r for r in first.reports if r.output in structured]
    moment = _disturbance(reports)
    if moment is not None and not decision.refused:
        recording, start, stop = moment
        return (
            f"Most of the residual of {recording} lies between {start:.3g} s and {stop:.3g} s. This is a single "
            "disturbance, so the model gets no new effect."
        )
    worst = max(reports, key=lambda r: r.ratio)
    far_above = "more than 100" if worst.ratio >= 100.0 else f"{worst.ratio:.2g}"
    text = f"The residual of {worst.output} is structured ({far_above} times the noise floor)"
    if decision.refused:
        return f"{text}, but unseen recordings refuse all {len(decision.refused)} models that explain a part of it."
    return f"{text}, but no effect that was tried is material" + (f": {steps[-1].why}." if steps else ".")


def early_end_sentence(context: LoopContext, where: str) -> str:
    """Where the time limit or an interrupt ended the search; empty where the search was completed."""
    if not where:
        return ""
    limit = f"reached its time limit of {context.settings.max_minutes:g} min"
    ended = "was interrupted" if context.statistics.watched.asked_to_end else limit
    return f" The search {ended} at {where}, so it may have missed effects."


def story_of(context: LoopContext, ended: Ended, told: str) -> tuple[str, ...]:
    """What was done, in sentences."""
    first, search, steps = ended.first, ended.search, ended.steps
    effects = ended.extended.effects if ended.extended is not None else ()
    worst = max(first.reports, key=lambda r: r.ratio)
    refits = sum(row.refitted for row in search.table.rows.values())
    lines = [
        f"{context.family.title} was fitted as given. Its residual of {worst.output} in {worst.recording} is "
        f"{worst.ratio:.2g} times the noise floor and {worst.verdict}.",
        _data_sentence(context),
        *_restrictions(context.settings),
        f"{len(search.fits)} model structures were compared by their error on readings that were left out, in "
        f"{search.table.blocks} blocks; {refits} of them were fitted again without each block.",
        *(f"Step {s.number}: {s.why}." for s in steps),
    ]
    if search.skipped:
        lines.append(f"Not tried, because the model with them cannot be simulated: {', '.join(search.skipped)}.")
    for effect in effects:
        values = ", ".join(with_unit(f"{p.name} = {p.value:.3g}", p.unit) for p in effect.parameters)
        lines.append(f"Added at port {effect.port}: {effect.id}, with {values}.")
    return (*lines, told)


def _restrictions(settings: LoopSettings) -> tuple[str, ...]:
    """What the configuration allows and excludes."""
    only = [*(settings.effects or ()), *(settings.laws or ())]
    lines = [f"The configuration allows only {', '.join(only)}."] if only else []
    lines += [f"The configuration allows effects only at {', '.join(settings.ports)}."] if settings.ports else []
    lines += [f"The configuration excludes {', '.join(settings.exclude)}."] if settings.exclude else []
    return tuple(lines)


def _data_sentence(context: LoopContext) -> str:
    """Which readings were fitted and which were used for the test."""
    recordings = context.recordings
    fitted = join_names([r.name for r in recordings.train])
    if recordings.unseen_from:
        ends = ", ".join(f"{name} from {time:.3g} s" for name, time in recordings.unseen_from.items())
        return f"Fit and search used the first part of {fitted}. The rest ({ends}) could only refuse a model."
    unseen = join_names([r.name for r in recordings.test])
    return f"Recordings for fit and search: {fitted}. Recordings that could only refuse a model: {unseen}."


def _disturbance(reports: Sequence[ResidualReport]) -> tuple[str, float, float] | None:
    """Recording, start and end in s of a disturbance: a tenth of the recording has most of the squared residual."""
    found = [r for r in structured_residuals(reports) if r.worst_share > DISTURBANCE_SHARE and math.isfinite(r.ratio)]
    worst = max(found, key=lambda r: r.worst_share, default=None)
    return None if worst is None else (worst.recording, *worst.worst_time)
