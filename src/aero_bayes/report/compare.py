"""Finished runs side by side: parameters with their intervals, residuals over each other, settings that differ."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from aero_bayes.errors import InputError
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.files import write_whole
from aero_bayes.report.curves import FINAL_SERIES, largest, left_over
from aero_bayes.report.drawing import Line, Panel, Plate, plate
from aero_bayes.report.page import Part, Parts, fill, with_parts
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import SERIES
from aero_bayes.report.tables import generic_cell, html_table, intervals_glyph, parameter_quantity, status_pill
from aero_bayes.report.text import NO_VALUE, pretty_unit, scaled_unit, signal_title, significant, symbol

Runs = Mapping[str, RunDirectory]


def write_comparison(directories: Sequence[Path | str], out: Path | str) -> Path:
    """Return one page that sets runs side by side."""
    if not 2 <= len(directories) <= len(SERIES):
        raise InputError(f"{len(directories)} runs cannot be compared; expected 2 to {len(SERIES)} directories")
    runs = dict(zip(_names([Path(d) for d in directories]), map(RunDirectory.read, directories), strict=True))
    verdicts = {name: run.result.verdict for name, run in runs.items()}
    residuals = _residual_plates(runs) or ["The runs have no recording in common."]
    settings = _settings_table(runs) or "All settings are the same."
    context = {
        "title": " against ".join(runs), "kicker": "aero-bayes · compare", "simulated": False, "warnings": (),
        "legend": [(SERIES[k], name) for k, name in enumerate(runs)], "finding": (), "opening": (),
        "verdicts": [(found.level, name, found.text) for name, found in verdicts.items() if found],
        "sections": with_parts(
            Parts("Parameters", [_estimates_by_run_table(runs)], "parameters"),
            Parts("Residuals", [_rms_by_run_table(runs), *residuals], "residuals"),
            Parts("Settings", [settings], "settings"),
        ),
    }  # fmt: skip
    return write_whole(Path(out), fill("page.html.jinja", context, [run.result for run in runs.values()]))


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


def _estimates_by_run_table(runs: Runs) -> Markup:
    """Write value, interval and status of every parameter, run by run."""
    rows = []
    for name, entries in _shared(runs).items():
        unit = next((pretty_unit(entry.unit) for entry in entries.values()), "")
        sure = [e if (e := entries.get(run)) and parameter_quantity(e)[1] else None for run in runs]
        drawn = intervals_glyph(name, sure, SERIES) if len(sure) - sure.count(None) > 1 else ""
        shown = (_estimate(entries.get(run)) for run in runs)
        rows.append((symbol(name), drawn, unit, *shown, _apart(list(entries.values()))))
    heads = ("parameter", "a scale for each row", "unit", *runs, "largest difference (combined sd)")
    return html_table(heads, rows, "Parameters, with 90 % intervals")


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


def _residual_plates(runs: Runs) -> list[Part]:
    """Return residuals of all runs for each recording that at least two of them have."""
    names = dict.fromkeys(name for run in runs.values() for name in run.recordings())
    found: list[Part] = []
    for name in names:
        seen = {k: run for k, run in runs.items() if name in run.recordings()}
        if len(seen) > 1 and (drawn := _residual_plate(runs, seen, name)) is not None:
            found += [Markup("<h3>{}</h3>").format(name), drawn]
    return found


def _residual_plate(runs: Runs, seen: Runs, recording: str) -> Plate | None:
    outputs = dict.fromkeys(output for run in seen.values() for output in run.signals("measured", recording))
    panels = []
    for output in outputs:
        found = {k: left_over(run, recording, output, FINAL_SERIES) for k, run in seen.items()}
        left = {k: values for k, values in found.items() if values is not None}
        if not left:
            continue
        result = seen[next(iter(left))].result
        factor, unit = scaled_unit(largest(*left.values()), result.unit(output))
        lines = tuple(
            Line(seen[k].time(recording), factor * values, SERIES[list(runs).index(k)], 1.1, label=k, cloud=0.35,
                 trend=True, rms=True)
            for k, values in left.items()
        )  # fmt: skip
        title = f"residual of {signal_title(output, unit, result.description(output))}"
        panels.append(Panel(title, lines, 120, ticks=3))
    alt = f"Recording {recording}: residuals of {', '.join(seen)} over each other."
    return plate(panels, alt, "time (s)", link=recording) if panels else None


def _rms_by_run_table(runs: Runs) -> Markup:
    """Write the RMS of the residual, by recording and output."""
    rows = []
    read = dict.fromkeys((r, o) for run in runs.values() for r in run.recordings() for o in run.signals("measured", r))
    for recording, output in read:
        sizes = [_rms(run, recording, output) for run in runs.values()]
        unit = next(filter(None, (run.result.unit(output) for run in runs.values())), "")
        if any(size is not None for size in sizes):
            rows.append((recording, symbol(output), pretty_unit(unit), *(significant(size) for size in sizes)))
    return html_table(("recording", "output", "unit", *runs), rows, "RMS of the residual")


def _rms(run: RunDirectory, recording: str, output: str) -> float | None:
    values = left_over(run, recording, output, FINAL_SERIES) if recording in run.recordings() else None
    return None if values is None else float(np.sqrt(np.nanmean(values**2)))


def _settings_table(runs: Runs) -> Markup:
    """Return everything about how the runs were made that is not the same for all."""
    told = all(run.result.settings for run in runs.values())
    found = [dict(_flat("", run.result.settings) if told else ()) | dict(_circumstances(run)) for run in runs.values()]
    keys = [key for key in dict.fromkeys(k for f in found for k in f) if len({repr(f.get(key)) for f in found}) > 1]
    rows = [(Markup("<code>{}</code>").format(key), *(generic_cell(f.get(key)) for f in found)) for key in keys]
    return html_table(("setting", *runs), rows, "Settings that differ")


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
