"""Finished runs side by side in one table: verdict, parameters with their intervals, errors, settings that differ."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from aero_bayes.errors import InputError
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.files import write_whole
from aero_bayes.report.curves import FINAL_SERIES, left_over
from aero_bayes.report.page import Parts, fill, with_parts
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import generic_cell, html_table, parameter_quantity, status_pill
from aero_bayes.report.text import NO_VALUE, pretty_unit, sentence, significant, symbol
from aero_bayes.report.words import LEVELS

Runs = Mapping[str, RunDirectory]
#: A row of the table: what it is, its unit, a cell for each run, and how far these are apart.
Row = tuple[object, ...]
#: Runs that stand side by side on a wide screen.
MOST_RUNS = 6


def write_comparison(directories: Sequence[Path | str], out: Path | str) -> Path:
    """Write a page with one table: a column for each run."""
    if not 2 <= len(directories) <= MOST_RUNS:
        raise InputError(f"{len(directories)} runs cannot be compared; expected 2 to {MOST_RUNS} directories")
    runs = dict(zip(_names([Path(d) for d in directories]), map(RunDirectory.read, directories), strict=True))
    rows = [_verdicts(runs), *_parameter_rows(runs), *_error_rows(runs), *_setting_rows(runs)]
    heads = ("", "unit", *runs, "largest difference (combined sd)")
    caption = "Parameters with 90 % intervals, errors (RMS of the residual), and settings that differ"
    context = {
        "title": " against ".join(runs), "kicker": "aero-bayes · compare",
        "sections": with_parts(Parts("Side by side", [html_table(heads, rows, caption)], "runs")),
    }  # fmt: skip
    return write_whole(Path(out), fill(context, [run.result for run in runs.values()]))


def _names(directories: Sequence[Path]) -> list[str]:
    """Return the shortest last parts of the paths that are unique."""
    parts = [path.resolve().parts for path in directories]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-depth:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    raise InputError("a run cannot be compared with itself: the same directory was given twice")


def _shared(runs: Runs) -> dict[str, dict[str, Estimate]]:
    """Return parameters that at least one run estimates, with every run's entry."""
    names = dict.fromkeys(
        name for run in runs.values() for name, entry in run.result.parameters.items() if entry.status != "fixed"
    )
    return {
        name: {k: run.result.parameters[name] for k, run in runs.items() if name in run.result.parameters}
        for name in names
    }


def _verdicts(runs: Runs) -> Row:
    results = [run.result for run in runs.values()]
    cells = (
        Markup("<strong>{}.</strong> {}").format(LEVELS[r.verdict.level], sentence(r.verdict.text, r.effect_words()))
        if r.verdict else NO_VALUE
        for r in results
    )  # fmt: skip
    return ("verdict", "", *cells, "")


def _parameter_rows(runs: Runs) -> Iterator[Row]:
    """Yield value, interval and status of every parameter, run by run."""
    for name, entries in _shared(runs).items():
        unit = next((pretty_unit(entry.unit) for entry in entries.values()), "")
        yield (symbol(name), unit, *(_estimate(entries.get(run)) for run in runs), _apart(list(entries.values())))


def _estimate(found: Estimate | None) -> Markup | str:
    if found is None:
        return NO_VALUE
    shown, sure = parameter_quantity(found)
    if not sure:
        return Markup("{} {}").format(shown.value, status_pill(found.status))
    return Markup("{}<small>{} … {}</small>").format(shown.value, shown.low, shown.high)


def _apart(entries: Sequence[Estimate]) -> str:
    known = [(e.value, e.sd) for e in entries if math.isfinite(e.value) and e.sd]
    gaps = [
        abs(a - b) / math.hypot(s, t) for k, (a, s) in enumerate(known) for b, t in known[k + 1 :] if s and t
    ]  # fmt: skip
    return significant(max(gaps), 2) if gaps else NO_VALUE


def _error_rows(runs: Runs) -> Iterator[Row]:
    """Yield the RMS of the residual, by recording and output."""
    read = dict.fromkeys((r, o) for run in runs.values() for r in run.recordings() for o in run.signals("measured", r))
    for recording, output in read:
        sizes = [_rms(run, recording, output) for run in runs.values()]
        unit = next(filter(None, (run.result.unit(output) for run in runs.values())), "")
        if any(size is not None for size in sizes):
            name = Markup("error of {}<small>{}</small>").format(symbol(output), recording)
            yield (name, pretty_unit(unit), *(significant(size) for size in sizes), "")


def _rms(run: RunDirectory, recording: str, output: str) -> float | None:
    values = left_over(run, recording, output, FINAL_SERIES) if recording in run.recordings() else None
    return None if values is None else float(np.sqrt(np.nanmean(values**2)))


def _setting_rows(runs: Runs) -> Iterator[Row]:
    """Yield everything about how the runs were made that is not the same for all."""
    told = all(run.result.settings for run in runs.values())
    found = [dict(_flat("", run.result.settings) if told else ()) | dict(_circumstances(run)) for run in runs.values()]
    for key in dict.fromkeys(k for f in found for k in f):
        if len({repr(f.get(key)) for f in found}) > 1:
            yield (Markup("<code>{}</code>").format(key), "", *(generic_cell(f.get(key)) for f in found), "")


def _circumstances(run: RunDirectory) -> Iterator[tuple[str, object]]:
    result = run.result
    yield "command", result.command
    yield "seed", None if result.seed is None else str(result.seed)
    yield from ((f"model.{key}", value) for key, value in result.model.model_dump().items() if key != "fmu_sha256")
    yield "data", [f"{row.file} {row.sha256[:8]}" for row in result.data]
    yield "effects", [effect.id for effect in result.loop.effects] if result.loop else []
    yield from (("versions." + key, value) for key, value in result.versions.items())


def _flat(path: str, node: object) -> Iterator[tuple[str, object]]:
    if isinstance(node, Mapping):
        for key, value in node.items():
            yield from _flat(f"{path}.{key}" if path else str(key), value)
    else:
        yield path, node
