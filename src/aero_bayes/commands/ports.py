"""``aero-bayes ports``: where an effect may be missing in a model, which laws fit, and whether the data show it."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.commands.job import RunOptions, open_job, which_model, without_units
from aero_bayes.commands.loop import fit_settings
from aero_bayes.config import load_config
from aero_bayes.data.noise import output_noise_floor
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import InputError
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.objective import Objective, objective_of
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.priors import Uniform
from aero_bayes.estimate.result import Fit
from aero_bayes.files import ScratchFolder
from aero_bayes.laws.balance import PORT_KINDS, Port, port_table
from aero_bayes.laws.candidates import identifier
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.probes import with_drive
from aero_bayes.loop.extend import Limit, limits_of
from aero_bayes.loop.first_fit import LoopStatistics
from aero_bayes.loop.fmu_family import FmuPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.loop.models import ModelSource
from aero_bayes.loop.nominal_values import NOMINAL_QUANTILE, port_nominals
from aero_bayes.loop.search import Effort, Library, Search
from aero_bayes.loop.table import law_of
from aero_bayes.modelica.compose import add_parameter
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.library import path_in_library
from aero_bayes.modelica.syntax import Call, Expression, Name, Number
from aero_bayes.parallel import ParallelMap
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.workers import WorkerPool

PortRow = dict[str, Any]

#: The response of a port is the change of the outputs, in standard deviations of noise, to a probe as large as all else
#: at the port. Responses from which a term counts as barely visible, and as visible.
MIN_BARELY_VISIBLE_RESPONSE, MIN_VISIBLE_RESPONSE = 3.0, 30.0
RESPONSE_NOTES = (
    "response: change of the outputs, in standard deviations of their noise, by a term as large as all else at "
    "the port, less what the free parameters imitate.",
    f"visible in these data: yes from {MIN_VISIBLE_RESPONSE:g}, barely from {MIN_BARELY_VISIBLE_RESPONSE:g}.",
    "limits: the size of each law, a value of its first parameter, from which on it is material: its lack raises the "
    "error that the model leaves now by a third.",
)
#: Share of the error that a law of the shortlist explains by itself at least.
LISTED_SHARE = 0.1
#: Columns of a terminal.
WIDTH = 80
#: Share of a probe's signature up to which parameters do the same.
MOST_LEFT = 0.1
IMITATED_NOTE = "imitated: terms that are not seen, since free parameters change the outputs as they do."
#: Share of a signal's size over which what changes with its direction changes.
TRANSITION_SHARE = 0.1


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
        if data:
            raise InputError(f"{fmu}: --data needs the Modelica source of the model, not an FMU")
        around = FmuPlaces(fmu.stem, config.model.sources, config.model.libraries, fmu=fmu)
        around.check()
        if without := without_units(around.inner):
            click.echo(f"note: {without}", err=True)
        return port_table(around.ports)
    places = LawPlaces(name, config.model.sources, config.model.libraries)
    if not places.declared.effects:
        return _model_ports(places, options, data)
    if data:
        raise InputError(f"{name}: --data is not possible, because {places.declared.package} declares its ports")
    named = [c for c in places.candidates if c.alias]
    return [{"id": c.id, "port": places.place_name(c), "summary": places.describe(c)} for c in named]


def _model_ports(places: LawPlaces, options: RunOptions, data: Sequence[Path]) -> list[PortRow]:
    """Return rows of :func:`~aero_bayes.laws.balance.port_table`, with recordings what these show of each port.

    ``options.out`` is where FMUs are built for the recordings' sake."""
    rows: list[PortRow] = port_table(places.ports)
    if data:
        job = open_job(data, options)
        settings = replace(fit_settings(job), method="local")
        found = fit(
            job.recordings, job.model, parameters=job.parameters, settings=settings, seed=options.seed,
            workers=options.workers, explain=False,
        )  # fmt: skip
        family = ModelicaFamily(places, options.out)
        responses, imitated = _port_responses(family, found)
        limits, shares = _limits(found, family, options.workers)
        for row in rows:
            row["response"] = responses.get(row["id"])
            row["visible"] = visibility(row["response"])
            row["imitated"] = imitated.get(row["id"], {})
            row["limits"] = [vars(one) for one in limits if one.port == row["id"]]
            row["explains"] = {t: share for t, (port, share) in shares.items() if port == row["id"]}
    return rows


def _limits(
    fit: Fit, family: ModelicaFamily, workers: int | None
) -> tuple[tuple[Limit, ...], dict[str, tuple[str, float]]]:
    """What the recordings of a fit show of each law at each port of its model, beside what the fit leaves.

    Also the port of each law, and the share of the error that it promises to explain."""
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
        return limits_of(search, ()), {t: (s.port, -math.expm1(-max(s.gain, 0.0))) for t, s in found.items()}


def visibility(response: float | None) -> str:
    """Return whether the data show a term at a port: ``yes``, ``barely`` or ``no`` by its response.

    ``unknown`` without."""
    if response is None:
        return "unknown"
    if response >= MIN_VISIBLE_RESPONSE:
        return "yes"
    return "barely" if response >= MIN_BARELY_VISIBLE_RESPONSE else "no"


def _port_responses(family: ModelicaFamily, found: Fit) -> tuple[dict[str, float], dict[str, dict[str, str]]]:
    """Return how many standard deviations of noise a probe of each port's own size moves the outputs by.

    Also the parameters that do the same, by port and what the probe is like. The noise is that of the fit or that of
    the readings alone, whichever shows the probe more: a model that lacks an effect leaves a residual that is larger
    and slower than what sensors add."""
    flat = family.places.flat
    ports = [p for p in family.places.ports if p.attachment in ("input", "output", "signal") or p.balance is not None]
    sizes = port_nominals(flat, ports, found.calibration, found.optimum, open_simulator)
    readings = [p for p in ports if p.attachment == "output"]
    inside = [p for p in ports if p.attachment != "output"]
    flat, probed = _with_probes(flat, inside, sizes)
    model = Model.load(export_flat(flat, family.folder / "probed.fmu"))
    own = len(found.calibration.parameters)
    probes = [_probe(name, p, sizes[p.id][f"{PORT_KINDS[p.kind].acts}_n"]) for p in inside for name in probed[p.id]]
    calibration = family.transfer(found.calibration, model)
    calibration = replace(calibration, parameters=calibration.parameters.extended(probes))
    free = found.free
    at = calibration.parameters.to_search(np.concatenate([found.values, np.zeros(len(probes))]))
    with open_simulator(calibration.problem()) as simulator:
        objective = Objective(calibration, simulator)
        run = objective.evaluate(at, [*free, *range(own, own + len(probes))])
        if run is None:
            raise InputError(f"{family.places.base}: cannot be simulated with probes at its ports")
        assert run.slopes is not None
        changed, likes = _reading_responses(objective, run.predicted, readings, sizes)
        slopes = tuple(np.concatenate(rows) for rows in zip(run.slopes, changed, strict=True))
        noises = (found.optimum.noise, _noise_of_readings(found))
        whitened = [objective.whiten(replace(run, slopes=slopes), noise).slopes for noise in noises]
    seen = [(rows[: len(free)], rows[len(free) :]) for rows in whitened]
    left = np.max([np.linalg.norm(_orthogonal_part(rows, own), axis=1) for own, rows in seen], axis=0)
    kinds = [(p.id, like) for p in inside for like in probed[p.id].values()] + likes
    free_names, imitated = [found.calibration.parameters.names[j] for j in free], dict[str, dict[str, str]]()
    for (id_, like), size, row in zip(kinds, left, seen[0][1], strict=True):
        if visibility(size) == "no" and visibility(float(np.linalg.norm(row))) == "yes":
            imitated.setdefault(id_, {})[like] = _imitators(row, seen[0][0], free_names)
    responses = {
        p.id: max(float(size) for (id_, _), size in zip(kinds, left, strict=True) if id_ == p.id) for p in ports
    }
    return responses, imitated


def _imitators(row: FloatArray, slopes: FloatArray, names: Sequence[str]) -> str:
    """Name the fewest parameters whose change moves the outputs as a probe does."""
    chosen: list[int] = []
    left, sizes = row, np.maximum(np.linalg.norm(slopes, axis=1), 1e-300)
    while np.linalg.norm(left) > MOST_LEFT * np.linalg.norm(row) and len(chosen) < len(names):
        chosen.append(int(np.argmax(np.abs(slopes @ left) / sizes)))
        left = _orthogonal_part(row[np.newaxis], slopes[chosen])[0]
    return join_names([names[j] for j in chosen])


def _noise_of_readings(found: Fit) -> dict[str, OutputNoise]:
    """Return the noise of each output from its readings alone, the largest of all recordings.

    The fit's where unknown."""
    noise = dict(found.optimum.noise)
    for output in noise:
        floors = [output_noise_floor(r, output) for r in found.calibration.data.recordings if output in r.outputs]
        largest = max((floor.at_most for floor in floors), default=0.0)
        if largest > 0.0:
            noise[output] = OutputNoise(largest)
    return noise


def _reading_responses(
    objective: Objective,
    predicted: Sequence[FloatArray],
    ports: Sequence[Port],
    sizes: Mapping[str, Mapping[str, float]],
) -> tuple[list[FloatArray], list[tuple[str, str]]]:
    """Return responses to readings that are off, by a share, or late, (3 q, n) a series; and port and kind of each.

    A small delay takes its time's worth of the rate from an output, as a lag does; here as much as makes the largest
    change as large as the output."""
    rates = [np.gradient(y, s.sampling.time) for s, y in zip(objective.series, predicted, strict=True)]
    rows = [np.zeros((3 * len(ports), rate.size)) for rate in rates]
    for q, port in enumerate(ports):
        own = [k for k, series in enumerate(objective.series) if series.output == port.signals["u"].first]
        fastest = np.quantile(np.abs(np.concatenate([rates[k] for k in own])), NOMINAL_QUANTILE) if own else 0.0
        size = sizes[port.id][f"{PORT_KINDS[port.kind].acts}_n"]
        for k in own:
            late = -size / fastest * rates[k] if fastest > 0.0 else np.zeros_like(rates[k])
            rows[k][3 * q : 3 * q + 3] = np.full_like(rates[k], size), predicted[k], late
    kinds = [(p.id, like) for p in ports for like in ("a constant", f"proportional to {p.signals['u']}", "a lag")]
    return rows, kinds


def _with_probes(
    flat: FlatModel, ports: Sequence[Port], sizes: Mapping[str, Mapping[str, float]]
) -> tuple[FlatModel, dict[str, dict[str, str]]]:
    """Return the model with parameters at every port whose exact sensitivities are the responses to its probes.

    Also what each probe is like, by port and parameter."""
    names: dict[str, dict[str, str]] = {}
    for port in ports:
        whole: Expression = Number(0.0)
        names[port.id] = {}
        for k, (like, shape) in enumerate(_shapes(port, sizes[port.id])):
            name = f"probe_{identifier(port.id)}_{k}"
            flat = add_parameter(flat, name, 0.0, port.unit)
            whole = Call("+", (whole, Call("*", (Name(name), shape))))
            names[port.id][name] = like
        flat = with_drive(flat, port, whole, next((p for p in ports if p.id in port.neighbours[:1]), None))
    return flat, names


def _shapes(port: Port, sizes: Mapping[str, float]) -> list[tuple[str, Expression]]:
    """Return shapes of the probes at a port, scaled to size one: a constant, and functions of each signal."""
    found: list[tuple[str, Expression]] = [("a constant", Number(1.0))]
    for signal, variable in port.signals.items():
        if f"{signal}_n" not in sizes:
            continue
        level = variable.expression
        if "h_0" in sizes:
            zero = port.signals["h_s"].expression if "h_s" in port.signals else Number(sizes["h_0"])
            level = Call("-", (level, zero))
        share = Call("/", (level, Number(sizes[f"{signal}_n"])))
        found.append((f"proportional to {variable}", share))
        if port.kind == "input":
            found.append((f"{variable} squared", Call("*", (share, Call("abs", (share,))))))
        elif signal in ("v", "i"):
            step = Call("tanh", (Call("/", (share, Number(TRANSITION_SHARE))),))
            found.append((f"with the sign of {variable}", step))
    return found


def _probe(name: str, port: Port, size: float) -> Parameter:
    """Return a probe whose search coordinate runs in units of the port's size."""
    half = 0.5 * size
    about, target = f"probe at {port.id}", ParameterTarget(name)
    return Parameter(name, port.unit, 0.0, -half, half, Uniform(-half, half), "linear", about, target)


def _orthogonal_part(rows: FloatArray, nuisance: FloatArray) -> FloatArray:
    """Return rows (q, N) less their projection onto the span of rows (k, N)."""
    if not nuisance.size:
        return rows
    _, values, basis = np.linalg.svd(nuisance, full_matrices=False)
    basis = basis[values > 1e-9 * values.max(initial=0.0)]
    left: FloatArray = rows - (rows @ basis.T) @ basis
    return left


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
            text = "; ".join(f"{like} by {names}" for like, names in value.items())
        if key == "response":
            text = "" if value is None else f"{value:.3g}"
        if key == "laws" and "limits" in row:  # the others are there with their limits
            key, known = "no size is seen of", {one["law"] for one in row["limits"]}
            text = ", ".join(law for law in map(law_of, row["explains"]) if law not in known)
        cells[key] = " ".join(text) if isinstance(text, list) else str(text) or "-"
    return cells
