"""MkDocs hook: fills ``<!-- generate: NAME -->`` in a page with tables written from the code itself.

A key of the configuration that nothing explains is a warning, which ``mkdocs build --strict`` makes an error.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import inspect
import logging
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import click
import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from aero_bayes import cli, declared
from aero_bayes.commands.fleet import FleetFile
from aero_bayes.config import Config
from aero_bayes.data.columns import ColumnMap
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.laws.law import shipped_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.first_fit import LoopSettings
from aero_bayes.plain import Number, Numbers, Rows
from aero_bayes.report.schema_run import FleetJson, RunJson

if typing.TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parent))
from bad_fit_pictures import pictures
from docstrings import Docstring
from library_entries import library

log = logging.getLogger("mkdocs.hooks.reference")
ROOT = Path(__file__).parents[1]
MARK = re.compile(r"<!-- generate: (\w+) -->")

#: Settings whose docstring says what the keys of a section mean.
SETTINGS = {
    "loop": LoopSettings, "posterior": SampleSettings, "fit": FitSettings, "fit.local": FitSettings,
    "data.columns.NAME": ColumnMap,
}  # fmt: skip
#: What each other key of the configuration means, with its unit; a ``description`` in the schema goes before.
KEYS: Mapping[str, str] = {
    "model.name": "Modelica class, such as `Rig` or `Aero.Systems.HalfQuad`",
    "model.fmu": "path of an FMU, in place of a class",
    "model.units": 'units of an FMU\'s signals that its description does not give, such as `{F = "N", v = "m/s"}`',
    "model.sources": "`.mo` files or package folders that the class, and laws of your own, stand in",
    "model.libraries": "folders that hold packages which the sources use",
    "data.inputs": "inputs of the model that are recorded; left out: all that it declares",
    "data.outputs": "outputs of the model that are recorded; left out: all that it declares",
    "data.interpolation": "between samples every input holds, or runs in straight lines; `auto`: the fit decides for "
    "each that moves from sample to sample; `{T_amb = 'linear'}`: by name, the others hold. Left out: what the package "
    "declares (the AERO: `hold`), else `auto`",
    "data.constants": "inputs without a column, and the value that each has throughout, in the model's unit: "
    "`{T_amb = 293.15}`",
    "data.batch": "column of a table that says which run a row is of; each run is a recording",
    "data.columns.NAME.source": "column of the CSV file, or variable of the `.mat` file; left out: NAME",
    "data.columns.NAME.unit": "unit in the file (s, ms, us, V, mV, A, mA, rad, mrad, deg, rev, rad/s, deg/s, rev/s, "
    "rpm, count, count/s); left out: SI",
    "parameters.NAME.free": "fitted, held, or `auto`: freed only if the data show it",
    "parameters.NAME.value": "start of the search; value of a parameter that is held (SI); "
    "`{light = 1.0, heavy = 2.5}`: known values by recording",
    "parameters.NAME.per_recording": "fit a value of its own for each recording, which results call `NAME@recording`",
    "parameters.NAME.values": "`[1, 2, 3]`, `[true, false]` or names of enumeration literals: each is fitted, the "
    "likeliest is reported; for parameters that no search can move, and Real ones (`fit`, `posterior`)",
    "parameters.NAME.lower": "lower bound (SI)",
    "parameters.NAME.upper": "upper bound (SI)",
    "parameters.NAME.prior.kind": "shape of the density; truncated to the bounds",
    "parameters.NAME.prior.mean": "of a normal prior (SI)",
    "parameters.NAME.prior.sd": "of a normal prior (SI)",
    "parameters.NAME.prior.median": "of a log-normal prior (SI)",
    "parameters.NAME.prior.relative_sd": "of a log-normal prior, as a share of the median",
    "parameters.NAME.prior.lower": "of a uniform or log-uniform prior (SI)",
    "parameters.NAME.prior.upper": "of a uniform or log-uniform prior (SI)",
    "fit.initial_states": "where states start: held at the first reading, estimated, or whichever suits the model",
    "fit.max_input_delay": "largest delay of the inputs that is searched, in s: one number for all of them together, "
    "anew in each recording, or `{heater = 1200}` for a dead time of single ones; below zero: by how much they may act "
    "before they are logged; left out: what the package declares (the AERO: 0.02), else none",
    "priors_from": "`posterior.nc` of an earlier experiment, whose draws are the prior of this one",
    "fit.stages[].parameters": "parameters of this stage",
    "fit.stages[].outputs": "outputs of this stage",
    "fit.pso.particles": "particles of the swarm",
    "fit.pso.iterations": "most iterations of the swarm",
    "fit.pso.tolerance": "progress of the cost at which the swarm stops",
    "fit.local.iterations": "most iterations of the local search",
    "fit.local.tolerance": "predicted decrease of the cost at which it has converged (log-posterior: nats)",
    "noise.process": "diffusion by state, in the state's unit over the square root of a second, or `estimated`; the "
    "noise of the readings is then white, and estimated beside it. In `close-loop`: the states that it may drive where "
    "laws leave something, all `estimated`; left out: every state",
    "noise.NAME.kind": "of the output NAME: `relative` has the standard deviation a + b times the reading, `student` "
    "has heavy tails, `rounded` is white and at least as large as the rounding; left out: what predicts left-out "
    "readings best",
    "noise.NAME.sd": "standard deviation of white noise of the output NAME, in its unit: a number, or one by recording "
    "as `{a = 0.02, b = 0.4}`; it is then not estimated",
    "noise.initial_sd": "with process noise, how far a state's initial value may be off the model's own (standard "
    "deviation)",
    "prediction.max_seconds": "most time, in s; 0 leaves it out",
    "solver.engine": "simulator: the compiled engine; no other is left",
    "solver.relative_tolerance": "of the integration",
    "solver.absolute_tolerance": "of the integration, over a state's nominal value",
    "solver.time_limit": "of computing, for one simulation, in s",
    "fleet.work": "what `aero-bayes fleet` does with each rig",
    "fleet.rigs": "CSV file with the columns name, train, test, and one for each key that differs",
    "rig[].name": "the rig's name, which its folder gets too",
    "rig[].train": "recordings to learn from",
    "rig[].test": "recordings to judge on",
    "rig[].settings": "tables of this file that are different for the rig",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the picture of the README, which stands in ``reports/``, and the drawn ones."""
    from mkdocs.structure.files import File  # the tables can be written without it

    files.append(File.generated(config, "loop.svg", abs_src_path=str(ROOT / "reports" / "example" / "loop.svg")))
    for name, picture in pictures().items():
        files.append(File.generated(config, f"bad_fit/{name}.svg", content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put what the code says in place of the marks."""
    return MARK.sub(lambda found: GENERATORS[found[1]](), markdown)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Warn of a page that asks the network: it is read from disk."""
    for tag in re.findall(r"<(?:script|img|iframe|link)\b[^>]*https?://[^>]*>", output):
        log.warning("%s asks the network: %s", page.file.src_uri, tag)
    return output


def _table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]] | list[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


# The TOML file ------------------------------------------------------------------------------------------------------


def configuration() -> str:
    """Return a table a section, in the order of the schema."""
    return "\n\n".join([*_section(Config, ""), *_section(FleetFile, "")])


def _section(section: type[BaseModel], path: str) -> Iterator[str]:
    below, rows = [], []
    for name, field in section.model_fields.items():
        inner, many = _inner(field.annotation)
        if inner is not None:
            below.append((inner, f"{path}.{name}".lstrip(".") + {"dict": ".NAME", "list": "[]", "": ""}[many]))
        else:
            rows.append((f"`{name}`", _type(field.annotation), _default(field),
                         _meaning(f"{path}.{name}".lstrip("."), field)))  # fmt: skip
    if "__pydantic_extra__" in section.__annotations__:  # a table of any other name
        inner, _ = _inner(typing.get_type_hints(section)["__pydantic_extra__"])
        assert inner is not None
        below.append((inner, f"{path}.NAME"))
    if rows:
        title = f"`[[{path[:-2]}]]`" if path.endswith("[]") else f"`[{path}]`" if path else "Above all tables"
        yield f"## {title}\n\n" + _table(("key", "value", "default", "meaning"), rows)
    for inner, place in below:
        yield from _section(inner, place)


def _meaning(key: str, field: FieldInfo) -> str:
    section, _, name = key.rpartition(".")
    entries = Docstring.of(SETTINGS[section]).entries("Parameters") if section in SETTINGS else []
    own = (" ".join(text.split()) for names, _, text in entries if name in names)
    text = field.description or KEYS.get(key) or next(own, "")
    if not text:
        log.warning("the key %s of the configuration is explained nowhere", key)
    return text


def _inner(annotation: object) -> tuple[type[BaseModel] | None, str]:
    """Return the section that a key holds, and whether by name, in a list, or once."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, ""
    origin = typing.get_origin(annotation)
    for argument in typing.get_args(annotation):
        found, many = _inner(argument)
        if found is not None:
            return found, {dict: "dict", tuple: "list", list: "list"}.get(typing.cast(type, origin), many)
    return None, ""


def _type(annotation: object) -> str:
    """Return an annotation as a person would write it in a TOML file."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _type(arguments[0])
    if origin is typing.Literal:
        return " or ".join(f'`"{value}"`' if isinstance(value, str) else f"`{value}`" for value in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_type(a) for a in arguments if a is not type(None))
    if origin in (tuple, list):
        return f"list of {_type(arguments[0])}"
    if origin in (dict, collections.abc.Mapping):
        return f"{_type(arguments[1])} by name"
    words = {bool: "true or false", int: "whole number", float: "number", str: "text", Path: "path"}
    return words.get(typing.cast(type, annotation), getattr(annotation, "__name__", str(annotation)))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None:
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, dict):
        return ""
    if isinstance(value, tuple):
        return "`[]`" if not value else f"`{list(value)}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


# result.json --------------------------------------------------------------------------------------------------------


def result() -> str:
    """Return a table a class of the schema, the whole first; types link to their tables."""
    parts: list[type] = [RunJson, FleetJson]
    for part in parts:
        for _, annotation, _ in _keys(part):
            parts += [p for p in _parts(annotation) if p not in parts]
    return "\n\n".join(_part(part) for part in parts)


def _keys(part: type) -> list[tuple[str, object, str]]:
    """Return the keys of a table of the result, what each holds, and its default."""
    hints = typing.get_type_hints(part, include_extras=True)
    if issubclass(part, BaseModel):
        return [(f.alias or name, hints[name], _result_default(_value(f))) for name, f in part.model_fields.items()]
    told = (f for f in dataclasses.fields(part) if "internal" not in f.metadata)
    return [(f.name, hints[f.name], _result_default(_value(f))) for f in told]


def _part(part: type) -> str:
    rows = [(f"`{name}`", _linked(annotation), default) for name, annotation, default in _keys(part)]
    text = Docstring.of(part).text.replace("``", "`")
    return f"## {part.__name__}\n\n{text}\n\n" + _table(("key", "holds", "default"), rows)


def _parts(annotation: object) -> list[type]:
    if isinstance(annotation, type) and (issubclass(annotation, BaseModel) or dataclasses.is_dataclass(annotation)):
        return [annotation]
    return [part for argument in typing.get_args(annotation) for part in _parts(argument)]


def _linked(annotation: object) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if isinstance(annotation, type) and _parts(annotation):
        return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
    if annotation == Number:
        return "number or null"
    if annotation == Numbers:
        return "list of number or null"
    if typing.get_origin(annotation) is typing.Annotated and annotation == Rows[_parts(annotation)[0]]:  # type: ignore[misc]
        return _linked(_parts(annotation)[0]) + " by name"
    if origin is typing.Annotated:
        return _linked(arguments[0])
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(f'`"{member.value}"`' for member in annotation)
    if origin in (typing.Union, types.UnionType):
        return " or ".join("null" if a is type(None) else _linked(a) for a in arguments)
    if origin in (list, tuple):
        return "list of " + _linked(arguments[0])
    if origin in (dict, collections.abc.Mapping):
        return _linked(arguments[1]) + " by name"
    return _type(annotation) if origin or annotation in (bool, int, float, str) else "any JSON"


def _value(field: FieldInfo | dataclasses.Field[Any]) -> object:
    """Return the default of a field; MISSING where it has none."""
    if isinstance(field, FieldInfo):
        return dataclasses.MISSING if field.is_required() else field.get_default(call_default_factory=True)
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _result_default(value: object) -> str:
    if value is dataclasses.MISSING:
        return "always there"
    if isinstance(value, BaseModel):
        return ""
    if isinstance(value, list | dict | tuple | np.ndarray):
        return "empty"
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


# Command line, laws, library ----------------------------------------------------------------------------------------


def command_line() -> str:
    """Return what ``--help`` says, command by command."""
    top = click.Context(cli.main, info_name="aero-bayes", max_content_width=100, terminal_width=100)
    pages = [f"```text\n{cli.main.get_help(top)}\n```"]
    for name in cli.main.list_commands(top):
        command = cli.main.commands[name]
        context = click.Context(command, info_name=name, parent=top, max_content_width=100, terminal_width=100)
        pages.append(f"## {name}\n\n```text\n{command.get_help(context)}\n```")
    return "\n\n".join(pages)


def laws() -> str:
    """Return the shipped laws by kind of port."""
    rows = [
        (f"`{law.id}`", law.kind, law.description, ", ".join(f"`{p.name}`" for p in law.parameters),
         f"`{law.refines}`" if law.refines else "")
        for law in sorted(shipped_laws(), key=lambda law: law.kind)
    ]  # fmt: skip
    return _table(("law", "acts at", "what it is", "parameters, the switch first", "finer law of"), rows)


def effects() -> str:
    """Return the AERO's effects and the curves that are learned there."""
    places = LawPlaces("Aero.Systems.OneDof")
    rows = [
        (
            f"`{c.id}`",
            places.place_name(c),
            places.describe(c),
            ", ".join(f"`{p.name}`" for p in c.law.parameters),
        )
        for c in places.candidates
    ]
    return _table(("effect", "port", "what it is", "parameters"), rows)


def declaration() -> str:
    """Return the tables of ``package.toml``, the whole first."""
    parts: list[type] = [declared.PackageDeclaration]
    for part in parts:
        for hint in typing.get_type_hints(part).values():
            parts += [p for p in _tables(hint) if p not in parts]
    return "\n\n".join(_declared(part) for part in parts)


def _tables(annotation: object) -> list[type]:
    if dataclasses.is_dataclass(annotation):
        return [typing.cast(type, annotation)]
    return [part for argument in typing.get_args(annotation) for part in _tables(argument)]


def _declared(part: type) -> str:
    hints = typing.get_type_hints(part)
    rows = [(f"`{f.name}`", _holds(hints[f.name])) for f in dataclasses.fields(part)]
    return f"## {part.__name__}\n\n```text\n{inspect.cleandoc(part.__doc__ or '')}\n```\n\n" + _table(
        ("key", "holds"), rows
    )


def _holds(annotation: object) -> str:
    arguments = typing.get_args(annotation)
    if dataclasses.is_dataclass(annotation):
        name = typing.cast(type, annotation).__name__
        return f"[{name}](#{name.lower()})"
    if typing.get_origin(annotation) is collections.abc.Mapping:
        return _holds(arguments[1]) + " by name"
    if typing.get_origin(annotation) is tuple:
        return "list of " + _holds(arguments[0])
    return _type(annotation)


GENERATORS: Mapping[str, Callable[[], str]] = {
    f.__name__: f for f in (configuration, result, command_line, laws, effects, declaration, library)
}
