"""Whole loops by the command line, as a user runs them: seconds from start to end, and computing time.

Loops on recordings that are not on this machine are left out.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from harness import update

from study.real import cases

#: The loops on recordings of real rigs.
RIGS = ("coil", "battery", "silverbox", "aero_step", "aero_pulse")
#: A loop that takes longer, in s, is stopped and said to be not done: three times the longest goal, so that six loops
#: end within ten minutes.
TIME_LIMIT = 90.0


@dataclass(frozen=True)
class LoopCase:
    """Folder of model and configuration, and recordings, of one loop."""

    name: str
    folder: Path
    train: tuple[Path, ...]
    test: tuple[Path, ...]


def loops() -> Iterator[LoopCase]:
    """Find the loops whose recordings are on this machine."""
    example = Path(__file__).resolve().parents[1] / "examples" / "cart"
    yield LoopCase("cart", example, (example / "train.csv",), (example / "test.csv",))
    for case in (cases()[name] for name in RIGS):
        if files := case.find():
            yield LoopCase(case.name, case.folder, *(tuple(files[f] for f in role) for role in (case.train, case.test)))


def run_loop(case: LoopCase) -> tuple[float | None, float | None, str]:
    """Run one loop with two workers and nothing kept from earlier runs; seconds, computing time in s, and a note."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(case.folder, folder / "model", ignore=shutil.ignore_patterns("out*"))
        command = [str(Path(sys.executable).parent / "aero-bayes"), "close-loop", "--config", "model/rig.toml"]
        command += [part for role in ("train", "test") for p in getattr(case, role) for part in (f"--{role}", str(p))]
        command += ["--out", "run", "--workers", "2", "--quiet"]
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        try:
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=TIME_LIMIT
            )
        except subprocess.TimeoutExpired:
            return None, None, f"not done in {TIME_LIMIT:g} s"
        seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            return None, None, (done.stderr.strip().splitlines() or ["?"])[-1]
        loop = json.loads((folder / "run" / "result.json").read_text(encoding="utf-8"))["loop"]
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, cpu, f"{seconds:.1f} s, {cpu:.1f} s of computing, {loop.get('simulations', '?')} simulations"


def run(out: Path, rounds: int = 1) -> None:
    """Run all loops once and write each to ``out``/bench.json as it ends; computing time counts on a busy machine."""
    seconds: dict[str, dict[str, float | None]] = {"loop_seconds": {}, "loop_computing_seconds": {}}
    for case in loops():
        whole, computing, note = run_loop(case)
        seconds["loop_seconds"][case.name], seconds["loop_computing_seconds"][case.name] = whole, computing
        print(f"loop of {case.name}: {note}", flush=True)
        update(out / "bench.json", [], seconds)
