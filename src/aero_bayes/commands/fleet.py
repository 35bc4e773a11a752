"""Many rigs of one model: their table, and the work of fitting them one by one and summarising them on one page."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import re
import socket
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from aero_bayes.commands.commands import run_all, run_close_loop, run_fit
from aero_bayes.commands.fleet_runner import Row, read_rows, work_on
from aero_bayes.commands.fleet_summary import summarise_fleet
from aero_bayes.commands.job import RunOptions, fit_parameters, which_model
from aero_bayes.config import Config, Section, read_toml, resolve_paths, validated
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.files import write_whole
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.report.results import versions, write_json
from aero_bayes.report.schema_run import FleetJson, RunJson
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH
from aero_bayes.simulation.load_model import load_model
from aero_bayes.simulation.model import Model

Work = Literal["fit", "posterior", "loop", "all"]
#: A rig's name is also the name of its folder.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,99}")
#: Columns of a table of rigs that are no settings, and what stands between several files in one cell.
TABLE_COLUMNS, BETWEEN = ("name", "train", "test"), ";"
#: In the fleet's folder: the rigs' run directories, what each says while it runs, the table, the summary, the models.
RUNS, LOG, TABLE, FLEET_RESULT, MODELS = "rigs", "log.txt", "rigs.jsonl", "fleet.json", "models"
#: What a row is, so that rows of an older kind are computed anew.
KIND = 4
#: A rig whose likelihood has less than this share of its posterior's precision tells only its prior.
MIN_LIKELIHOOD_SHARE = 0.05


class RigSection(Section):
    """``[[rig]]``: a rig, its recordings, and in ``settings`` whatever it has otherwise than the rest of the file."""

    name: str
    train: tuple[Path, ...]
    test: tuple[Path, ...] = ()
    settings: dict[str, Any] = {}  # noqa: RUF012  (pydantic copies defaults)


class FleetSection(Section):
    """``[fleet]``: the work on each rig, and the file of the table of rigs if it is another one.

    ``work`` is one of the commands: fit, posterior, loop, or all three."""

    work: Work = "fit"
    rigs: Path | None = None


class FleetFile(Section):
    """What a fleet's file holds beside what any configuration may."""

    fleet: FleetSection = FleetSection()
    rig: tuple[RigSection, ...] = ()


@dataclass(frozen=True)
class Rig:
    """One rig.

    Parameters
    ----------
    name : str
        Unique; letters, digits and ``_ . + -``.
    train, test : tuple of Path
        Recordings to learn from, and to judge on.
    settings : mapping
        Tables of the configuration that are different for this rig, nested as in the file.

    Examples
    --------
    >>> rig = aero_bayes.Rig("cart-7", (Path("train.csv"),), settings={"parameters": {"k": {"free": True}}})
    >>> rig.seed(1) == aero_bayes.Rig("cart-7", (Path("elsewhere.csv"),)).seed(1)
    True
    """

    name: str
    train: tuple[Path, ...]
    test: tuple[Path, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise InputError(f"rig {self.name!r}: expected a name of letters, digits and _ . + - the first no sign")

    def seed(self, seed: int) -> int:
        """Derive the rig's own seed: it depends on its name, not on its place in the table or on who works on it."""
        return int.from_bytes(hashlib.sha256(f"{seed}/{self.name}".encode()).digest()[:4], "big")


@dataclass(frozen=True)
class FleetPlan:
    """Settings of all rigs with the folder that paths in them start from, the work, and the rigs."""

    shared: Mapping[str, Any]
    folder: Path
    work: Work
    rigs: Sequence[Rig]

    def config(self, rig: Rig) -> Config:
        """Merge the settings of one rig. Raises InputError if they name a key or value that does not exist."""
        document = _overlaid(self.shared, rig.settings)
        return resolve_paths(validated(Config, document, f"rig {rig.name}"), self.folder)


def read_fleet(path: Path) -> FleetPlan:
    """Read ``fleet.toml``: any configuration, with ``[fleet]`` and the rigs."""
    document = read_toml(path)
    own = validated(FleetFile, {key: document.pop(key) for key in ("fleet", "rig") if key in document}, path)
    validated(Config, document, path)
    rigs = [Rig(**dict(one)) for one in own.rig]
    if own.fleet.rigs is not None:
        rigs += _read_table(path.parent / own.fleet.rigs)
    if not rigs:
        raise InputError(f"{path}: no rigs; expected [[rig]] tables, or [fleet] rigs = a CSV file")
    return FleetPlan(document, path.parent.resolve(), own.fleet.work, rigs)


def _read_table(path: Path) -> list[Rig]:
    """Read the rigs of a CSV file. Raises InputError that names file and row."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            if missing := [c for c in TABLE_COLUMNS[:2] if c not in (reader.fieldnames or ())]:
                raise InputError(f"{path}: no column {missing[0]}; expected {', '.join(TABLE_COLUMNS)}")
            return [_rig_of_row(row, f"{path}: row {reader.line_num}") for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text") from None


def _rig_of_row(row: Mapping[str, str | None], where: str) -> Rig:
    if None in row:
        raise InputError(f"{where}: more cells than columns")
    train, test = (tuple(Path(part.strip()) for part in (row.get(c) or "").split(BETWEEN) if part.strip())
                   for c in TABLE_COLUMNS[1:])  # fmt: skip
    settings: dict[str, Any] = {}
    try:
        for key, text in row.items():
            if key not in TABLE_COLUMNS and text:
                settings = _overlaid(settings, _setting(key, text))
        return Rig((row["name"] or "").strip(), train, test, settings)
    except (InputError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{where}: {error}") from None


def _setting(key: str, text: str) -> dict[str, Any]:
    """Read a cell below a key such as ``parameters."spring.k".value`` as TOML; a word needs no quotes."""
    try:
        return tomllib.loads(f"{key} = {text}")
    except tomllib.TOMLDecodeError:
        return tomllib.loads(f"{key} = {json.dumps(text)}")


def _overlaid(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested tables, the upper ones winning key by key."""
    merged = dict(below)
    for key, value in above.items():
        nested = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _overlaid(merged[key], value) if nested else value
    return merged


@dataclass(frozen=True)
class RigTask:
    """Everything that a worker needs; the files must be readable on its machine. Of a wrong ``config`` it says why."""

    rig: Rig
    config: Config | str
    work: Work
    out: Path
    seed: int
    model: Path | None = None

    @property
    def made_of(self) -> str:
        """Fingerprint of all that its row depends on; recordings by size and time of change."""
        paths = (*self.rig.train, *self.rig.test)
        files = [(p.name, (s := p.stat()).st_size, s.st_mtime_ns) if p.exists() else p.name for p in paths]
        config = self.config if isinstance(self.config, str) else self.config.model_dump_json(exclude={"model"})
        facts = (KIND, config, self.work, self.seed, self.model.stem if self.model is not None else "", files)
        return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def attempt(task: RigTask) -> Row:
    """Work on a rig; one that cannot be fitted is a row with its reason.

    The rig's own core is the only one that it uses. Its simulations run in a process of their own that can be killed.
    """
    try:
        row = _fitted(task)
    except (InputError, CannotFinishError) as error:
        reason = error.configured if isinstance(error, InputError) else str(error)
        row = {"error": " ".join(reason.split())}
    return {"key": task.rig.name, **row, "worker": f"{socket.gethostname()}/{os.getpid()}"}


def _fitted(task: RigTask) -> Row:
    rig, config, folder, fmu = task.rig, task.config, task.out / RUNS / task.rig.name, task.model
    if isinstance(config, str) or fmu is None:
        raise InputError(str(config))
    if hashlib.sha256(fmu.read_bytes()).hexdigest() != fmu.stem:
        raise InputError(f"{fmu}: has changed since the fleet was started")
    built: Path | None = fmu
    if config.model.fmu is not None:
        config, built = config.model_copy(update={"model": config.model.model_copy(update={"fmu": fmu})}), None
    # Rigs of one model share the extended models that their loops export.
    cache = fmu.parent / "loop"
    options = RunOptions(folder, config=config, seed=task.seed, workers=1, quiet=True, built=built, cache=cache)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOG).open("w", encoding="utf-8") as log, redirect_stdout(log), redirect_stderr(log):
        if task.work in ("fit", "posterior"):
            result = run_fit(rig.train, replace(options, posterior=task.work == "posterior"))
        else:
            result = (run_close_loop if task.work == "loop" else run_all)(rig.train, rig.test, options)
    return _row(result, {item.name: item for item in fit_parameters(Model.load(fmu), config)})


def _row(result: RunJson, searched: Mapping[str, Parameter]) -> Row:
    """Make the row of a finished rig: the numbers of its ``result.json`` that the fleet needs."""
    loop, words = result.loop, result.effect_words()
    effects = loop.effects if loop else []
    equivalent = loop.equivalent if loop else []
    wanted = {*searched, *(key for effect in effects for key in effect.parameters)}
    ratios = [one.ratio for outputs in result.residual.values() for one in outputs.values() if math.isfinite(one.ratio)]
    return {
        "simulated": result.simulated,
        "parameters": {
            key: _parameter(entry, searched.get(key))
            for key, entry in sorted(result.parameters.items())
            if key in wanted and entry.status != "fixed" and math.isfinite(entry.value)
        },
        "over_floor": max(ratios, default=None),
        "outcome": loop.outcome if loop else "",
        # each with those that its data cannot tell from it
        "effects": [
            {"id": e.id, "summary": words.get(e.id, ""),
             "alike": [i for i in next((group for group in equivalent if e.id in group), []) if i != e.id]}
            for e in effects
        ],
    }  # fmt: skip


def _parameter(entry: Estimate, item: Parameter | None) -> dict[str, Any]:
    """Return value and unit, and centre and width of the likelihood where the rig determines the parameter.

    The likelihood is a Gaussian posterior over the prior's own curvature: the fleet takes the place of the rig's prior;
    with both it would be counted once a rig."""
    stated: dict[str, Any] = {"value": entry.value, "unit": entry.unit}
    low, middle, high = entry.q05, entry.q50, entry.q95
    if low is None or middle is None or high is None or not high > low:
        return stated
    floor = item.lower if item is not None else entry.lower
    log = low > 0.0 and floor is not None and floor >= 0.0
    if log:
        low, middle, high = math.log(low), math.log(middle), math.log(high)
    sd = (high - low) / (2.0 * NORMAL_HALF_WIDTH)
    if item is not None:
        value = min(max(math.exp(middle) if log else middle, item.lower), item.upper)
        slope, bend = (float(derivative[0]) for derivative in item.prior.derivatives(np.array([value])))
        if log:
            slope, bend = slope * value + 1.0, bend * value**2 + slope * value
        precision = 1.0 / sd**2 + bend
        if precision < MIN_LIKELIHOOD_SHARE / sd**2:
            return stated
        middle, sd = middle - slope / precision, precision**-0.5
    return stated | {"log": log, "centre": middle, "width": sd}


def fleet(
    rigs: Iterable[Rig] | Path | str,
    out: Path | str,
    *,
    settings: dict[str, Any] | None = None,
    work: Work = "fit",
    seed: int = 1,
    client: Any = None,
    workers: int | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> FleetJson:
    """Fit many rigs and summarise them.

    Parameters
    ----------
    rigs : iterable of Rig, or path
        The rigs, or a ``fleet.toml`` that says what follows.
    out : path
        Folder for ``rigs/NAME/``, ``rigs.jsonl``, ``fleet.json`` and ``report.html``; rows that are there are kept.
    settings : dict, optional
        The configuration for all rigs, nested as in the TOML file; paths in it from the present folder.
    work : {"fit", "posterior", "loop", "all"}
    seed : int
        Every rig draws its own from this and its name.
    client : distributed.Client, optional
        Its workers fit the rigs, one at a time each; they must see recordings and ``out`` under the same paths. Without
        it processes of this machine do.
    workers : int, optional
        How many of these; by default one for each core.
    progress : callable, optional
        Told how many rigs are done, one or more at a time.

    Returns
    -------
    FleetJson

    Raises
    ------
    InputError
        The fleet's file or table is wrong, two rigs have one name, or the model cannot be built; where one rig cannot
        be fitted, its row says why.

    Examples
    --------
    >>> rigs = [Rig(f"A{k:02}", (Path(f"A{k:02}.csv"),)) for k in range(20)]  # doctest: +SKIP
    >>> fleet(rigs, "out", settings={"model": {"name": "Aero.Systems.HalfQuad"}}).parameters  # doctest: +SKIP
    """
    if isinstance(rigs, Path | str):
        plan = read_fleet(Path(rigs))
    else:
        plan = FleetPlan(settings or {}, Path.cwd(), work, tuple(rigs))
    folder = Path(out).resolve()
    tasks = tasks_of(plan, folder, seed)
    first = list(islice(tasks, 1))  # what is wrong with all rigs shows before anything is written
    table, made_of = folder / TABLE, dict[str, str]()
    known = {key: row.get("made_of") for key, row in read_rows(table).items() if "seconds" in row}  # no worker died

    def wanted() -> Iterator[tuple[str, RigTask]]:
        for task in chain(first, tasks):
            made_of[task.rig.name] = task.made_of
            if known.get(task.rig.name) == task.made_of:
                progress(1)
            else:
                yield task.rig.name, task

    rows = work_on(wanted(), attempt, table, lambda key: {"made_of": made_of[key]}, client=client, workers=workers)
    for _ in rows:
        progress(1)
    made = read_rows(table)
    result, found = summarise_fleet([made[k] for k in sorted(made_of)], work=plan.work, seed=seed, versions=versions())
    write_json(folder / FLEET_RESULT, result.model_dump(by_alias=True))
    write_fleet_page(folder, result, found)
    return result


def tasks_of(plan: FleetPlan, out: Path, seed: int) -> Iterator[RigTask]:
    """Make a task for each rig when its turn comes; every model is built once."""
    for name, times in Counter(rig.name for rig in plan.rigs).items():
        if times > 1:
            raise InputError(f"two rigs are called {name}")
    models: dict[str, Path] = {}
    for number, rig in enumerate(plan.rigs):
        train, test = (tuple((plan.folder / path).resolve() for path in paths) for paths in (rig.train, rig.test))
        task = RigTask(Rig(rig.name, train, test), "", plan.work, out, rig.seed(seed))
        try:
            config = plan.config(rig)
            of_model = config.model.model_dump_json()
            if of_model not in models:
                models[of_model] = _model(config, out)
        except InputError as error:
            if not number:
                raise
            yield replace(task, config=str(error))
        else:
            yield replace(task, config=config, model=models[of_model])


def _model(config: Config, out: Path) -> Path:
    """Build or read the FMU of a configuration; it is kept under its hash where all workers find it."""
    name, fmu = which_model(config, RunOptions(out))
    model = load_model(fmu or name, sources=config.model.sources, libraries=config.model.libraries)
    kept = out / MODELS / f"{model.sha256}.fmu"
    kept.parent.mkdir(parents=True, exist_ok=True)
    if not kept.exists():
        write_whole(kept, model.path.read_bytes())
    return kept
