"""``aero-bayes init``: the configuration that a newcomer needs, written from a model and a recording of it."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.commands.job import columns_of, layout_of, tell_notes, without_units
from aero_bayes.config import Config
from aero_bayes.data.columns import split_unit
from aero_bayes.data.read import column_names, read_recordings
from aero_bayes.data.table import clocks_of, is_time_name
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet, parameters_from_model
from aero_bayes.files import write_whole
from aero_bayes.modelica.class_reader import build_tree, read_library
from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.parse import without_indices
from aero_bayes.modelica.sources import as_packages, main_class, modelica_files
from aero_bayes.modelica.units import conversion, to_modelica_unit
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.load_model import load_model
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable
from aero_bayes.unknown_names import no_such_file

#: Number of sample times at which sensitivities are computed.
SAMPLE_COUNT = 2000
#: Change of an output, as a share of its range, by a relative change of one of a parameter, below which it has none.
MIN_OUTPUT_CHANGE = 1e-4
#: Share of a parameter's effect outside the span of the others' effects below which it cannot be told from them.
MIN_UNIQUE_SHARE = 1e-3
#: A temperature in K where nothing is known.
ROOM_TEMPERATURE = 293.15
#: How a column is called that may name the run of a row.
BATCH_NAME = re.compile(r"(run|batch|experiment|trial|cycle|series)([ _]?(id|no|nr|number|name))?", re.I)
#: Why a parameter is left to what the data tell.
CONFOUNDED = "the outputs cannot distinguish it from the parameters above"


@dataclass(frozen=True)
class ColumnMatch:
    """Matched columns by signal, and the unmatched signals and columns."""

    columns: dict[str, str]
    signals_left: tuple[str, ...]
    columns_left: tuple[str, ...]


def run_init(source: Path, data: Path, out: Path, *, model: str | None = None, libraries: Sequence[Path] = ()) -> None:
    """Write a configuration for a model and a recording."""
    if out.exists():
        raise InputError(f"{out}: exists already; remove it or give another --out")
    if not out.absolute().parent.is_dir():
        raise InputError(f"{out}: its folder does not exist")
    for path in (source, data):
        if not path.exists():
            raise InputError(no_such_file(path))
    (source,) = as_packages([source])
    is_fmu = source.suffix.lower() == ".fmu"
    name = source.stem if is_fmu else model or main_class(source)
    built = Model.load(source) if is_fmu else load_model(name, sources=[source], libraries=libraries)
    signals = ["time", *(v.name for v in (*built.inputs, *built.outputs))]
    units = {"time": "s"} | {v.name: v.unit for v in (*built.inputs, *built.outputs)}
    there = column_names(data)
    matched = match_columns(signals, there, units)
    if not matched.columns:
        shown = ", ".join(there[:20])
        raise InputError(f"{data}: no column matches a signal of {name} ({', '.join(signals)}); found {shown}")
    clocks = clocks_of(str(data), there, {s: c for s, c in matched.columns.items() if s != "time"})
    if "time" in matched.signals_left and clocks:
        left = tuple(s for s in matched.signals_left if s != "time"), matched.columns_left
        matched = ColumnMatch(matched.columns, left[0], tuple(c for c in left[1] if c not in clocks.values()))
    head = _head(name, [source, *libraries], out, built, data, matched)
    own = _own_parameters(built, name, [] if is_fmu else modelica_files([source]))
    later = frozenset[str]() if is_fmu else _compared(name, source, libraries)
    # the user's own first, and values before break points: of two that the outputs cannot tell apart, the first is free
    ordered = sorted(
        built.parameters, key=lambda v: (v.name not in own, without_indices(v.name) in later, "." in v.name)
    )
    text = head + _parameter_lines(ordered, _reasons(built, ordered, own, head, data))
    Config.model_validate(tomllib.loads(text))
    write_whole(out, text)
    click.echo(f"wrote {out}")
    if is_fmu and (without := without_units(built)):
        click.echo(f"note: {without}", err=True)
    for signal in matched.signals_left:
        click.echo(f"no column of {data.name} matches {signal}; name one in {out}")


def _own_parameters(model: Model, name: str, files: Iterable[Path]) -> set[str]:
    """Parameters that the user's own sources declare or set, not a library; all of a model that is not in these."""
    library = read_library(files)
    tree = build_tree(library, name) if name in library else None
    return {v.name for v in model.parameters if tree is None or tree.sets(v.name)}


def _compared(name: str, source: Path, libraries: Sequence[Path]) -> frozenset[str]:
    """Parameters that conditions compare, arrays by their names; none of a model that only OpenModelica takes."""
    try:
        return frozenset(map(without_indices, explicit_model(name, [source], libraries).compared()))
    except InputError:
        return frozenset()


def match_columns(
    signals: Sequence[str], columns: Sequence[str], units: Mapping[str, str] | None = None
) -> ColumnMatch:
    """Match a file's columns, the surest first, and only where there is no second one.

    By exact name; without case, unit and punctuation, or by a word for time; where a signal's name is a word of a
    column's; where they alone measure the same kind of quantity; the last to the last."""
    found = {s: s for s in signals if s in columns}
    named = {c: split_unit(c) for c in columns}
    given = {s: u for s, u in (units or {}).items() if u not in ("", "1")}

    # a column may be called by its unit; with a digit it is a name: h1 is no hour
    units_of = {c: unit or (to_modelica_unit(c) if not re.search(r"\d", c) else "") for c, (_, unit) in named.items()}

    def timed(signal: str, column: str) -> bool:
        return signal == "time" and is_time_name(named[column][0])

    def alike(signal: str, column: str) -> bool:
        is_time = signal == "time" and not named[column][1] and conversion(units_of[column], "s") is not None
        return is_time or _bare(named[column][0]) == _bare(signal)

    def possible(signal: str, column: str) -> bool:
        unit = named[column][1]
        return signal not in given or not unit or conversion(unit, given[signal]) is not None

    def within(signal: str, column: str) -> bool:
        words = re.findall(r"[a-z]+|[^\W_a-z]+", named[column][0].casefold())
        return possible(signal, column) and signal.casefold() in words

    def measures(signal: str, column: str) -> bool:
        unit = units_of[column]
        return signal in given and bool(unit) and conversion(unit, given[signal]) is not None

    for fits in (timed, alike, within, measures):
        pairs = [(s, c) for s in signals for c in columns if s not in found and c not in found.values() and fits(s, c)]
        for signal, column in pairs:
            if sum(signal == s or column == c for s, c in pairs) == 1:
                found[signal] = column
    signals_left = [s for s in signals if s not in found]
    columns_left = [c for c in columns if c not in found.values()]
    if len(signals_left) == len(columns_left) == 1 and possible(signals_left[0], columns_left[0]):
        found[signals_left.pop()] = columns_left.pop()
    return ColumnMatch(found, tuple(signals_left), tuple(columns_left))


def _bare(name: str) -> str:
    """Return a name without case and punctuation: ``i_load`` and ``ILoad`` are one."""
    return re.sub(r"[\W_]", "", name.casefold()) or name


def _head(name: str, files: Sequence[Path], out: Path, model: Model, data: Path, matched: ColumnMatch) -> str:
    """Write everything before the parameters."""
    source, *libraries = (Path(os.path.relpath(f, out.absolute().parent)).as_posix() for f in files)
    is_fmu = source.lower().endswith(".fmu")
    lines = [
        f"# To fit {name} to {data.name}: aero-bayes fit --config {out.name} --data {data.name} --out DIR",
        "",
        "[model]",
        *([f"fmu = {_text(source)}"] if is_fmu else [f"sources = [{_text(source)}]", f"name = {_text(name)}"]),
        *([f"libraries = [{', '.join(map(_text, libraries))}]"] if libraries else []),
        "",
        "# Values are in the units that the model declares.",
        "[data]",
        *_signal_lines("inputs", model.inputs, matched),
        *_signal_lines("outputs", model.outputs, matched),
        *(f"# batch = {_text(c)}  # if this column says which run a row is of" for c in matched.columns_left
          if BATCH_NAME.fullmatch(c)),
    ]  # fmt: skip
    units = {"time": "s"} | {v.name: v.unit for v in (*model.inputs, *model.outputs)}
    lines += ["", "# Columns with another name or unit than the signal; scale and offset are possible, too.",
              "[data.columns]"]  # fmt: skip
    for signal, column in matched.columns.items():
        plain, unit = split_unit(column)
        unit = unit or (to_modelica_unit(column) if conversion(column, units[signal] or "?") else "")
        known = conversion(unit, units[signal]) if unit and units[signal] else (1.0, 0.0)
        if signal == column:
            continue
        given = f", unit = {_text(unit)}" if known not in (None, (1.0, 0.0)) or unit == "%" else ""
        alike = _bare(plain) == _bare(signal) or (signal == "time" and is_time_name(plain))
        doubts = [] if alike else ["is this the right column?"]
        doubts += [] if known else [f"in {unit}, but the model has {units[signal]}: give scale"]
        doubt = f"  # {'; '.join(doubts)}" if doubts else ""
        lines.append(f"{_key(signal)} = {{source = {_text(column)}{given}}}{doubt}")
    left = f"unused columns: {', '.join(matched.columns_left)}" if matched.columns_left else "no unused column"
    lines += [f'# {_key(s)} = {{source = "?"}}  # not matched, {left}' for s in matched.signals_left]
    lines += ["", "[fit]", '# "reading": states start at the first reading; "estimated": all are fitted;',
              '# "auto": those that are read are fitted, the others start where the model says',
              'initial_states = "auto"', "", ""]  # fmt: skip
    return "\n".join(lines)


def _signal_lines(role: str, variables: Sequence[Variable], matched: ColumnMatch) -> list[str]:
    known = [v for v in variables if v.name in matched.columns]
    lines = [f"# {v.name}: {_about(v)}" for v in known]
    lines += [
        f"# {v.name}: {_about(v)}; no matching column; name one in [data.columns], and add the signal here"
        for v in variables
        if v.name not in matched.columns
    ]
    given = f"{role} = [{', '.join(_text(v.name) for v in known)}]"
    lines.append(given if known or not variables else f"# {role} = [...]")
    left = [v for v in variables if v.name not in matched.columns]
    if role == "inputs" and left:
        values = ", ".join(f"{_key(v.name)} = {_usual(v)!r}" for v in left)
        lines.append(f"# constants = {{{values}}}  # values of inputs without a column, in the units above")
    return lines


def _usual(v: Variable) -> float:
    """Return a value for an input that was not recorded: the model's own, else that of a room."""
    return v.start or (ROOM_TEMPERATURE if v.unit == "K" else 0.0)


def _reasons(model: Model, ordered: Sequence[Variable], own: Set[str], head: str, data: Path) -> dict[str, str]:
    """Say why a parameter is not free, by name; empty for those that are."""
    tunable, reasons = [], {}
    for v in ordered:
        if own and v.name not in own:
            reasons[v.name] = "a library default that the model does not change"
            continue
        try:
            tunable += list(parameters_from_model(model, free=[v.name]))
        except InputError:
            reasons[v.name] = "no start value within its bounds"
    slopes = _slopes(model, head, data, ParameterSet(tuple(tunable))) if tunable else None
    if slopes is None:
        return reasons | {p.name: "not tested: complete [data] first" for p in tunable}
    kept = np.empty((0, slopes.shape[1]))
    for p, row in zip(tunable, slopes, strict=True):
        size = float(np.linalg.norm(row))
        left = row - (row @ kept.T) @ kept
        rest = float(np.linalg.norm(left))
        if size < MIN_OUTPUT_CHANGE * np.sqrt(row.size):
            reasons[p.name] = "the outputs do not respond to it"
        elif rest < MIN_UNIQUE_SHARE * size:
            reasons[p.name] = CONFOUNDED
        else:
            kept = np.vstack([kept, left / rest])
            reasons[p.name] = ""
    return reasons


def _slopes(model: Model, head: str, data: Path, parameters: ParameterSet) -> FloatArray | None:
    """Compute the change of outputs, over their ranges, by each parameter's change by its own size: shape (p, N).

    None if the recording does not have what the model needs, or the model cannot be simulated as it stands."""
    config = Config.model_validate(tomllib.loads(head))
    if config.data.outputs is None or (model.inputs and config.data.inputs is None):
        return None
    layout = layout_of(config, model.declared, model)
    left = {v.name: _usual(v) for v in model.inputs if v.name not in (config.data.inputs or ())}
    recordings = read_recordings([data], columns_of(config), layout=replace(layout, constants=left))
    tell_notes(recordings)
    settings = CalibrationSettings(delay="none", initial_states="estimated")
    whole = calibrate(recordings, model, parameters, settings=settings)
    calibration = replace(whole, data=whole.data.thinned(SAMPLE_COUNT))
    with open_simulator(calibration.problem()) as simulator:
        objective = Objective(calibration, simulator)
        at = calibration.parameters.to_search(calibration.parameters.start)
        run = objective.evaluate(at, range(len(parameters)))
    if run is None or run.slopes is None:
        return None
    own = [abs(p.start) or 1.0 for p in parameters] / parameters.jacobian(parameters.start)
    ranges = [float(np.ptp(s.measured)) or 1.0 for s in objective.series]
    return np.concatenate([by * own[:, None] / size for by, size in zip(run.slopes, ranges, strict=True)], axis=1)


def _parameter_lines(ordered: Sequence[Variable], reasons: dict[str, str]) -> str:
    lines = [
        "# All parameters of the model. Parameters that the outputs respond to are free, if the model's own classes",
        '# declare or set them. free = false fixes a parameter; free = "later" fixes it until an effect is added with',
        "# which the data determine it.",
        "[parameters]",
    ]
    for v in ordered:
        value = [] if v.start is None else [f"value = {float(v.start)!r}"]
        why = reasons[v.name]
        free = 'free = "later"' if why == CONFOUNDED else "free = true"
        line = f"{_key(v.name)} = {{{', '.join([free, *value])}}}  # {_about(v)}"
        lines += [f"{'' if why in ('', CONFOUNDED) else '# '}{line}{f'; {why}' if why else ''}"]
    return "\n".join(lines) + "\n"


def _about(variable: Variable) -> str:
    """Write unit and description in a comment."""
    unit = f"in {variable.unit}" if variable.unit else "no unit declared"
    return ", ".join(filter(None, (" ".join(variable.description.split()), unit)))


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)
