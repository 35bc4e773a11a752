"""Tables of what was found: residual, noise, sampler, replay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from markupsafe import Markup

from aero_bayes.report.run_directory import RunDirectory, mapping, number, table, texts
from aero_bayes.report.series_figures import unit_of
from aero_bayes.report.tables import Column, html_table, ratio_glyph, status_pill
from aero_bayes.report.text import NOTHING, count, duration, pretty_unit, role_words, signed, significant, symbol, tidy


def residual_table(run: RunDirectory) -> Markup | None:
    """Residual size against the noise floor and the whiteness test, by recording and output."""
    rows: list[tuple[object, ...]] = []
    roles = {str(row.get("name")): row.get("role", "") for row in table(run.result, "recordings")}
    for recording, outputs in mapping(run.result, "residual").items():
        for output, entry in mapping(outputs).items():
            found = mapping(entry)
            ratio = number(found.get("ratio"))
            rows.append((
                Markup("{}<small>{}</small>").format(recording, role_words(roles.get(recording, ""))), symbol(output),
                significant(number(found.get("rms"))), significant(number(found.get("noise_floor"))),
                pretty_unit(unit_of(run, output)), significant(ratio), ratio_glyph(None, ratio),
                probability(number(found.get("p_value"))), status_pill(str(found.get("verdict") or "")),
            ))  # fmt: skip
    if not rows:
        return None
    columns = (
        "recording", "output", Column("RMS", "right"), Column("noise floor", "right"), "unit", Column("ratio", "right"),
        Column("floor │ residual", "centre"), Column("p (white)", "right"), "verdict",
    )  # fmt: skip
    return html_table(columns, rows, "Residual against noise floor")


def noise_table(run: RunDirectory) -> Markup | None:
    """The noise model of every output."""
    entries = mapping(run.result, "noise")
    if not entries:
        return None
    rows = []
    for output, entry in entries.items():
        found = mapping(entry)
        sizes = [significant(number(found.get(key))) for key in ("sd", "sd_white", "sd_ou")]
        correlated = (duration(number(found.get("tau_s"))), significant(number(found.get("rho"))))
        rows.append((symbol(output), *sizes, pretty_unit(unit_of(run, output)), *correlated))
    columns = (
        "output", Column("total", "right"), Column("white part", "right"), Column("correlated part", "right"), "unit",
        Column("correlation time", "right"), Column("lag-1 correlation", "right"),
    )  # fmt: skip
    return html_table(columns, rows, "Noise, standard deviations")


def sampler_table(run: RunDirectory) -> Markup | None:
    """R-hat, effective draws and autocorrelation time by parameter; what is not good enough is marked."""
    rows: list[tuple[object, ...]] = []
    marked = []
    for name, entry in mapping(run.result, "mcmc", "per_parameter").items():
        found = mapping(entry)
        r_hat = number(found.get("r_hat"))
        if r_hat is None or r_hat > 1.01:
            marked.append(len(rows))
        sizes = [count(number(found.get(key))) for key in ("ess_bulk", "ess_tail")]
        shown = NOTHING if r_hat is None else f"{r_hat:.4f}"
        rows.append((symbol(name), shown, *sizes, significant(number(found.get("tau")))))
    if not rows:
        return None
    columns = (
        "parameter", Column(Markup("R&#770;"), "right"), Column("ESS, bulk", "right"),
        Column("ESS, tail", "right"), Column(Markup("<i>τ</i> (steps)"), "right"),
    )  # fmt: skip
    return html_table(columns, rows, "Convergence (ESS: effective draws; marked: R-hat above 1.01)", marked)


def sampler_facts(run: RunDirectory) -> list[tuple[str, str]]:
    """The sampler's run in a few words and numbers."""
    mcmc = mapping(run.result, "mcmc")
    shown: dict[str, tuple[str, Callable[[float], str]]] = {
        "ensembles": ("independent ensembles", count), "walkers": ("walkers in each", count), "draws": ("draws", count),
        "tau": ("autocorrelation time (steps)", significant), "acceptance": ("accepted", _percent),
        "r_hat_max": ("largest R-hat", lambda x: f"{x:.4f}"), "ess_bulk_min": ("least effective draws, bulk", count),
        "ess_tail_min": ("least effective draws, tail", count), "seconds": ("time", duration),
    }  # fmt: skip
    facts = [(label, show(x)) for key, (label, show) in shown.items() if (x := number(mcmc.get(key))) is not None]
    if "reason" in mcmc:
        facts.append(("stopped because", str(mcmc["reason"])))
    return facts


def rms_table(run: RunDirectory) -> Markup | None:
    """RMS error of the fit by recording role and output."""
    errors = {
        split: mapping(outputs) for split, outputs in mapping(run.result, "fit", "rms").items() if mapping(outputs)
    }
    outputs = list(dict.fromkeys(output for found in errors.values() for output in found))
    if not outputs:
        return None
    rows = [
        (symbol(output), *(significant(number(found.get(output))) for found in errors.values()),
         pretty_unit(unit_of(run, output)))
        for output in outputs
    ]  # fmt: skip
    columns: tuple[Column | str, ...] = (
        "output",
        *(Column(role_words(split), "right") for split in errors),
        "unit",
    )
    return html_table(columns, rows, "RMS error of the fit")


def fit_facts(run: RunDirectory) -> list[tuple[str, str]]:
    """Cost and ending of the optimisers."""
    fit = mapping(run.result, "fit")
    facts = []
    if (cost := number(fit.get("cost_eq6"))) is not None:
        facts.append(("cost (sum of squared errors, Eq. 6)", significant(cost, 4)))
    pso, local = mapping(fit, "pso"), mapping(fit, "local")
    if pso:
        taken = f" in {duration(seconds)}" if (seconds := number(pso.get("seconds"))) is not None else ""
        facts.append(("particle swarm", f"{count(number(pso.get('evaluations')))} evaluations{taken}"))
    if local:
        ended = local.get("reason", "no reason given")
        facts.append(("local search", f"{count(number(local.get('iterations')))} iterations; {ended}"))
    for index, stage in enumerate(table(fit, "stages")):
        outputs, parameters = ", ".join(texts(stage, "outputs")), ", ".join(texts(stage, "parameters"))
        facts.append((f"stage {index + 1}, on {outputs}", parameters))
    return facts


def replay_table(run: RunDirectory) -> Markup | None:
    """Table 1 of the paper: every model's parameters and fitness, beside the paper's fitness."""
    entries = table(run.result, "replay", "rows")
    if not entries:
        return None
    names = list(dict.fromkeys(name for row in entries for name in mapping(row, "parameters")))
    fitness = [number(row.get("fitness")) for row in entries]
    best = min((x for x in fitness if x is not None), default=None)
    rows = [
        (
            Markup("{}<small>{}</small>").format(row.get("model", NOTHING), row.get("note") or ""),
            *(_replay_value(mapping(row, "parameters").get(name)) for name in names),
            significant(value, 4), tidy(number(row.get("paper_fitness")), 6),
        )
        for row, value in zip(entries, fitness, strict=True)
    ]  # fmt: skip
    fits = Column("fitness, here", "right"), Column("fitness, paper", "right")
    columns: tuple[Column | str, ...] = ("model", *(Column(symbol(name), "right") for name in names), *fits)
    marked = [index for index, value in enumerate(fitness) if value is not None and value == best]
    return html_table(
        columns, rows, "Table 1 of the paper, replayed (SI units; fitness by Eq. 6, smaller is better)", marked
    )


def probability(p: float | None) -> str:
    """A p-value; below 0.0001 only that."""
    if p is None:
        return NOTHING
    return "< 0.0001" if p < 1e-4 else significant(p, 2)


def _replay_value(value: Any) -> str:
    stated = value.get("value") if isinstance(value, Mapping) else value
    return significant(number(stated), 3)


def _percent(share: float) -> str:
    return f"{significant(100 * share, 2)} %"


def left_out_table(run: RunDirectory) -> Markup | None:
    """Error of each recording predicted from the others, beside that of the fit which has seen it."""
    rows = []
    for recording, entry in mapping(run.result, "prediction", "recordings").items():
        for output, predicted in mapping(entry, "rms").items():
            error, fitted = number(predicted), number(mapping(entry, "rms_fitted").get(output))
            if error is None:
                continue
            more = 100 * (error / fitted - 1) if fitted else None
            floor = _floor_of(run, recording, output)
            rows.append((
                recording, symbol(output), significant(error), significant(fitted), significant(floor),
                pretty_unit(unit_of(run, output)), NOTHING if more is None else f"{signed(more, 1)} %",
                ratio_glyph(fitted / floor if fitted and floor else None, error / floor if floor else None),
            ))  # fmt: skip
    columns = (
        "recording", "output", Column("predicted", "right"), Column("fitted", "right"), Column("noise floor", "right"),
        "unit", Column("predicted over fitted", "right"), Column("floor │ ○ fitted  ● predicted", "centre"),
    )  # fmt: skip
    return html_table(columns, rows, "RMS error of each recording, predicted from the others") if rows else None


def stretches_table(run: RunDirectory) -> Markup | None:
    """Expected log-density of stretches of time that were left out."""
    words = {
        "leave_future_out": "each stretch from those before it", "leave_one_out": "each stretch from all others",
        "waic": "the same by Watanabe's criterion",
    }  # fmt: skip
    rows = []
    for key, label in words.items():
        entry = mapping(run.result, "prediction", "stretches", key)
        if not entry:
            continue
        trust = "" if entry.get("reliable") else "the weights are too uneven to rely on it"
        name = Markup("{}<small>{}</small>").format(label, key.replace("_", " "))
        rows.append((
            name, tidy(number(entry.get("elpd")), 7), significant(number(entry.get("se")), 2),
            count(number(entry.get("stretches"))), trust,
        ))  # fmt: skip
    columns = (
        "predicted", Column("log-density", "right"), Column("standard error", "right"), Column("stretches", "right"),
        "",
    )  # fmt: skip
    return html_table(columns, rows, "Stretches of time, in order (larger is better)") if rows else None


def _floor_of(run: RunDirectory, recording: str, output: str) -> float | None:
    row = next((row for row in table(run.result, "recordings") if row.get("name") == recording), {})
    return number(mapping(row, "noise_floor").get(output))
