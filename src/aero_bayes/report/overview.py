"""Head of the page (verdict, key figures, warnings) and its end (provenance)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from aero_bayes.report import words
from aero_bayes.report.findings import R_HAT_LIMIT, errors_of
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.tables import Column, generic_cell, html_table
from aero_bayes.report.text import count, duration, role_words, scaled_unit, significant, symbol, tidy

_HASH_SHOWN = 16


@dataclass(frozen=True)
class KeyFigure:
    """A key figure at the head of the page, with a note on its meaning."""

    label: Markup
    value: str
    note: str
    level: str = ""


def readings(result: RunJson) -> list[KeyFigure]:
    """List key figures on the quality of the result; the head of a loop's page has its errors."""
    roles = ("test", "train") if result.loop is None else ()
    found = [card for role in roles for card in _error_readings(result, role)]
    mcmc = result.mcmc
    if mcmc is not None and mcmc.r_hat_max is not None:
        fine = mcmc.r_hat_max <= R_HAT_LIMIT
        said = "ensembles agree" if fine else "ensembles disagree: above 1.01"
        found.append(KeyFigure(Markup("largest R&#770;"), f"{mcmc.r_hat_max:.3f}", said, "good" if fine else "bad"))
    sizes = [] if mcmc is None else [size for size in (mcmc.ess_bulk_min, mcmc.ess_tail_min) if size is not None]
    if sizes:
        found.append(KeyFigure(Markup("effective draws"), count(min(sizes)), "of the parameter with the fewest"))
    return found


def provenance(result: RunJson) -> list[Markup]:
    """Return tables of provenance: data, model, software and computing effort."""
    tables = []
    files = [
        (row.file, count(row.rows), tidy(row.rate_hz), _hash(row.sha256)) for row in result.data
    ]  # fmt: skip
    if files:
        heads = ("file", Column("rows", "right"), Column("rate (Hz)", "right"), "SHA-256 (first digits)")
        tables.append(html_table(heads, files, "Data"))
    if result.recordings:
        used = [
            (row.name, role_words(row.role), count(row.rows), duration(row.duration_s), _signals(row.inputs),
             _signals(row.outputs))
            for row in result.recordings
        ]  # fmt: skip
        columns = ("recording", "role", Column("rows", "right"), Column("length", "right"), "inputs", "outputs")
        tables.append(html_table(columns, used, "Recordings"))
    model = {key: value for key, value in result.model.model_dump().items() if value}
    for title, node in (
        ("Model", model),
        ("Run", {"command": result.command, "seed": result.seed}),
        ("Versions", result.versions),
        ("Simulations", result.failures | ({"time": duration(result.seconds)} if result.seconds is not None else {})),
    ):
        if node:
            rows = [(key.replace("_", " ") if node is model else key, _exact(value)) for key, value in node.items()]
            tables.append(html_table(("", ""), rows, title))
    return tables


def warnings(result: RunJson) -> list[str]:
    """Return warnings of the run without those in the verdict, and one on parameters on a bound."""
    found = list(result.warnings)
    reason = result.mcmc.reason if result.mcmc is not None and not result.mcmc.converged else ""
    if reason and reason in words.verdict(result).text:  # said already
        found = [text for text in found if reason not in text]
    bounds = [f"`{name}`" for name, entry in result.parameters.items() if entry.status == "at_bound"]
    if bounds:
        found.append(
            f"{', '.join(bounds)}: the best value lies on a bound of the search range, so there is no interval."
        )
    return list(dict.fromkeys(found))


def _signals(names: Sequence[str]) -> Markup:
    return Markup(", ").join(symbol(name) for name in names)


def _error_readings(result: RunJson, role: str) -> Iterator[KeyFigure]:
    """Yield, for each output, the recording of a role in which most is left of it, by that recording's own noise."""
    errors = [error for error in errors_of(result) if error.role == role]
    left = {"noise": "only noise is left", "structured": "structure is left", "too large": "more than noise is left"}
    for output in dict.fromkeys(error.output for error in errors):
        worst = max((e for e in errors if e.output == output), key=lambda e: (e.verdict != "noise", e.ratio or 0.0))
        value, noise = (
            f"{significant(worst.ratio)}\u202f×",
            "the noise" if worst.noise_known else "the error of the fit",
        )
        if worst.ratio is None:
            factor, unit = scaled_unit(worst.after or 0.0, result.unit(output))
            value, noise = (
                f"{significant(factor * (worst.after or 0.0))} {unit}".strip(),
                "the RMS error, of unknown noise,",
            )
        label = symbol(output) + Markup(" {}").format({"test": "test", "train": "training"}[role])
        level = "good" if worst.verdict == "noise" else "warning"
        yield KeyFigure(label, value, f"{noise} of {worst.recording}; {left[worst.verdict]}", level)


def _exact(value: object) -> object:
    """Keep whole numbers such as a seed as they are."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return _hash(value) if isinstance(value, str) and len(value) == 64 else generic_cell(value)


def _hash(digits: str) -> Markup:
    return Markup('<code class="hash" title="{}">{}</code>').format(digits, digits[:_HASH_SHOWN])
