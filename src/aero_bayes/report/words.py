"""Every sentence that a page or the terminal says of a run, so that one reading covers them all.

Names of signals, parameters and effects stand in backquotes: the page sets them as symbols, the terminal drops them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from aero_bayes.display import join_names
from aero_bayes.report.schema_estimate import DiagnosisJson, ParameterJson, VerdictJson
from aero_bayes.report.schema_loop import EffectJson, LimitJson, LoopJson, RecordingErrorJson
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.text import minus, pretty_unit, rounded_value, significant

#: Paragraphs of the page, by section.
LEADS = {
    "curves": "Grey: measured, from the smallest to the largest value in each pixel column, so that all spikes show. "
    "Below each output: measured minus model, with a running mean. Dashed: twice the noise; noise alone leaves 95 % of "
    "the samples between the dashed lines.",
    "parameters": "With 90 % probability the value lies in the interval, if the model is right.",
    "errors": "Noise: standard deviation of the sensor noise, estimated from each recording without a model. Ratio: "
    "error over noise; about 1 if only noise is left, too large above 1.3.",
    "residuals": "p (white): how probable so much correlation is in white noise; near 0 if there is structure.",
    "noise": "White noise is independent from sample to sample, correlated noise fades over the correlation time.",
    "process_noise": "Diffusion: how far chance moves the state in the square root of a second. With it a residual is "
    "what the model did not predict from the readings before.",
    "candidates": "How far the error on readings that were left out falls with each candidate: each block of readings "
    "is predicted by a fit to all others. ± is one standard error over resampled blocks.",
    "shift": "A parameter that moved by many standard deviations had made up for the missing effect.",
    "profiles": "Each curve fixes one parameter at a value, fits all others again, and shows how far the "
    "log-posterior falls. The 90 % interval lies below the dashed line; a curve that stays below it has no end there. "
    "Grey: the prior alone.",
    "prediction": "Errors on data that were left out of the fit. A left-out recording keeps its own delay and start; "
    "all other parameters come from the other recordings.",
    "posterior": "R-hat: spread of all draws over that within an ensemble; at most 1.01 if the ensembles agree. "
    "Effective draws: how many independent draws would be as precise.",
    "traces": "Each line is the running median of one ensemble; grey: 5 to 95 % of all draws. Lines that overlap have "
    "converged.",
}
OUTCOMES = {
    "adequate": "the model is adequate",
    "unexplained": "something is missing that no effect of the library explains",
}
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def title(result: RunJson, otherwise: str) -> str:
    """Return the finding in a line: the title of the page."""
    loop, model = result.loop, (result.loop.base if result.loop else "") or result.model.name or otherwise
    model = model.rpartition(".")[2]
    if result.study:
        return f"{result.study.title}: {model}"
    if result.design:
        return f"{model}: the next experiment"
    if loop is not None:
        return f"{model} {lacking(loop)}" if loop.effects else f"{model}: {OUTCOMES.get(loop.outcome, 'extended')}"
    found = [row.cause for row in result.diagnosis if row.found]
    if "model" in found:
        return f"{model} misses something" if len(found) == 1 else f"{model}: the {found[0]} comes first"
    return f"{model} explains the recordings" if result.diagnosis else f"{model}: {result.command or 'a run'}"


def lacking(loop: LoopJson) -> str:
    """Say what the model lacks, in words, as far as the data say it, and with what it was extended as required."""
    asked = [e for e in loop.effects if e.claim is None]
    found = [_what(e) for e in loop.effects if e not in asked]
    return " and ".join(filter(None, (
        f"lacks {join_names(found)}" if found else "",
        f"has {join_names([e.id for e in asked])}, as required" if asked else "",
    )))  # fmt: skip


def _what(effect: EffectJson) -> str:
    if effect.claim == "one of":
        return f"one of {number(1 + len(effect.alternatives))} effects, such as {effect.summary or effect.id}"
    if effect.kind == "free_form" or effect.claim == "place":
        return f"an effect at {effect.port}"
    return re.sub(r" \([^()]*\)$", "", effect.summary) or effect.id


def number(count: int) -> str:
    """Return a small whole number as a word."""
    return _COUNTS[count] if count < len(_COUNTS) else str(count)


def claim(effect: EffectJson, groups: Sequence[Sequence[str]] = ()) -> str:
    """Say how sure it is that the effect is this one."""
    others = [a for a in effect.alternatives if a.id != effect.id]
    ids = [a.id for a in others] or [i for group in groups if effect.id in group for i in group if i != effect.id]
    named = join_names(
        [f"`{i}`" for i in ids[:3]] if len(ids) < 4 else [*(f"`{i}`" for i in ids[:2]), f"{len(ids) - 2} more"]
    )
    if effect.claim == "place":
        count = number(1 + len(ids)).capitalize()
        laws = f"{count} laws at `{effect.port}` predict equally well; the simplest is taken. "
        return f"{laws if ids else ''}The place is known, the law is not."
    if effect.claim == "one of":
        return f"The data do not tell `{effect.id}` from {named}: each predicts about as well."
    if effect.kind == "free_form":
        return "No law of the library fits: the curve was learned from the data."
    return f"Nothing else that was tried does as well as `{effect.id}`." if effect.claim == "law" else ""


def values(effect: EffectJson) -> str:
    """Return the values of an effect's parameters, each with half its 90 % interval."""
    texts = []
    for name, stated in effect.parameters.items():
        shown = rounded_value(stated.value, stated.q05, stated.q95, stated.unit)
        power, _, unit = shown.unit.partition(" ") if shown.unit.startswith("×") else ("", "", shown.unit)
        half = ""
        if stated.q05 is not None and stated.q95 is not None:
            half = f" ± {half_width(shown.low, shown.high)}"
        sized = f"({shown.value}{half})\u202f{power}" if power and half else f"{shown.value}{half}{power}"
        texts.append(f"`{name}` = {sized}\u00a0{unit}".strip())
    return ", ".join(texts)


def interval(name: str, stated: ParameterJson) -> str:
    """Say in which interval a parameter lies; empty where it has none."""
    shown = rounded_value(stated.value, stated.q05, stated.q95, stated.unit)
    if stated.q05 is None or stated.q95 is None:
        return ""
    return f"`{name}` lies from {shown.low} to {shown.high}\u00a0{shown.unit} with 90\u00a0% probability."


def half_width(low: str, high: str) -> str:
    """Return half the width of an interval, with the digits in which its ends are written."""
    first, last = (float(end.replace("\u2212", "-")) for end in (low, high))
    return f"{0.5 * (last - first):.{len(high.partition('.')[2])}f}"


def size(value: float | None, unit: str) -> str:
    """Return a number with its unit, which no line break parts from it."""
    return f"{significant(value)}\u00a0{pretty_unit(unit)}".strip()


def place(error: RecordingErrorJson) -> str:
    """Return a recording and its role, or the part of it that was not fitted."""
    if error.begin is not None:
        return f"what was not fitted of {error.recording} (from {error.begin:.4g}\u00a0s on)"
    return f"the {'test' if error.role == 'test' else 'training'} recording {error.recording}"


def limit(found: LimitJson) -> str:
    """Say from which size on a law would have been named."""
    least = f"{found.parameter} = {size(found.smallest, found.unit)}"
    return f"`{found.law}` at `{found.port}` would have been found from {least} on."


def judged(loop: LoopJson, role: str) -> list[RecordingErrorJson]:
    """Return the errors on the recordings of a role."""
    return [error for error in loop.errors if error.role == role]


def fall_on(error: RecordingErrorJson, unit: str) -> str:
    """Say how far the error of one output falls on one recording, beside its noise."""
    noise = f"noise {significant(error.noise)}" if error.noise_known else f"error of the fit {significant(error.noise)}"
    if not error.before or error.after is None:
        return f"the error of `{error.output}` is {size(error.after, unit)} ({noise})"
    change = 100.0 * (error.after / error.before - 1.0)
    verb = "falls" if change < 0 else "grows"
    return (
        f"the error of `{error.output}` {verb} from {significant(error.before)} to {size(error.after, unit)} "
        f"({minus(f'{change:+.0f}')}\u00a0%; {noise})"
    )


def gain(result: RunJson, loop: LoopJson) -> Iterator[str]:
    """Say how we know: the error that falls most on data that were not fitted, and the cross-validated gain."""
    unseen = [e for e in judged(loop, "test") or judged(loop, "train") if e.before and e.after is not None]
    if unseen:
        most = min(unseen, key=lambda e: (e.after or 0.0) / (e.before or 1.0))
        yield f"On {place(most)} {fall_on(most, result.unit(most.output))}."
    for effect in loop.effects:
        if effect.share is not None:
            spread = "" if effect.share_sd is None else f" ± {100.0 * effect.share_sd:.0f}"
            what = f" with `{effect.id}`" if len(loop.effects) > 1 else ""
            of = f" of `{effect.share_of}`" if effect.share_of else ""
            change = minus(f"{100.0 * (effect.share - 1.0):.0f}{spread}\u00a0%")
            yield f"Cross-validated on training, the error{of} changes by {change}{what}."


def faults(loop: LoopJson) -> list[str]:
    """Say which recordings the model does not explain down to the noise, those that were not fitted first."""
    texts: dict[str, list[str]] = {}
    for role in ("test", "train"):
        for error in judged(loop, role):
            if error.verdict == "noise":
                continue
            noise = "its noise" if error.noise_known else "the error of the fit"
            ratio = significant(error.ratio, 2) if (error.ratio or 0.0) < 100.0 else "more than 100"
            what = (
                f"is {ratio} times {noise}"
                if error.verdict == "too large"
                else "is as small as noise, but has structure"
            )
            texts.setdefault(place(error), []).append(f"the error of `{error.output}` {what}")
    return [f"On {where} {join_names(own)}." for where, own in texts.items()]


def verdict(result: RunJson) -> VerdictJson:
    """Judge a run in a few sentences: good only if nothing but noise is left."""
    if result.mcmc is not None and not result.mcmc.converged:
        return VerdictJson(
            level="bad", text=f"The sampler has not converged: {result.mcmc.reason or 'no reason given'}."
        )
    return _loop_verdict(result, result.loop) if result.loop is not None else _fit_verdict(result)


def short_verdict(result: RunJson) -> str:
    """Return what stands beside the level on a page, whose head says the rest: what is left, or that nothing is."""
    loop = result.loop
    if loop is None or not (loop.effects and loop.errors) or (result.mcmc is not None and not result.mcmc.converged):
        return (result.verdict or verdict(result)).text
    left = [*faults(loop), *result.identifiability.flat]
    return " ".join(left or ["With it only noise is left in each recording, fitted or not."])


def _loop_verdict(result: RunJson, loop: LoopJson) -> VerdictJson:
    left, flat, model = faults(loop), result.identifiability.flat, loop.base.rpartition(".")[2] or "The model"
    if loop.effects:
        stated = [e for e in loop.effects if e.kind == "catalogue" and e.summary]
        ids = [f"{'as ' if e.claim == 'place' else ''}`{e.id}`" for e in stated]
        said = ", ".join(filter(None, (values(e) for e in loop.effects)))
        own = f" ({'; '.join(filter(None, (', '.join(ids), said)))})" if ids or said else ""
        told = [f"{model} {lacking(loop)}{own}.", *gain(result, loop)]
        told += [text for effect in loop.effects if (text := claim(effect, loop.equivalent))]
        told += [_cause(row) for row in result.diagnosis if row.cause == "data" and row.found]
    else:
        told = [loop.sentence or f"{model}: {OUTCOMES[loop.outcome]}."]
    clear = not left and not flat and loop.outcome != "unexplained"
    return VerdictJson(level="good" if clear else "warning", text=" ".join([*told, *loop.notes, *left, *flat]))


def _fit_verdict(result: RunJson) -> VerdictJson:
    flat, found = result.identifiability.flat, [row for row in result.diagnosis if row.found]
    told = [_cause(row) for row in found if row.cause != "model"]
    if any(row.cause == "model" for row in found):
        patterns = dict.fromkeys(
            o for own in result.residual.values() for o, r in own.items() if r.verdict == "structured"
        )
        of = f"its error in {join_names([f'`{name}`' for name in patterns])}" if patterns else "its error"
        beyond = "that faulty data, the solver, a stuck search or coloured noise do not explain"
        missing = f"The model misses something: {of} follows a pattern {beyond}."
        first = f"{of[:1].upper()}{of[1:]} follows a pattern. Mend that first: it may be the whole reason."
        return VerdictJson(level="warning", text=" ".join([told[0], first] if told else [missing]))
    exact = all(r.exact for own in result.residual.values() for r in own.values()) if result.residual else False
    down = "exactly: they have no noise at all" if exact else "down to the noise"
    sampled = ", and the posterior has converged" if result.mcmc is not None else ""
    caution = flat or any(row.cause in ("data", "solver", "search") for row in found)
    text = " ".join([f"The model explains the recordings {down}{sampled}.", *told[:1], *flat])
    return VerdictJson(level="warning" if caution else "good", text=text)


def _cause(row: DiagnosisJson) -> str:
    """Return what was found of a cause, where, and what was done."""
    where, more = (
        f" ({row.where})" if row.where else "",
        f" And {len(row.more)} more, see the checks." if row.more else "",
    )
    return f"{row.cause.capitalize()}: {row.what.removesuffix('.')}{where}. {row.done}".strip() + more


def checks_line(result: RunJson) -> str:
    """Return one line: the state of each cause that may be behind a residual, of the model that came out."""
    states = {row.cause: row.found for row in result.diagnosis}
    if not states:
        return ""
    clear = [f"{cause} {'to look at' if found else 'ok'}" for cause, found in states.items() if cause != "model"]
    where = " of training" if result.loop is not None else ""
    model = "an effect is missing" if states.get("model") else f"only noise is left in the recordings{where}"
    return f"Checks: {', '.join(clear)}; model: {model}."


#: Characters that not every terminal has.
_PLAIN: dict[str, str | int | None] = {
    "`": "",
    "−": "-",
    "±": "+-",
    "·": ".",
    "\u00a0": " ",
    "\u202f": "",
    "×": " x ",
    "Ω": "Ohm",
    "⁻": "-",
}
_PLAIN |= {power: str(digit) for digit, power in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}


def plain(text: str) -> str:
    """Return a sentence as a terminal shows it."""
    return text.translate(str.maketrans(_PLAIN))
