"""Many rigs of one model: each is fitted on its own, then what they share is said on one page."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

from aero_bayes.config import Config, ModelSection
from aero_bayes.errors import InputError
from aero_bayes.files import whole_file
from aero_bayes.fleet.executors import open_executor
from aero_bayes.fleet.parcels import Parcel
from aero_bayes.fleet.rigs import FleetPlan, Rig, Work, read_fleet
from aero_bayes.fleet.runner import Progress, failure, run_all
from aero_bayes.fleet.summary import summarise
from aero_bayes.fleet.table import Row, Table
from aero_bayes.fleet.task import RigTask, attempt
from aero_bayes.library import load_model
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.schema import FleetResult
from aero_bayes.workflow.job import RunOptions, which_model
from aero_bayes.workflow.results import versions

TABLE, RESULT, MODELS = "rigs.sqlite", "fleet.json", "models"


def fleet(
    rigs: Iterable[Rig] | Path | str,
    out: Path | str,
    *,
    settings: dict[str, Any] | None = None,
    work: Work = "fit",
    seed: int = 1,
    executor: Executor | None = None,
    progress: Progress = lambda count: None,
) -> FleetResult:
    """Fit many rigs, and say what they share.

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


def _run(plan: FleetPlan, out: Path, seed: int, executor: Executor, progress: Progress) -> FleetResult:
    names: set[str] = set()
    tasks = _Tasks(plan, out, seed, names)
    with Table(out / TABLE) as table:
        run_all(tasks, _attempt, table, executor, made_of=lambda task: task.made_of, progress=progress)
        table.keep_only(names)
        result, columns = summarise(table, work=plan.work, seed=seed, versions=versions())
    with whole_file(out / RESULT) as temporary:
        text = json.dumps(result.model_dump(by_alias=True), indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", "utf-8")
    write_fleet_page(out, result, columns)
    return result


class _Tasks:
    """A task for each rig, made when its turn comes; every model is built once."""

    def __init__(self, plan: FleetPlan, out: Path, seed: int, names: set[str]) -> None:
        self._plan, self._out, self._seed, self._names = plan, out, seed, names
        self._models: dict[ModelSection, Parcel] = {}

    def __iter__(self) -> Iterator[RigTask | _Wrong]:
        for rig in self._plan.rigs:
            if rig.name in self._names:
                raise InputError(f"two rigs are called {rig.name}")
            self._names.add(rig.name)
            try:
                config = self._plan.config(rig)
                model = self._model(config)
            except InputError as error:
                if len(self._names) == 1:  # what is wrong with the first rig is wrong with all
                    raise
                yield _Wrong(rig.name, str(error))
                continue
            own = replace(rig, train=_absolute(rig.train), test=_absolute(rig.test), settings={})
            yield RigTask(own, config, self._plan.work, self._out, rig.seed(self._seed), model)

    def _model(self, config: Config) -> Parcel:
        """The FMU of a configuration, kept under its hash where all workers find it."""
        if config.model not in self._models:
            name, fmu = which_model(config, RunOptions(self._out))
            folder = self._out / MODELS
            folder.mkdir(parents=True, exist_ok=True)
            model = load_model(fmu or name, sources=config.model.sources, libraries=config.model.libraries)
            built, sha256 = model.path, model.sha256
            kept = folder / f"{sha256}.fmu"
            if not kept.exists():
                with whole_file(kept) as temporary:
                    shutil.copyfile(built, temporary)
            self._models[config.model] = Parcel(kept, sha256)
        return self._models[config.model]


class _Wrong:
    """A rig whose settings make no task."""

    def __init__(self, key: str, reason: str) -> None:
        self.key, self.reason = key, reason

    @property
    def made_of(self) -> str:
        return self.reason


def _attempt(task: RigTask | _Wrong) -> Row:
    return failure(task.key, task.reason) if isinstance(task, _Wrong) else attempt(task)


def _absolute(paths: Iterable[Path]) -> tuple[Path, ...]:
    return tuple(path.resolve() for path in paths)
