"""The closed loop as a user runs it, and what its answer claims."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.study import Row


def close_loop(folder: Path, train: Sequence[Path], test: Sequence[Path] = (), seed: int = 1) -> Row:
    """Close the loop on ``rig.toml`` of a folder by the command, and read ``result.json``.

    Raises RuntimeError with the last line that the command printed, where it fails.
    """
    command = [str(Path(sys.executable).with_name("aero-bayes")), "close-loop", "--config", "rig.toml"]
    command += ["--out", "out", "--workers", "1", "--seed", str(seed), "--quiet"]
    command += [part for path in train for part in ("--train", str(path))]
    command += [part for path in test for part in ("--test", str(path))]
    began = time.perf_counter()
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    took = round(time.perf_counter() - began, 2)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])
    return {**answer_of(json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))), "seconds": took}


@dataclass(frozen=True)
class LoopTask:
    """One loop on measured recordings: texts of the model's files by name, and the folder in which it runs."""

    files: Mapping[str, str]
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    folder: Path
    seed: int
    minutes: float

    def close(self) -> Row:
        """Close the loop, and keep the run."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        for name, text in self.files.items():
            (self.folder / name).write_text(text, encoding="utf-8")
        with (self.folder / "rig.toml").open("a", encoding="utf-8") as config:
            config.write(f"\n[loop]\nmax_minutes = {self.minutes:g}\n")
        return close_loop(self.folder, self.train, self.test, self.seed)


def answer_of(result: Mapping[str, Any]) -> Row:
    """Return the parts of ``result.json`` that are judged."""
    loop = result["loop"]
    keys = ("id", "port", "kind", "share", "claim", "alternatives")
    return {
        "outcome": loop["outcome"],
        "effects": [{key: effect.get(key) for key in keys} for effect in loop["effects"]],
        "equivalent": loop.get("equivalent", []),
        "before": loop.get("before", {}),
        "after": loop.get("after", {}),
        "sentence": loop.get("sentence", ""),
        "simulations": loop.get("simulations"),
    }


def same_as(row: Row, effect: Mapping[str, Any]) -> set[str]:
    """Return the id of an effect, and those that the program says do as well in its place."""
    name = effect["id"]
    alternatives = {one["id"] for one in effect.get("alternatives") or ()}
    found = {name, *alternatives, *(other for same in row["equivalent"] if name in same for other in same)}
    # a law at like places, lag@T1+T2, is that law at each of them
    laws = [other.partition("@") for other in found]
    return found | {f"{law}@{place}" for law, _, places in laws if "+" in places for place in places.split("+")}


def claims_law(effect: Mapping[str, Any]) -> bool:
    """Whether a law of the library is claimed: no curve, and not its place or one of several laws only."""
    return effect["kind"] != "free_form" and effect.get("claim") in (None, "law")


def unseen(row: Row, when: str) -> Mapping[str, float]:
    """Return the errors by output ``before`` or ``after``: on test readings, else on validation or fitted ones."""
    found: Mapping[str, float] = row[when].get("test") or row[when].get("validation") or row[when].get("train", {})
    return found
