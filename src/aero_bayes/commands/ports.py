"""``aero-bayes ports``: where an effect may be missing in a model, which laws fit, and whether the data show it."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from aero_bayes.commands.job import RunOptions, open_job, which_model, without_units
from aero_bayes.commands.stages import fit_settings
from aero_bayes.config import load_config
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import InputError
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.result import Fit
from aero_bayes.files import ScratchFolder
from aero_bayes.laws.balance import port_table
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.extend import Limit, limits_of
from aero_bayes.loop.first_fit import LoopStatistics
from aero_bayes.loop.fmu_family import FmuFamily, FmuPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.loop.models import ModelSource
from aero_bayes.loop.screen import MIN_BARELY_VISIBLE, MIN_VISIBLE, Screened
from aero_bayes.loop.search import Effort, Library, Search
from aero_bayes.loop.table import law_of
from aero_bayes.modelica.library import path_in_library
from aero_bayes.parallel import ParallelMap
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.workers import WorkerPool

PortRow = dict[str, Any]

RESPONSE_NOTES = (
    "response: change of the outputs, in standard deviations of their noise, by the law that shows most, of its "
    "nominal size (a force as large as the others at the port), less what the free parameters imitate.",
    f"visible in these data: yes from {MIN_VISIBLE:g}, barely from {MIN_BARELY_VISIBLE:g}.",
    "limits: the size of each law, a value of its first parameter, from which on it is material: its lack raises the "
    "error that the model leaves now by a third.",
)
#: Share of the error that a law of the shortlist explains by itself at least.
LISTED_SHARE = 0.1
#: Columns of a terminal.
WIDTH = 80
IMITATED_NOTE = "imitated: laws that are not seen, since free parameters change the outputs as they do."


def run_ports(model: str | None, config: Path | None, data: Sequence[Path] = (), *, as_json: bool = False) -> None:
    """Print the ports of a model; with recordings, whether an effect there would be visible."""
    with ScratchFolder() as scratch:
        rows = _rows(RunOptions(scratch / "run", model, config, quiet=True), data)
    click.echo(json.dumps(rows, indent=2) if as_json else _as_table(rows))
    if data and not as_json:
        notes = [*RESPONSE_NOTES, *([IMITATED_NOTE] if any(row.get("imitated") for row in rows) else [])]
        click.echo("\n".join(map(_wrapped, [*notes, *shortlist(rows)])))


def _rows(options: RunOptions, data: Sequence[Path]) -> list[PortRow]:
    config = load_config(options.config)
    name, fmu = which_model(config, options)
    if fmu is not None:
        around = FmuPlaces(fmu.stem, config.model.sources, config.model.libraries, fmu=fmu)
        around.check()
        if without := without_units(around.inner):
            click.echo(f"note: {without}", err=True)
        return _seen(port_table(around.ports), FmuFamily(around, options.out), options, data)
    places = LawPlaces(name, config.model.sources, config.model.libraries)
    if not places.declared.effects:
        return _seen(port_table(places.ports), ModelicaFamily(places, options.out), options, data)
    if data:
        raise InputError(f"{name}: --data is not possible, because {places.declared.package} declares its ports")
    named = [c for c in places.candidates if c.alias]
    return [{"id": c.id, "port": places.place_name(c), "summary": places.describe(c)} for c in named]


def _seen(rows: list[PortRow], family: ModelicaFamily, options: RunOptions, data: Sequence[Path]) -> list[PortRow]:
    """Return rows of ports with what recordings, if there are any, show of each."""
    if not data:
        return rows
    job = open_job(data, options)
    settings = replace(fit_settings(job), method="local")
    found = fit(
        job.recordings, job.model, parameters=job.parameters, settings=settings, seed=options.seed,
        workers=options.workers, explain=False,
    )  # fmt: skip
    every, limits = _screened(found, family, options.workers)
    for row in rows:
        own = {law_of(t): one for t, one in every.items() if one.port == row["id"]}
        row["response"] = max((one.response for one in own.values()), default=None)
        row["visible"] = visibility(row["response"])
        row["imitated"] = {law: join_names(one.imitators) for law, one in own.items() if one.imitators}
        row["limits"] = [vars(one) for one in limits if one.port == row["id"]]
        row["explains"] = {f"{law}@{row['id']}": -math.expm1(-max(one.gain, 0.0)) for law, one in own.items()}
    return rows


def _screened(fit: Fit, family: ModelicaFamily, workers: int | None) -> tuple[dict[str, Screened], tuple[Limit, ...]]:
    """What the recordings of a fit show of each law at each port of its model, beside what the fit leaves."""
    with WorkerPool(workers) as pool:
        open_ = partial(open_simulator, pool=pool)
        objective = lambda own: objective_of(own, open_(own.problem()))  # noqa: E731
        source = ModelSource(family, fit.calibration, fit.free, objective, open_, {})
        placed = family.prepare(fit.calibration, fit.optimum, open_)
        laws = tuple(t for t in placed if t not in family.curves())
        library, effort = Library(laws, {}, ()), Effort(beside_declared=False)
        search = Search(source, library, fit.floors, ParallelMap(pool), LoopStatistics(), effort=effort)
        search.begin(dict(zip(fit.calibration.parameters.names, fit.values.tolist(), strict=True)))
        found = search.screen((), laws)
        search.models.close()
        return found, limits_of(search, ())


def visibility(response: float | None) -> str:
    """Return whether the data show a term at a port: ``yes``, ``barely`` or ``no`` by its response.

    ``unknown`` without."""
    if response is None:
        return "unknown"
    if response >= MIN_VISIBLE:
        return "yes"
    return "barely" if response >= MIN_BARELY_VISIBLE else "no"


def shortlist(rows: Sequence[PortRow]) -> list[str]:
    """Say which laws explain a part of what is left by themselves, and how a loop is narrowed to them."""
    shares = {t: share for row in rows for t, share in row.get("explains", {}).items()}
    best = sorted((t for t in shares if shares[t] > LISTED_SHARE), key=lambda t: -shares[t])
    told = f"{len(best) or 'none'} of {len(shares)} laws {'explain' if len(best) > 1 else 'explains'}"
    told += " more than a tenth of what is left"
    listed = ", ".join(f"{t} {shares[t]:.0%}" for t in best)
    named = ", ".join(json.dumps(t) for t in best)
    less = "a law that shows beside another one only may not be among them."
    return [f"{told}: {listed}.", f"[loop] effects = [{named}] tries these only; {less}"] if best else [f"{told}."]


def _wrapped(text: str, indent: str = "") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=f"{indent}  ", break_on_hyphens=False)


def _as_table(rows: Sequence[PortRow]) -> str:
    """Return rows as aligned columns with a header; what is too wide for a terminal below each row."""
    shown = [_cells(row) for row in rows]
    if not shown:
        return "no ports"
    columns = [key for key in shown[0] if key not in BELOW]
    widths = {key: max(len(key), *(len(cells[key]) for cells in shown)) for key in columns}
    while sum(widths.values()) + 2 * (len(widths) - 1) > WIDTH and len(widths) > 1:
        del widths[max(list(widths)[1:], key=lambda key: widths[key])]
    lines = ["  ".join(key.ljust(width) for key, width in widths.items()).rstrip()]
    for cells in shown:
        lines.append("  ".join(cells[key].ljust(width) for key, width in widths.items()).rstrip())
        below = (key for key in cells if key not in widths and cells[key] not in ("", "-"))
        lines += [_wrapped(f"{key}: {cells[key]}", "    ") for key in below]
    return "\n".join(lines)


#: What stands below the row of a port.
BELOW = ("imitated", "limits", "laws", "no size is seen of", "summary")


def _cells(row: PortRow) -> dict[str, str]:
    cells: dict[str, str] = {}
    for key, value in row.items():
        if key in ("line", "explains"):
            continue
        text = f"{path_in_library(value)}:{row['line']}" if key == "file" and value else value
        if key == "limits":
            text = ", ".join(f"{one['law']} {with_unit(format(one['smallest'], '.2g'), one['unit'])}" for one in value)
        if key == "imitated":
            text = "; ".join(f"{law} by {names}" for law, names in value.items())
        if key == "response":
            text = "" if value is None else f"{value:.3g}"
        if key == "laws" and "limits" in row:  # the others are there with their limits
            key, known = "no size is seen of", {one["law"] for one in row["limits"]}
            text = ", ".join(law for law in map(law_of, row["explains"]) if law not in known)
        cells[key] = " ".join(text) if isinstance(text, list) else str(text) or "-"
    return cells
