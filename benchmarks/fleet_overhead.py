"""What distribution costs: time and bytes a task, and from how many workers on the scheduler is the limit.

Times are processor time, so that other work on the machine does not count. The caller's process holds scheduler, client
and table, as ``aero-bayes fleet --dask local`` does; with a scheduler of its own the limit is further away.
"""

from __future__ import annotations

import argparse
import json
import pickle
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.config import Config
from aero_bayes.files import whole_file
from aero_bayes.fleet import Parcel, Rig, RigTask, Table, open_executor, run_tasks
from aero_bayes.fleet.runner import _timed

#: Processor time of one rig, fit and loop, on which limit and overhead are reckoned, in s.
RIG_SECONDS = 8.8


def task_of(number: int, seconds: float, out: Path) -> RigTask:
    """Make a task of true size; its seed says how long it works."""
    name = f"rig-{number:06}"
    files = tuple(out / "recordings" / name / f"{run}.csv" for run in ("train", "test"))
    config = Config.model_validate({"parameters": {f"p{k}": {"free": True} for k in range(8)}})
    rig = Rig(name, files[:1], files[1:])
    return RigTask(rig, config, "loop", out, round(1e6 * seconds), Parcel(out / "model.fmu", "0" * 64))


def busy(task: RigTask) -> dict[str, Any]:
    """Work for so long; a row of true size (that of a rig with eight parameters and two effects)."""
    began = time.process_time()
    while time.process_time() - began < 1e-6 * task.seed:
        np.linalg.norm(np.ones(100))
    entry = {"value": 1.23456789, "sd": 0.0123456789, "unit": "N.m.s/rad", "status": "identified", "log": True}
    parameters = {f"p{k}": entry | {"centre": 0.2123456789, "width": 0.0123456789} for k in range(8)}
    effects = [{"id": f"coulomb_friction@flange{k}", "alike": [], "strength": 1.23456789} for k in range(2)]
    return {"key": task.key, "parameters": parameters, "effects": effects, "text": "x" * 200, "over_floor": 1.0123}


def processor_times(count: int, seconds: float, dask: str, folder: Path) -> dict[str, float]:
    """Measure the processor time of caller and workers for so many tasks; a first one has the workers start."""
    with open_executor(dask, 2) as executor, Table(folder / f"{dask}-{seconds}.sqlite") as table:
        run_tasks([warm_up_task(k, folder) for k in range(4)], busy, table, executor)
        began, cpu = time.perf_counter(), time.process_time()
        run_tasks((task_of(k, seconds, folder) for k in range(count)), busy, table, executor)
        caller, wall = time.process_time() - cpu, time.perf_counter() - began
        worked = sum(cost["cpu_seconds"] for key, cost in table.costs() if key.startswith("rig-"))
    return {"caller": caller, "wall": wall, "workers": worked}


def warm_up_task(number: int, folder: Path) -> RigTask:
    """Make a task for warming up: no work, a key of its own."""
    task = task_of(number, 0.0, folder)
    return replace(task, rig=replace(task.rig, name=f"first-{number}"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--tasks", type=int, default=2000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        task = task_of(1, 0.0, folder)
        sent, received = len(pickle.dumps((_timed, busy, task))), len(pickle.dumps(_timed(busy, task)))
        result: dict[str, Any] = {"bytes_sent": sent, "bytes_received": received, "tasks": arguments.tasks}
        empty = processor_times(arguments.tasks, 0.0, "local", folder)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        processor_times(3 * arguments.tasks, 0.0, "local", folder / "more")
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        work = processor_times(100, 0.2, "local", folder)
        a_task = empty["caller"] / arguments.tasks
        result |= {
            "caller_ms_a_task": 1e3 * a_task,
            "tasks_per_s": 1.0 / a_task,
            "wall_tasks_per_s": arguments.tasks / empty["wall"],
            "workers_at_the_limit": RIG_SECONDS / a_task,
            "overhead_of_a_rig": a_task / RIG_SECONDS,
            "efficiency_of_0.2_s_tasks": 20.0 / (work["caller"] + work["workers"]),
            "grown_kb_for_three_times_the_tasks": grown,
        }
    print(json.dumps(result, indent=1))
    with whole_file(arguments.out / "fleet_overhead.json") as temporary:
        temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
