"""Fit many rigs of one model one by one, then summarise them on one page."""

from __future__ import annotations

import contextlib
import hashlib
import math
import multiprocessing
import os
import queue
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from logging import ERROR
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from aero_bayes.commands.commands import run_all, run_close_loop, run_fit
from aero_bayes.commands.fleet_rigs import FleetPlan, Rig, Work, read_fleet
from aero_bayes.commands.fleet_runner import Progress, Row, Table, failure, run_tasks
from aero_bayes.commands.fleet_summary import summarise_fleet
from aero_bayes.commands.job import RunOptions, fit_parameters, which_model
from aero_bayes.config import Config
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.files import write_whole
from aero_bayes.report.fleet_page import write_fleet_page
from aero_bayes.report.results import versions, write_json
from aero_bayes.report.schema_estimate import ParameterJson
from aero_bayes.report.schema_run import EffectJson, FleetJson, LoopJson, RunJson
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH
from aero_bayes.simulation.load_model import load_model
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.worker_main import watch_parent

P = ParamSpec("P")
T = TypeVar("T")
#: Tasks after which a process of this machine is replaced, so that what leaks cannot grow.
TASKS_PER_PROCESS = 50
#: How long a scheduler is looked for, in s.
CONNECT_TIMEOUT = 20.0
#: One core is what one task gets: BLAS threads would fight the other tasks.
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class LocalPool(Executor):
    """Processes of this machine, each a pool of its own: one that dies takes no other task with it."""

    def __init__(self, workers: int) -> None:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        self._threads = ThreadPoolExecutor(workers)
        self._free: queue.SimpleQueue[ProcessPoolExecutor] = queue.SimpleQueue()
        for _ in range(workers):
            self._free.put(_process())

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a function in the next process that is free."""
        return self._threads.submit(self._in_process, partial(fn, *args, **kwargs))

    def _in_process(self, work: Callable[[], T]) -> T:
        process = self._free.get()
        try:
            return process.submit(work).result()
        except BrokenProcessPool:
            process = _process()
            raise
        finally:
            self._free.put(process)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes once their tasks have ended."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        while not self._free.empty():
            self._free.get().shutdown(wait)

    def kill(self) -> None:
        """End the processes in the middle of their tasks."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()


def _process() -> ProcessPoolExecutor:
    """Make a pool of one process, which starts with its first task."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, _begin, (os.getpid(),), max_tasks_per_child=TASKS_PER_PROCESS)


def _begin(parent: int) -> None:
    """Have a new process of the pool end when the parent does, however that ends."""
    # What Ctrl-C sends reaches every process; only the parent has something to say about it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=watch_parent, args=(parent,), daemon=True).start()


@contextmanager
def open_executor(dask: str | None = None, workers: int | None = None) -> Iterator[Executor]:
    """Open this machine's cores, or the workers of a running Dask scheduler."""
    count = workers or len(os.sched_getaffinity(0))
    if dask is None:
        pool = LocalPool(count)
        try:
            yield pool
        except BaseException:
            pool.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs dask.distributed: pip install 'aero-bayes[fleet]'") from None
    where: dict[str, Any] = {"scheduler_file": dask} if dask.endswith(".json") else {"address": dask}
    if dask == "local":
        where = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": ERROR}
    try:
        client = Client(**where, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"{dask}: no Dask scheduler answers there ({type(error).__name__})") from None
    with client:
        yield client.get_executor()  # type: ignore[no-untyped-call]


#: Folder of the rigs' run directories, and what each says while it runs.
RUNS, LOG = "rigs", "log.txt"
#: What a row is, so that rows of an older kind are computed anew.
KIND = 4
#: A rig whose likelihood has less than this share of its posterior's precision tells only its prior.
MIN_LIKELIHOOD_SHARE = 0.05
_COMMANDS: Mapping[Work, Callable[[Rig, RunOptions], RunJson]] = {
    "fit": lambda rig, options: run_fit(rig.train, options),
    "posterior": lambda rig, options: run_fit(rig.train, replace(options, posterior=True)),
    "loop": lambda rig, options: run_close_loop(rig.train, rig.test, options),
    "all": lambda rig, options: run_all(rig.train, rig.test, options),
}


@dataclass(frozen=True)
class RigTask:
    """Everything that a worker needs; the files must be readable on its machine."""

    rig: Rig
    config: Config | str
    work: Work
    out: Path
    seed: int
    model: Path | None = None

    @property
    def key(self) -> str:
        """The rig's name."""
        return self.rig.name

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
    config, folder, fmu = task.config, task.out / RUNS / task.rig.name, task.model
    if isinstance(config, str):
        return failure(task.key, config)
    assert fmu is not None
    if hashlib.sha256(fmu.read_bytes()).hexdigest() != fmu.stem:
        return failure(task.key, f"{fmu}: has changed since the fleet was started")
    built: Path | None = fmu
    if config.model.fmu is not None:
        config, built = config.model_copy(update={"model": config.model.model_copy(update={"fmu": fmu})}), None
    # Rigs of one model share the extended models that their loops export.
    cache = fmu.parent / "loop"
    options = RunOptions(folder, config=config, seed=task.seed, workers=1, quiet=True, built=built, cache=cache)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with (
            (folder / LOG).open("w", encoding="utf-8") as log,
            contextlib.redirect_stdout(log),
            contextlib.redirect_stderr(log),
        ):
            result = _COMMANDS[task.work](task.rig, options)
    except (InputError, CannotFinishError) as error:
        return failure(task.key, str(error))
    searched = {item.name: item for item in fit_parameters(Model.load(fmu), config)}
    return _row(task.key, result, searched)


def _row(name: str, result: RunJson, searched: Mapping[str, Parameter]) -> Row:
    """Make the row of a finished rig: the numbers of its ``result.json`` that the fleet needs."""
    loop, words = result.loop, result.effect_words()
    effects = loop.effects if loop else []
    wanted = {*searched, *(key for effect in effects for key in effect.parameters)}
    ratios = [one.ratio for outputs in result.residual.values() for one in outputs.values() if one.ratio is not None]
    return {
        "key": name,
        "simulated": result.simulated,
        "parameters": {
            key: _parameter(entry, searched.get(key))
            for key, entry in result.parameters.items()
            if key in wanted and entry.status != "fixed" and entry.value is not None
        },
        "over_floor": max(ratios, default=None),
        "outcome": loop.outcome if loop else "",
        "effects": [_named(effect, loop, words) for effect in effects] if loop else [],
    }


def _parameter(entry: ParameterJson, item: Parameter | None) -> dict[str, Any]:
    stated = {"value": entry.value, "unit": entry.unit}
    low, middle, high = entry.q05, entry.q50, entry.q95
    if low is None or middle is None or high is None or not high > low:
        return stated
    floor = item.lower if item is not None else entry.lower
    log = low > 0.0 and floor is not None and floor >= 0.0
    if log:
        low, middle, high = math.log(low), math.log(middle), math.log(high)
    likelihood = _without_prior(middle, (high - low) / (2.0 * NORMAL_HALF_WIDTH), item, log=log)
    return stated | {"log": log, "centre": likelihood[0], "width": likelihood[1]} if likelihood else stated


def _without_prior(centre: float, sd: float, item: Parameter | None, *, log: bool) -> tuple[float, float] | None:
    """Compute centre and width of the likelihood: a Gaussian posterior over the prior's own curvature.

    The fleet takes the place of the rig's prior; with both it would be counted once a rig. None if little is left."""
    if item is None:
        return centre, sd
    value = min(max(math.exp(centre) if log else centre, item.lower), item.upper)
    first, second = item.prior.derivatives(np.array([value]))
    slope, bend = float(first[0]), float(second[0])
    if log:
        slope, bend = slope * value + 1.0, bend * value**2 + slope * value
    precision = 1.0 / sd**2 + bend
    return (centre - slope / precision, precision**-0.5) if precision >= MIN_LIKELIHOOD_SHARE / sd**2 else None


def _named(effect: EffectJson, loop: LoopJson, words: Mapping[str, str]) -> dict[str, Any]:
    """Describe an effect that the loop named, and those that its data cannot tell from it."""
    alike = next((group for group in loop.equivalent if effect.id in group), [])
    return {"id": effect.id, "summary": words.get(effect.id, ""), "alike": [i for i in alike if i != effect.id]}


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
    write_json(folder / FLEET_RESULT, result.model_dump(by_alias=True))
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
        write_whole(kept, model.path.read_bytes())
    return kept
