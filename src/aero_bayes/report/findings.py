"""Tables of what was found: residual, noise, sampler, prediction."""

from __future__ import annotations

import math

from markupsafe import Markup

from aero_bayes.estimate.calibrated_model import value_text
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.posterior import McmcJson
from aero_bayes.estimate.residual_tests import RecordingError, Verdict
from aero_bayes.estimate.sampled_modes import ModeDraws
from aero_bayes.plain import number
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.tables import bar, html_table, intervals_glyph, ratio_glyph, status_pill
from aero_bayes.report.text import (
    NO_VALUE,
    count,
    duration,
    pretty_unit,
    role_words,
    sentence,
    signed,
    significant,
    symbol,
    tidy,
)
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

#: Ratio of two values that is told as such: 300 % more is harder to read than four times.
MIN_TIMES = 4.0
#: Above this, ensembles do not agree.
R_HAT_LIMIT = 1.01


def errors_table(result: RunJson) -> Markup:
    """Write the error of each recording by its own noise, before and after where there are both."""
    errors = errors_of(result)
    both = result.loop is not None and bool(result.loop.effects) and any(e.before is not None for e in errors)
    rows: list[tuple[object, ...]] = []
    for error in errors:
        name = error.recording if error.begin is None else f"{error.recording} from {error.begin:.6g} s on"
        sizes = [error.before, error.after] if both else [error.after]
        ratios = [x / error.noise if x is not None and error.noise else None for x in sizes]
        noise = Markup("{}{}").format(
            significant(error.noise), "" if error.noise_known else Markup("<small>of the fit</small>")
        )
        rows.append((
            Markup("{}<small>{}</small>").format(name, role_words(error.role)), symbol(error.output),
            status_pill(error.verdict), *(significant(x) for x in sizes), noise,
            pretty_unit(result.unit(error.output)), _beside_noise(error),
            ratio_glyph(ratios[0] if both else None, ratios[-1]), probability(error.p_value),
        ))  # fmt: skip
    columns = (
        "recording", "output", "what is left", *(("before", "after") if both else ("error",)),
        "noise", "unit", "ratio",
        "noise │ ○ before  ● after" if both else "noise │ error", "p (white)",
    )  # fmt: skip
    return html_table(columns, rows, "RMS error of each recording")


def _beside_noise(error: RecordingError) -> str:
    """Return an error over the noise; of what was fitted, the error itself would stand for one that is not known."""
    return significant(error.ratio) if error.noise_known or error.role == "test" else "its floor is not known"


def errors_of(result: RunJson) -> list[RecordingError]:
    """Return the errors of a loop; of a fit those that its residuals are."""
    if result.loop is not None and result.loop.errors:
        return result.loop.errors
    kinds: dict[str, Verdict] = {"adequate": "noise", "structured": "structured"}
    return [
        RecordingError(
            recording, result.role(recording) or "train", output, None, found.rms, number(found.noise_floor),
            found.noise_floor is not None, found.ratio, found.p_value, kinds[found.verdict],
        )
        for recording, own in result.residual.items() for output, found in own.items()
    ]  # fmt: skip


def checks_table(result: RunJson, told: str) -> Markup:
    """Return what the checks found, before and after, but what the verdict ``told`` or says of the model."""
    extended = result.loop is not None and bool(result.loop.effects)
    before = {row.cause: row for row in (result.loop.diagnosis_before if result.loop and extended else [])}
    rows: list[tuple[object, ...]] = []
    for row in result.checks:
        was = before.get(row.cause)
        said = row.cause == "model" or (row.what.removesuffix(".") in told and not row.more)
        if not said and (row.found or (was is not None and was.found)):
            over = was is not None and not row.found  # nothing is left to be done
            rows.append((row.cause, *([_check(was, advised=not over)] if before else []), _check(row)))
    heads = ("before", "after") if before else ("what was found",)
    return html_table(("cause", *heads), rows, "What the checks found")


def _check(row: DiagnosisRow | None, *, advised: bool = True) -> Markup:
    if row is None:
        return Markup(NO_VALUE)
    found = Markup("").join(Markup("<p>{}</p>").format(sentence(text)) for text in row.more)
    return (
        Markup("{}<small>{} {}</small>").format(
            sentence(row.what), sentence(f"{row.where}." if row.where else ""), sentence(row.done if advised else "")
        )
        + found
    )


def shifts_table(result: RunJson) -> Markup:
    """Write parameters before and after the model was extended, and how far each moved; None for another run."""
    loop, rows = result.loop, []
    for name, moved in loop.shifts.items() if loop is not None and loop.effects else ():
        now = result.parameters.get(name) or _spread(name, moved.after, moved.after_sd)
        drawn = intervals_glyph(name, [_spread(name, moved.before, moved.before_sd), now], ("warm", "accent"))
        change = _changed(moved.before, moved.after)
        about = Markup("{}<small>{}</small>").format(symbol(name), now.description)
        rows.append((about, drawn, change, significant(moved.in_sd, 2)))
    heads = ("parameter", "before (upper line), after (lower line)", "change",
             "in combined standard deviations")  # fmt: skip
    caption = "How far the parameters moved: 90 % intervals, a scale for each row"
    return html_table(heads, rows, caption)


def _changed(before: float, after: float) -> str:
    """Return a change in per cent, or as a factor where a value is several times what it was."""
    if not before or not math.isfinite(after / before):
        return NO_VALUE
    if after / before >= MIN_TIMES:
        return f"{significant(after / before, 3)}\u00a0times"
    return f"{signed(100 * (after - before) / abs(before), 1)}\u00a0%"


def _spread(name: str, value: float, sd: float) -> Estimate:
    if not math.isfinite(sd):
        return Estimate(name, value)
    return Estimate(name, value, q05=value - NORMAL_HALF_WIDTH * sd, q95=value + NORMAL_HALF_WIDTH * sd)


def noise_model_table(result: RunJson) -> Markup:
    """Return the noise model of every output."""
    rows = [
        (
            symbol(output), *(significant(size) for size in (found.sd, found.sd_white, found.sd_ou)),
            pretty_unit(result.unit(output)), duration(found.tau_s), significant(found.rho),
        )
        for output, found in result.noise.items()
    ]  # fmt: skip
    columns = ("output", "total", "white part", "correlated part", "unit", "correlation time", "lag-1 correlation")
    return html_table(columns, rows, "Noise model of each output (standard deviations)")


def process_noise_table(result: RunJson) -> Markup:
    """Return the diffusion of every state that has one."""
    rows = [
        (
            symbol(state), significant(found.value),
            NO_VALUE if found.q05 is None else f"{significant(found.q05)} to {significant(found.q95)}",
            pretty_unit(found.unit),
        )
        for state, found in result.process_noise.items()
    ]  # fmt: skip
    columns = ("state", "diffusion", "90 % interval", "unit")
    return html_table(columns, rows, "Process noise of the states")


def sampler_table(mcmc: McmcJson) -> Markup:
    """Write R-hat, effective draws and autocorrelation time by parameter; insufficient ones are marked."""
    rows: list[tuple[object, ...]] = []
    marked = []
    for name, found in mcmc.per_parameter.items():
        if not found.r_hat <= R_HAT_LIMIT:
            marked.append(len(rows))
        shown = f"{found.r_hat:.4f}" if math.isfinite(found.r_hat) else NO_VALUE
        rows.append((symbol(name), shown, count(found.ess_bulk), count(found.ess_tail), significant(found.tau)))
    columns = ("parameter", Markup("R&#770;"), "ESS, bulk", "ESS, tail", Markup("<i>τ</i> (steps)"))
    return html_table(
        columns, rows, "Convergence of each parameter (ESS: effective draws; marked: R-hat above 1.01)", marked
    )


def sampler_facts(mcmc: McmcJson) -> dict[str, str]:
    """Return the sampler's run in a few words and numbers."""
    sizes = [size for size in (mcmc.ess_bulk_min, mcmc.ess_tail_min) if size is not None]
    facts = {
        "largest R-hat": NO_VALUE if mcmc.r_hat_max is None else f"{mcmc.r_hat_max:.3f}",
        "effective draws of the parameter with the fewest": count(min(sizes, default=None)),
        "independent ensembles": count(mcmc.ensembles), "walkers per ensemble": count(mcmc.walkers),
        "steps per walker": count(mcmc.draws), "simulations": count(mcmc.evaluations),
        "autocorrelation time (steps)": significant(mcmc.tau),
        "accepted moves": NO_VALUE if mcmc.acceptance is None else f"{significant(100 * mcmc.acceptance, 2)} %",
        "time": duration(mcmc.seconds), "stopped because": mcmc.reason,
        "draws of each answer": "; ".join(_mode_words(mode) for mode in mcmc.modes) or NO_VALUE,
    }  # fmt: skip
    return {label: value for label, value in facts.items() if value not in {NO_VALUE, ""}}


def _mode_words(mode: ModeDraws) -> str:
    values = ", ".join(f"{name} = {significant(value)}" for name, value in mode.values.items())
    return f"{count(mode.draws)} at {values}{'' if mode.converged else ' (not converged)'}"


def fit_facts(result: RunJson) -> dict[str, str]:
    """List the interpolation of the inputs, the cost, and why each optimiser stopped."""
    fit, words = result.fit, {"hold": "constant", "linear": "linear"}
    facts = {f"{name} between samples": words[how] for name, how in fit.interpolation.items()}
    if fit.cost_eq6 is not None:
        facts["sum of squared errors"] = significant(fit.cost_eq6, 4)
    if fit.pso is not None:
        facts["particle swarm"] = f"{count(fit.pso.evaluations)} evaluations"
    if fit.local is not None:
        facts["local search"] = f"{count(fit.local.iterations)} iterations; {fit.local.reason}"
    for index, stage in enumerate(fit.stages, 1):
        facts[f"stage {index}, on {', '.join(stage.outputs)}"] = ", ".join(stage.parameters)
    return facts


def probability(p: float | None) -> str:
    """Return a p-value; below 0.0001 only that."""
    if p is None or math.isnan(p):
        return NO_VALUE
    return "< 0.0001" if p < 1e-4 else significant(p, 2)


def left_out_table(result: RunJson) -> Markup:
    """Write the error of each recording predicted from the others, beside that of the fit to all recordings."""
    rows = []
    for recording, entry in result.prediction.recordings.items():
        for output, error in entry.rms.items():
            fitted = entry.rms_fitted.get(output)
            if math.isnan(error):
                continue
            more = 100 * (error / fitted - 1) if fitted else None
            floor = result.noise_floor(recording, output)
            rows.append((
                recording, symbol(output), significant(error), significant(fitted), significant(floor),
                pretty_unit(result.unit(output)), NO_VALUE if more is None else f"{signed(more, 1)} %",
                ratio_glyph(fitted / floor if fitted and floor else None, error / floor if floor else None),
            ))  # fmt: skip
    columns = (
        "recording", "output", "predicted", "fitted", "noise floor",
        "unit", "predicted over fitted", "floor │ ○ fitted  ● predicted",
    )  # fmt: skip
    return html_table(columns, rows, "RMS error of each recording, predicted from the others")


def listed_values_table(result: RunJson) -> Markup:
    """List every combination of values with its probability, and how far its log-posterior is below the best."""
    trials = result.fit.values
    if not trials:
        return Markup("")
    names = list(trials[0].values)
    rows = []
    for trial in trials:
        share = trial.share if math.isfinite(trial.share) else 0.0
        shown = NO_VALUE if trial.failed else f"{significant(100.0 * share)} %" if share >= 1e-3 else "< 0.1 %"
        values = [value_text(trial.values[name]) for name in names]
        worse = Markup("<small>{}</small>").format(trial.failed) if trial.failed else significant(trial.worse_by)
        rows.append((*values, shown, bar(share, f"probability {shown}"), worse))
    columns = (*map(symbol, names), "probability", "", "log-posterior below the best")
    return html_table(columns, rows, "Listed values, each fitted; the first are reported", [0])


def sensor_table(result: RunJson) -> Markup:
    """Write the count of encoders, and what rounding to it adds to the residual; by output."""
    rows = [
        (symbol(output), significant(found.encoder.step), pretty_unit(result.unit(output)),
         f"rounding is {tidy(100.0 * found.encoder.share, 2)} % of the residual's variance")
        for output, found in result.sensors.items()
        if found.encoder is not None
    ]  # fmt: skip
    heads = ("output", "one count", "unit", "effect on the noise")
    return html_table(heads, rows, "Encoders")
