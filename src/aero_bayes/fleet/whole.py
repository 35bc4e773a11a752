"""Fit many rigs of one model one by one, then summarise them on one page."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from aero_bayes.config import Config, ModelSection
from aero_bayes.errors import InputError
from aero_bayes.files import whole_file
from aero_bayes.fleet.executors import open_executor
from aero_bayes.fleet.parcels import Parcel
from aero_bayes.fleet.rigs import FleetPlan, Rig, Work, read_fleet
from aero_bayes.fleet.runner import Progress, failure, run_tasks
from aero_bayes.fleet.summary import summarise_fleet
from aero_bayes.fleet.table import Row, Table
from aero_bayes.fleet.task import RigTask, attempt
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.schema import FleetJson
from aero_bayes.simulation.load_model import load_model
from aero_bayes.workflow.job import RunOptions, which_model
from aero_bayes.workflow.results import versions

TABLE, FLEET_RESULT, MODELS = "rigs.sqlite", "fleet.json", "models"


def fleet(
    rigs: Iterable[Rig] | Path | str,
    out: Path | str,
    *,
    settings: dict[str, Any] | None = None,
    work: Work = "fit",
    seed: int = 1,
    executor: Executor | None = None,
    progress: Progress = lambda count: None,
) -> FleetJson:
    """Fit many rigs and summarise them.

    Parameters
    ----------
    rigs : iterable of Rig, or path
        The rigs, or a ``fleet.toml`` that says all of what follows.
    out : path
        Where everything is written: ``rigs/NAME/`` for each rig, ``rigs.sqlite``, ``fleet.json``, ``report.html``. Rows
        that are there already are kept, so that a run that was stopped goes on where it was.
    settings : dict, optional
        The configuration for all rigs, nested as in the TOML file; paths in it from the present folder.
    work : {"fit", "posterior", "loop", "all"}
    seed : int
        Every rig draws its own from this and its name.
    executor : concurrent.futures.Executor, optional
        Where rigs are worked on, one task each, such as ``distributed.Client.get_executor()``; all cores of this
        machine by default. Workers must see recordings and ``out`` under the same paths.
    progress : callable, optional
        Told how many rigs are done, one or more at a time.

    Raises
    ------
    InputError
        The fleet's file or table is wrong, two rigs have one name, or the model cannot be built. A rig that cannot be
        fitted is no error but a row that says why.

    Examples
    --------
    >>> rigs = [Rig(f"A{k:02}", (Path(f"A{k:02}.csv"),)) for k in range(20)]  # doctest: +SKIP
    >>> found = fleet(rigs, "out", settings={"model": {"name": "Aero.Systems.HalfQuad"}})  # doctest: +SKIP
    >>> found.parameters["R_a"].spread.q50  # doctest: +SKIP
    """
    plan = read_fleet(Path(rigs)) if isinstance(rigs, Path | str) else FleetPlan(settings or {}, Path(), work, rigs)
    target = Path(out).resolve()
    if executor is None:
        with open_executor() as own:
            return _run(plan, target, seed, own, progress)
    return _run(plan, target, seed, executor, progress)


def _run(plan: FleetPlan, out: Path, seed: int, executor: Executor, progress: Progress) -> FleetJson:
    names: set[str] = set()
    tasks = tasks_of(plan, out, seed, names)
    first = next(tasks, None)  # what is wrong with all rigs shows before anything is written
    with Table(out / TABLE) as table:
        started = chain([first] if first is not None else [], tasks)
        run_tasks(started, _attempt, table, executor, made_of=lambda task: task.made_of, progress=progress)
        table.keep_only(names)
        result, columns = summarise_fleet(table, work=plan.work, seed=seed, versions=versions())
    with whole_file(out / FLEET_RESULT) as temporary:
        text = json.dumps(result.model_dump(by_alias=True), indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", "utf-8")
    write_fleet_page(out, result, columns)
    return result


def tasks_of(plan: FleetPlan, out: Path, seed: int, names: set[str] | None = None) -> Iterator[RigTask | Wrong]:
    """A task for each rig, made when its turn comes; every model is built once.

    Raises
    ------
    InputError
        Two rigs have one name, which ``names`` collects; or settings or model of the first rig are wrong, as then
        all are.
    """
    names = set() if names is None else names
    models: dict[ModelSection, Parcel] = {}
    for rig in plan.rigs:
        if rig.name in names:
            raise InputError(f"two rigs are called {rig.name}")
        names.add(rig.name)
        try:
            config = plan.config(rig)
            if config.model not in models:
                models[config.model] = _model(config, out)
        except InputError as error:
            if len(names) == 1:
                raise
            yield Wrong(rig.name, str(error))
            continue
        train, test = (tuple(path.resolve() for path in paths) for paths in (rig.train, rig.test))
        own = Rig(rig.name, train, test)
        yield RigTask(own, config, plan.work, out, rig.seed(seed), models[config.model])


def _model(config: Config, out: Path) -> Parcel:
    """The FMU of a configuration, kept under its hash where all workers find it."""
    name, fmu = which_model(config, RunOptions(out))
    model = load_model(fmu or name, sources=config.model.sources, libraries=config.model.libraries)
    kept = out / MODELS / f"{model.sha256}.fmu"
    kept.parent.mkdir(parents=True, exist_ok=True)
    if not kept.exists():
        with whole_file(kept) as temporary:
            shutil.copyfile(model.path, temporary)
    return Parcel(kept, model.sha256)


@dataclass(frozen=True)
class Wrong:
    """A rig whose settings make no task, and why."""

    key: str
    made_of: str


def _attempt(task: RigTask | Wrong) -> Row:
    return failure(task.key, task.made_of) if isinstance(task, Wrong) else attempt(task)
