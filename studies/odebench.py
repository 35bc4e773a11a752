"""ODEBench with one term deleted: does the loop find the term, by its form or its values?

63 published systems of ordinary differential equations, mostly from S. Strogatz, Nonlinear Dynamics and Chaos, as
collected by ODEFormer (d'Ascoli et al., 2023). One additive term is deleted, the constants stay free and are 30 % off.
The loop fits recordings with noise from the first start, and is judged on the second. A named term is right if it
stands in the right rate and is the deleted one over what was visited, to 5 %. Tasks whose deleted term shows (d >= 20)
are drawn from the odd-numbered systems; the even-numbered ones are for development (``--even``). The benchmark is not
part of the project: its file is fetched into OUT/odebench, or given by ``--source``. Beside it stand SINDy (pysindy)
and symbolic regression (gplearn) on the residual of the derivatives, where they are installed, with all states given.
Finished tasks are kept in OUT/odebench/tasks.sqlite and not run again; the summary is OUT/odebench.json.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import math
import tempfile
import time
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from aero_bayes.cli import main as main_command
from aero_bayes.fleets import open_executor
from odebench_tasks import (
    System,
    Task,
    can_be_simulated,
    noisy_runs,
    peers,
    read_systems,
    tasks_of,
    times,
    verdict,
    visibility,
)  # fmt: skip
from trial_runs import Row, code, run_trials, study_parser, write_summary

SOURCE = "https://raw.githubusercontent.com/sdascoli/odeformer/main/odeformer/odebench/strogatz_equations.py"
#: Distance from which on a deleted term counts as visible.
VISIBLE = 20.0
#: Kinds of tasks, and how many of each are drawn.
COUNTS = {"all_states": 24, "one_hidden": 12, "nothing_deleted": 12}


def draw(
    systems: Sequence[System], noise: float, counts: Mapping[str, int], seed: int, visible: Callable[[Task], bool]
) -> list[tuple[str, Task]]:
    """Draw tasks, of as many systems as there are, their kinds interleaved.

    Parameters
    ----------
    systems : sequence of System
    noise : float
        Share of each state's standard deviation.
    counts : mapping of str to int
        Tasks of each kind.
    seed : int
    visible : callable
        Whether a task's deleted term shows.

    Returns
    -------
    list of (str, Task)
        Kind and task.
    """
    rng = np.random.default_rng(seed)
    placed: list[tuple[float, str, Task]] = []
    for kind, count in counts.items():
        offered = [tasks_of(s, noise)[kind] for s in systems]
        queues = [list(rng.permutation(np.array(own, dtype=object))) for own in offered if own]
        queues = [queues[k] for k in rng.permutation(len(queues))]
        found: list[Task] = []
        while len(found) < count and any(queues):
            for queue in queues:
                while queue and len(found) < count:
                    task = queue.pop()
                    if task.term is None or visible(task):
                        found.append(task)
                        break
        placed += [((k + 0.5) / max(len(found), 1), kind, task) for k, task in enumerate(found)]
    return [(kind, task) for _, kind, task in sorted(placed, key=lambda p: p[0])]


class Visibilities:
    """How far deleted terms show, each computed once and kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, float] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def visible(self, task: Task) -> bool:
        """Return whether a task's deleted term shows."""
        if task.key not in self._known:
            self._known[task.key] = visibility(task)
            write_summary(self._known, self._path)
        return self._known[task.key] >= VISIBLE


class Attempt:
    """A drawn task with its kind; its key is that of the task."""

    def __init__(self, kind: str, task: Task) -> None:
        self.kind, self.task = kind, task

    @property
    def key(self) -> str:
        """Key of its row."""
        return self.task.key


def run(one: Attempt, seed: int, minutes: float, version: str, with_peers: bool) -> Row:
    """Close the loop on a task as a user would, and judge what it says."""
    task, began, computing = one.task, time.perf_counter(), _computing()
    runs = noisy_runs(task, seed)
    row: Row = {
        "key": task.key, "kind": one.kind, "code": version, "deleted": "" if task.term is None else str(task.term.value)
    }  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="odebench-") as folder:
        seen = _write(Path(folder), task, runs, minutes)
        paths = {"--config": "rig.toml", "--train": "first.csv", "--test": "second.csv", "--out": "run"}
        command = ["close-loop", "--workers", "1", "--quiet"]
        command += [word for option, name in paths.items() for word in (option, str(Path(folder) / name))]
        # in this process: a command of its own would import the package and read the laws anew for each task
        done = CliRunner().invoke(main_command, command)
        row |= {"seconds": round(time.perf_counter() - began, 1), "computing": round(_computing() - computing, 1)}
        if done.exit_code:
            return {**row, "verdict": "failed", "why": (done.output.strip().splitlines() or ["no message"])[-1]}
        loop = json.loads((Path(folder) / "run" / "result.json").read_text(encoding="utf-8"))["loop"]
        written = [Path(folder) / "run" / e["modelica"] for e in loop["effects"][:1]]
        modelica = written[0].read_text(encoding="utf-8") if written and written[0].is_file() else ""
    unseen = loop["after"].get("test", {})
    sd = {name: task.noise * float(np.std(runs[0][:, k])) for k, name in enumerate(task.system.states) if name in seen}
    ratios = [unseen[name] / sd[name] for name in seen if unseen.get(name) is not None]
    named = [e.get("text") or e["id"] for e in loop["effects"]]
    row |= {
        "verdict": verdict(task, loop, modelica), "named": named, "ids": [e["id"] for e in loop["effects"]],
        "unseen_over_noise": max(ratios, default=None),
    }  # fmt: skip
    if with_peers and one.kind == "all_states":
        row["peers"] = peers(task, runs[0])
    return row


def _computing() -> float:
    """Measure the computing time in s of this process and of its children that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def _write(folder: Path, task: Task, runs: Sequence[np.ndarray], minutes: float) -> list[str]:
    """Write model, configuration and recordings. Returns the names of the recorded states."""
    seen = [name for k, name in enumerate(task.system.states) if k != task.hidden]
    (folder / "Rig.mo").write_text(task.first_model.modelica(task.system.starts[0], task.hidden), encoding="utf-8")
    free = "".join(f"{name} = {{free = true}}\n" for name in task.first_model.constants)
    (folder / "rig.toml").write_text(
        f'[model]\nsources = ["Rig.mo"]\nname = "Rig"\n\n[data]\ninputs = []\noutputs = {json.dumps(seen)}\n\n'
        f'[fit]\ninitial_states = "estimated"\n\n[loop]\nformulas = true\nmax_minutes = {minutes:g}\n\n'
        f"[parameters]\n{free}",
        encoding="utf-8",
    )
    columns = [k for k in range(len(task.system.states)) if k != task.hidden]
    for name, states in zip(("first", "second"), runs, strict=True):
        table = np.column_stack([times(), states[:, columns]])
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=",".join(["time", *seen]), comments="")
    return seen


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rates of all rows, with standard errors; a run that failed counts as not right."""
    kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in COUNTS}
    right = {kind: [row["verdict"] in ("right", "in class") for row in own] for kind, own in kinds.items()}
    false, place = (
        {kind: [row["verdict"] == verdict_ for row in own] for kind, own in kinds.items()}
        for verdict_ in ("false", "place")
    )
    found: dict[str, Any] = {
        kind: {
            "tasks": len(kinds[kind]),
            **_rate("right", right[kind]),
            **_rate("false", false[kind]),
            **_rate("place", place[kind]),
        }
        for kind in ("all_states", "one_hidden")
    }
    nothing = false["nothing_deleted"]
    found["nothing_deleted"] = {"tasks": len(nothing), **_rate("named", nothing)}
    with_peers = [row["peers"] for row in rows if row.get("peers")]
    names = sorted({name for one in with_peers for name in one})
    found["peers"] = {
        name: {
            "tasks": sum(name in one for one in with_peers),
            **_rate("right", [one[name] == "right" for one in with_peers if name in one]),
            **_rate("false", [one[name] == "false" for one in with_peers if name in one]),
        }
        for name in names
    }
    over = [r["unseen_over_noise"] for r in rows if r["verdict"] in ("right", "in class") and r["unseen_over_noise"]]
    found["unseen_over_noise_median_where_right"] = float(np.median(over)) if over else None
    for name in ("seconds", "computing"):
        known = [row[name] for row in rows if name in row]
        found[f"{name}_median"] = float(np.median(known)) if known else None
    return {**found, "rows": list(rows)}


def _rate(name: str, passed: Sequence[bool]) -> dict[str, float | None]:
    """Return a share and its standard error."""
    if not passed:
        return {name: None, f"{name}_sd": None}
    share = sum(passed) / len(passed)
    return {name: share, f"{name}_sd": math.sqrt(share * (1.0 - share) / len(passed))}


def table(found: Mapping[str, Any]) -> str:
    """Write the rates and all rows in Markdown."""
    lines = ["| task | deleted | verdict | named | s |", "|" + " --- |" * 5]
    for row in sorted(found["rows"], key=lambda row: (row["kind"], row["verdict"], row["key"])):
        named = row.get("why") or ", ".join(f"`{name}`" for name in row["named"]) or "-"
        lines.append(f"| {row['key']} | `{row['deleted']}` | {row['verdict']} | {named} | {row['seconds']:.0f} |")
    for key in ("all_states", "one_hidden", "nothing_deleted", "peers"):
        lines += ["", f"{key}: {json.dumps(found[key])}"]
    return "\n".join(lines)


def source_file(given: Path | None, folder: Path) -> Path:
    """Return the file of the benchmark: the given one, or the one that was fetched, once."""
    if given is not None:
        return given
    path = folder / "strogatz_equations.py"
    if not path.exists():
        with urllib.request.urlopen(SOURCE, timeout=60) as answer:
            path.write_bytes(answer.read())
    return path


def main() -> None:
    parser = study_parser(__doc__, stop_after=15.0)
    parser.add_argument("--source", type=Path, help="a copy of strogatz_equations.py; fetched by default")
    parser.add_argument("--noise", type=float, default=0.02, help="share of each state's standard deviation")
    parser.add_argument("--even", action="store_true", help="the even-numbered systems, for development")
    parser.add_argument("--tasks", type=float, default=1.0, help="this share of the tasks of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--max-minutes", type=float, default=2.0, help="[loop] max_minutes of each loop")
    parser.add_argument("--only", nargs="+", default=[], help="keys of tasks")
    parser.add_argument("--no-peers", action="store_true", help="the loop alone")
    options = parser.parse_args()
    folder = options.out / "odebench"
    folder.mkdir(parents=True, exist_ok=True)
    counts = {kind: math.ceil(options.tasks * count) for kind, count in COUNTS.items()}
    path = source_file(options.source, folder)
    systems = [s for s in read_systems(path) if s.number % 2 == (0 if options.even else 1) and can_be_simulated(s)]
    drawn = draw(systems, options.noise, counts, options.seed, Visibilities(folder / "visible.json").visible)
    drawn = [(kind, task) for kind, task in drawn if not options.only or task.key in options.only]
    attempt = partial(
        run, seed=options.seed, minutes=options.max_minutes, version=code(), with_peers=not options.no_peers
    )
    with open_executor(options.dask, options.processes) as executor:
        rows = run_trials(
            [Attempt(kind, task) for kind, task in drawn], attempt, folder / "tasks.sqlite", executor,
            until=lambda: time.monotonic() >= options.began + 60.0 * options.stop_after,
        )  # fmt: skip
    found = summary(rows)
    print(table(found))
    write_summary({**found, "noise": options.noise, "left": len(drawn) - len(rows)}, options.out / "odebench.json")


if __name__ == "__main__":
    main()
