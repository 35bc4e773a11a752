"""Whole loops by the command line, as a user runs them: seconds from start to end, and computing time.

Loops on recordings that are not on this machine are left out.
"""

from __future__ import annotations

import os
import resource
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from harness import update

from study.answers import close_loop
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
        folder, environment = Path(name) / "model", {**os.environ, "XDG_CACHE_HOME": str(Path(name) / "cache")}
        shutil.copytree(case.folder, folder, ignore=shutil.ignore_patterns("out*"))
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        try:
            row = close_loop(folder, case.train, case.test, workers=2, seconds=TIME_LIMIT, environment=environment)
        except RuntimeError as error:
            return None, None, str(error)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return row["seconds"], cpu, f"{row['seconds']:.1f} s, {cpu:.1f} s of computing, {row['simulations']} simulations"


def run(out: Path, rounds: int = 1) -> None:
    """Run all loops once and write each to ``out``/bench.json as it ends; computing time counts on a busy machine."""
    seconds: dict[str, dict[str, float | None]] = {"loop_seconds": {}, "loop_computing_seconds": {}}
    for case in loops():
        whole, computing, note = run_loop(case)
        seconds["loop_seconds"][case.name], seconds["loop_computing_seconds"][case.name] = whole, computing
        print(f"loop of {case.name}: {note}", flush=True)
        update(out / "bench.json", [], seconds)
