"""What stands first on the page (verdict, readings, warnings) and last (where it all came from)."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from aero_bayes.report.run_directory import RunDirectory, mapping, number, table, texts
from aero_bayes.report.tables import Column, generic_cell, html_table
from aero_bayes.report.text import count, describe_signal, duration, role_words, significant, symbol, tidy

_LEVELS = {"good", "warning", "bad"}
_HASH_SHOWN = 16


@dataclass(frozen=True)
class Reading:
    """One number of the head: what, how much, and how to take it."""

    label: Markup
    value: str
    note: str
    level: str = ""


def verdict(run: RunDirectory) -> tuple[str, str]:
    """The run's verdict and its level (good, warning, bad); a plain one where the run gives none."""
    stated = mapping(run.result, "verdict")
    if stated.get("text"):
        level = str(stated.get("level", ""))
        return str(stated["text"]), level if level in _LEVELS else "warning"
    structured = [
        f"{describe_signal(output) or output} in {recording}"
        for recording, outputs in mapping(run.result, "residual").items()
        for output, found in mapping(outputs).items()
        if mapping(found).get("verdict") == "structured"
    ]
    if structured:
        return f"The model does not yet explain {', '.join(structured)}: the residual is structured.", "warning"
    if mapping(run.result, "mcmc").get("converged") is False:
        return "The posterior has not converged; its intervals cannot be relied on.", "bad"
    return "The run has finished and states no verdict of its own.", "warning"


def readings(run: RunDirectory) -> list[Reading]:
    """The few numbers that say how far the rest can be trusted."""
    found = [_residual_reading(run, output) for output in _outputs(run)]
    mcmc = mapping(run.result, "mcmc")
    r_hat = number(mcmc.get("r_hat_max"))
    if r_hat is not None:
        fine = r_hat <= 1.01
        words = "ensembles agree" if fine else "ensembles disagree: above 1.01"
        found.append(Reading(Markup("largest R&#770;"), f"{r_hat:.3f}", words, "good" if fine else "bad"))
    sizes = [size for key in ("ess_bulk_min", "ess_tail_min") if (size := number(mcmc.get(key))) is not None]
    if sizes:
        found.append(Reading(Markup("effective draws"), count(min(sizes)), "of the worst parameter"))
    seconds = number(run.result.get("seconds"))
    failures = mapping(run.result, "failures")
    if seconds is not None:
        runs = sum(value for item in failures.values() if (value := number(item)) is not None)
        failed = runs - (number(failures.get("completed")) or 0)
        words = f"{count(runs)} simulations, {count(failed)} failed" if failures else "wall time"
        found.append(Reading(Markup("time taken"), duration(seconds), words))
    return found


def provenance(run: RunDirectory) -> list[Markup]:
    """Tables of where the data, the model and the software came from, and what the work cost."""
    result, tables = run.result, []
    recordings = {str(row.get("name")): row for row in table(result, "recordings")}
    files = [
        (str(row.get("file", "–")), count(number(row.get("rows"))), tidy(number(row.get("rate_hz"))),
         _hash(str(row.get("sha256") or "–")))
        for row in table(result, "data")
    ]  # fmt: skip
    if files:
        heads = ("file", Column("rows", "right"), Column("rate (Hz)", "right"), "SHA-256 (first digits)")
        tables.append(html_table(heads, files, "Data"))
    if recordings:
        used = [
            (str(name), role_words(row.get("role", "–")), count(number(row.get("rows"))),
             duration(number(row.get("duration_s"))), _signals(row.get("inputs")), _signals(row.get("outputs")))
            for name, row in recordings.items()
        ]  # fmt: skip
        columns = ("recording", "role", Column("rows", "right"), Column("length", "right"), "inputs", "outputs")
        tables.append(html_table(columns, used, "Recordings"))
    for title, node in (
        ("Model", mapping(result, "model")),
        ("Run", {key: result[key] for key in ("command", "seed", "seconds") if key in result}),
        ("Versions", mapping(result, "versions")),
        ("How simulations ended", mapping(result, "failures")),
        ("Time by stage (s)", mapping(result, "stages_seconds")),
    ):
        if node:
            rows = [
                (key if title == "Versions" else str(key).replace("_", " "), _exact(value))
                for key, value in node.items()
            ]
            tables.append(html_table(("", ""), rows, title))
    return tables


def warnings(run: RunDirectory) -> list[str]:
    """The run's warnings, and those that the page itself must add."""
    found = texts(run.result, "warnings")
    mcmc = mapping(run.result, "mcmc")
    if mcmc.get("converged") is False:
        reason = str(mcmc.get("reason") or "no reason given")
        found.append(f"The sampler has not converged ({reason}). Intervals below may be wrong.")
    return list(dict.fromkeys(found))


def _signals(names: object) -> Markup:
    return Markup(", ").join(symbol(str(name)) for name in names) if isinstance(names, list) else Markup("–")


def _outputs(run: RunDirectory) -> list[str]:
    named = [out for found in mapping(run.result, "residual").values() for out in mapping(found)]
    return list(dict.fromkeys(named))


def _residual_reading(run: RunDirectory, output: str) -> Reading:
    entries = [mapping(found, output) for found in mapping(run.result, "residual").values() if mapping(found, output)]
    ratios = [ratio for entry in entries if (ratio := number(entry.get("ratio"))) is not None]
    structured = any(entry.get("verdict") == "structured" for entry in entries)
    words = "structured: something is missing" if structured else "no structure left"
    return Reading(
        symbol(output) + Markup(" residual"), f"{significant(max(ratios, default=None))}\u202f×",
        f"the noise floor; {words}", "warning" if structured else "good",
    )  # fmt: skip


def _exact(value: object) -> object:
    """Whole numbers such as a seed stay as they are."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return _hash(value) if isinstance(value, str) and len(value) == 64 else generic_cell(value)


def _hash(digits: str) -> Markup:
    return Markup('<code class="hash" title="{}">{}</code>').format(digits, digits[:_HASH_SHOWN])
