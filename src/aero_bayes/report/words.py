"""Every sentence that a page or the terminal says of a run, but those on a loop (:mod:`aero_bayes.loop.sentences`).

Names of signals, parameters and effects stand in backquotes: the page sets them as symbols, the terminal drops them.
"""

from __future__ import annotations

from collections.abc import Mapping

from aero_bayes.display import join_names
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.error_sentences import left_over
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.loop.extend import FoundEffect, Limit
from aero_bayes.loop.result import LoopJson
from aero_bayes.loop.sentences import lacking
from aero_bayes.report.schema_run import RunJson, VerdictJson
from aero_bayes.report.tables import parameter_quantity
from aero_bayes.report.text import pretty_unit, significant

LEVELS = {"good": "Good", "warning": "Caution", "bad": "Do not use"}
#: Paragraphs of the page, by section.
LEADS = {
    "curves": "Grey: measured, from the smallest to the largest value in each pixel column, so that all spikes show. "
    "Below each output: measured minus model, with a running mean. Dashed: twice the noise; noise alone leaves 95 % of "
    "the samples between the dashed lines.",
    "parameters": "With 90 % probability the value lies in the interval, if the model is right.",
    "errors": "Noise: standard deviation of the sensor noise, estimated from each recording without a model, or the "
    "error of the fit where it says so. Ratio: error over noise; about 1 if only noise is left, too large above 1.3.",
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
    "prediction": "Errors on data that were left out of the fit. Delay and start of a left-out recording come from its "
    "beginning, all other parameters from the other recordings.",
    "posterior": "R-hat: spread of all draws over that within an ensemble; at most 1.01 if the ensembles agree. "
    "Effective draws: how many independent draws would be as precise.",
}


def title(result: RunJson, otherwise: str) -> str:
    """Return the finding in a line: the title of the page."""
    loop, model = result.loop, (result.loop.base if result.loop else "") or result.model.name or otherwise
    model = model.rpartition(".")[2]
    if result.design:
        return f"{model}: the next experiment"
    if loop is not None:
        if loop.effects:
            return f"{model} {lacking(loop.effects)}"
        if loop.outcome == "unexplained":
            return f"{model} does not explain the recordings"
        return f"{model}: no missing effect was found" if left_over(loop.errors) else f"{model}: the model is adequate"
    found = [row.cause for row in result.diagnosis if row.found]
    if "model" in found:
        return f"{model} misses something" if len(found) == 1 else f"{model}: the {found[0]} may explain what is left"
    return f"{model} explains the recordings" if result.diagnosis else f"{model}: {result.command or 'a run'}"


def values(effect: FoundEffect, known: Mapping[str, Estimate]) -> str:
    """Return the values of an effect's parameters, each with its 90 % interval as the table of parameters has it.

    ``known`` are those of the table, which are the posterior's, where there is one."""
    own = {p.name: known.get(p.name, p) for p in effect.parameters}
    found = [(name, stated, *parameter_quantity(stated)) for name, stated in own.items()]
    texts = []
    for name, stated, shown, sure in found:
        interval = f" ({shown.low} to {shown.high})" if sure else ""
        bound = ", on a bound" if stated.status == "at_bound" else ""
        texts.append(f"`{name}` = {shown.value}{interval}\u00a0{shown.unit}".strip() + bound)
    return ", ".join(texts) + ("; 90\u00a0% intervals" if any(sure for *_, sure in found) else "")


def size(value: float | None, unit: str) -> str:
    """Return a number with its unit, which no line break parts from it."""
    return f"{significant(value)}\u00a0{pretty_unit(unit)}".strip()


def limit(found: Limit) -> str:
    """Say from which size on a law would have been named."""
    least = f"`{found.parameter}` = {size(found.smallest, found.unit)}"
    return f"`{found.law}` at `{found.port}` would have been found from {least} on."


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
    other = any(error.role != "train" for error in loop.errors)
    where = "each recording, fitted or not" if other else "what was fitted; the rest is too short to judge"
    left = [*left_over(loop.errors), *result.identifiability.flat] or [
        f"With {'it' if len(loop.effects) == 1 else 'them'} only noise is left in {where}."
    ]
    return " ".join([*left, *loop.notes])


def _loop_verdict(result: RunJson, loop: LoopJson) -> VerdictJson:
    flat = result.identifiability.flat
    clear = loop.outcome != "unexplained" and not [*flat, *left_over(loop.errors), *loop.notes]
    return VerdictJson(level="good" if clear else "warning", text=" ".join([loop.sentence, *flat]).strip())


def _fit_verdict(result: RunJson) -> VerdictJson:
    flat, found = result.identifiability.flat, [row for row in result.diagnosis if row.found]
    told = [_cause(row) for row in found if row.cause != "model"]
    if any(row.cause == "model" for row in found):
        patterns = dict.fromkeys(
            o for own in result.residual.values() for o, r in own.items() if r.verdict == "structured"
        )
        of = f"error in {join_names([f'`{name}`' for name in patterns])}" if patterns else "error"
        if told:
            cause = next(row.cause for row in found if row.cause != "model")
            text = f"{told[0]} The {of} follows a pattern, which may come from the {cause} and not from the model."
        else:
            beyond = "that faulty data, the solver, a stuck search or coloured noise do not explain"
            text = f"The model misses something: its {of} follows a pattern {beyond}."
        return VerdictJson(level="warning", text=text)
    exact = all(r.exact for own in result.residual.values() for r in own.values()) if result.residual else False
    down = "exactly: they have no noise at all" if exact else "down to the noise"
    sampled = ", and the posterior has converged" if result.mcmc is not None else ""
    caution = flat or any(row.cause in ("data", "solver", "search") for row in found)
    text = " ".join([f"The model explains the recordings {down}{sampled}.", *told[:1], *flat])
    return VerdictJson(level="warning" if caution else "good", text=text)


def _cause(row: DiagnosisRow) -> str:
    """Return what was found of a cause, where, and what was done."""
    where, more = (
        f" ({row.where})" if row.where else "",
        f" And {len(row.more)} more, see the checks." if row.more else "",
    )
    return f"{row.cause.capitalize()}: {row.what.removesuffix('.')}{where}. {row.done}".strip() + more


def checks_line(result: RunJson) -> str:
    """Return one line: the state of each cause but the model that may be behind a residual of what was fitted."""
    causes = [row for row in result.checks if row.cause != "model"]
    found, fine = ([row.cause for row in causes if row.found is seen] for seen in (True, False))
    told = [f"look at the {join_names(found)}"] if found else []
    told += [f"{join_names(fine)} {'is' if len(fine) == 1 else 'are'} in order"] if fine else []
    return f"Checks: {'; '.join(told)}." if told else ""


def checks_told(result: RunJson, said: str) -> list[str]:
    """Return what was found of each cause that the line of the checks names, as far as it was not ``said``."""
    rows = (row for row in result.checks if row.found and row.cause != "model")
    return [_cause(row) for row in rows if row.what.removesuffix(".") not in said]


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
