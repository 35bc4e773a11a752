"""Fit many rigs of one model one by one, then summarise them on one page."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

from aero_bayes.config import Config
from aero_bayes.errors import InputError
from aero_bayes.files import whole_file
from aero_bayes.fleets.executors import open_executor
from aero_bayes.fleets.rigs import FleetPlan, Rig, Work, read_fleet
from aero_bayes.fleets.runner import Progress, Table, run_tasks
from aero_bayes.fleets.summary import summarise_fleet
from aero_bayes.fleets.task import RigTask, attempt
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
        The rigs, or a ``fleet.toml`` that says what follows.
    out : path
        Folder for ``rigs/NAME/``, ``rigs.sqlite``, ``fleet.json`` and ``report.html``; rows that are there are kept.
    settings : dict, optional
        The configuration for all rigs, nested as in the TOML file; paths in it from the present folder.
    work : {"fit", "posterior", "loop", "all"}
    seed : int
        Every rig draws its own from this and its name.
    executor : concurrent.futures.Executor, optional
        Works on rigs, one task each, such as ``distributed.Client.get_executor()``; all cores by default. Workers must
        see recordings and ``out`` under the same paths.
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
    if executor is None:
        with open_executor() as pool:
            return fleet(rigs, out, settings=settings, work=work, seed=seed, executor=pool, progress=progress)
    if isinstance(rigs, Path | str):
        plan = read_fleet(Path(rigs))
    else:
        plan = FleetPlan(settings or {}, Path.cwd(), work, tuple(rigs))
    folder = Path(out).resolve()
    tasks = tasks_of(plan, folder, seed)
    first = list(islice(tasks, 1))  # what is wrong with all rigs shows before anything is written
    with Table(folder / TABLE) as table:
        run_tasks(chain(first, tasks), attempt, table, executor, progress)
        table.keep_only({rig.name for rig in plan.rigs})
        result, rows = summarise_fleet(table, work=plan.work, seed=seed, versions=versions())
    with whole_file(folder / FLEET_RESULT) as temporary:
        text = json.dumps(result.model_dump(by_alias=True), indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", "utf-8")
    write_fleet_page(folder, result, rows)
    return result


def tasks_of(plan: FleetPlan, out: Path, seed: int) -> Iterator[RigTask]:
    """Make a task for each rig when its turn comes; every model is built once."""
    for name, times in Counter(rig.name for rig in plan.rigs).items():
        if times > 1:
            raise InputError(f"two rigs are called {name}")
    models: dict[str, Path] = {}
    for number, rig in enumerate(plan.rigs):
        train, test = (tuple(path.resolve() for path in paths) for paths in (rig.train, rig.test))
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
        with whole_file(kept) as temporary:
            shutil.copyfile(model.path, temporary)
    return kept
