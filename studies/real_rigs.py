"""The closed loop on measured recordings of real rigs: what it names, and how good its "before" is.

``real_rigs/cases.toml`` says what is fitted to what and which names are right; the recordings are not part of the
project and are looked for under ``--recordings``. A case is one row, kept as a JSON file in OUT/real_rigs; a case that
has its row is not run again unless ``--again`` names it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from real_rigs_table import Expectation, judge_answer, table
from trial_runs import Row, code, write_summary

HERE = Path(__file__).resolve().parent
MODELS = HERE / "real_rigs"
#: Where recordings are looked for.
RECORDINGS = tuple(HERE.parents[1] / "shared" / name for name in ("rigs", "data"))


@dataclass(frozen=True)
class RigCase(Expectation):
    """One loop: recordings, the folder of the first model, and what may be named (see ``cases.toml``)."""

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...] = ()
    model: str = ""

    @property
    def folder(self) -> Path:
        """Folder of the first model and its configuration."""
        return MODELS / (self.model or self.name)

    def find(self, folders: Sequence[Path]) -> dict[str, list[Path]] | None:
        """Find the recordings, by role; None where one of them is in none of the folders."""
        found = {
            role: [next((f / file for f in folders if (f / file).is_file()), None) for file in files]
            for role, files in (("train", self.train), ("test", self.test))
        }
        if any(path is None for paths in found.values() for path in paths):
            return None
        return {role: [path.resolve() for path in paths if path] for role, paths in found.items()}


def cases() -> dict[str, RigCase]:
    """Read all cases, quick ones first."""
    document = tomllib.loads((MODELS / "cases.toml").read_text(encoding="utf-8"))
    return {name: RigCase(name, **entries) for name, entries in document.items()}


def close_loop_of_case(case: RigCase, files: dict[str, list[Path]], out: Path, options: argparse.Namespace) -> Row:
    """Close the loop on the first model of a case."""
    copy_model(case, out)
    return run_loop(case.name, files, out, options)


def copy_model(case: RigCase, out: Path) -> None:
    """Begin a folder anew with the first model of a case and its configuration."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(case.folder, out / "model")


def loop_arguments(files: dict[str, list[Path]], out: Path, options: argparse.Namespace) -> list[str]:
    """Write the time limit into the configuration; arguments of the program, to be run in ``out``."""
    if options.max_minutes:
        with (out / "model" / "rig.toml").open("a", encoding="utf-8") as config:
            config.write(f"\n[loop]\nmax_minutes = {options.max_minutes:g}\n")
    arguments = ["close-loop", "--config", "model/rig.toml"]
    arguments += [part for role, paths in files.items() for path in paths for part in (f"--{role}", str(path))]
    return [*arguments, "--out", "run", "--workers", str(options.workers), "--seed", str(options.seed), "--quiet"]


def run_loop(key: str, files: dict[str, list[Path]], out: Path, options: argparse.Namespace) -> Row:
    """Run the command as a user would, on the model in ``out/model``, and read what it says.

    Parameters
    ----------
    key : str
        Of the row.
    files : dict of str to list of Path
        Recordings by role, ``train`` and ``test``.
    out : Path
        Folder of the run.
    options : Namespace
        ``max_minutes``, ``workers`` and ``seed``.
    """
    command = [str(Path(sys.executable).parent / "aero-bayes"), *loop_arguments(files, out, options)]
    began = time.perf_counter()
    done = subprocess.run(command, cwd=out, capture_output=True, text=True, check=False)
    seconds = round(time.perf_counter() - began, 1)
    row: Row = {"key": key, "code": code(), "seed": options.seed, "seconds": seconds}
    if done.returncode:
        return {**row, "error": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    return {**row, **judged_parts(json.loads((out / "run" / "result.json").read_text(encoding="utf-8")))}


def judged_parts(result: dict[str, Any]) -> Row:
    """Return the parts of ``result.json`` that are judged."""
    loop = result["loop"]
    parameters = dict(result["parameters"])
    for effect in loop["effects"]:
        parameters.update(effect.get("parameters", {}))
    return {
        "outcome": loop["outcome"],
        "named": [effect["id"] for effect in loop["effects"]],
        "smaller": [effect["id"] for effect in loop.get("smaller", [])],
        "share": [effect.get("share") for effect in loop["effects"]],
        "wins": [effect.get("wins") for effect in loop["effects"]],
        "equivalent": loop.get("equivalent", []),
        **{when: loop.get(when, {}) for when in ("before", "after", "noise_floor")},
        "parameters": {name: {key: one.get(key) for key in ("value", "sd")} for name, one in parameters.items()},
        "sentence": loop.get("sentence", ""),
    }


def run(
    known: dict[str, RigCase], there: dict[str, dict[str, list[Path]]], out: Path, options: argparse.Namespace
) -> None:
    """Run the loops that have no row yet, or are asked for again, one after the other."""
    end = time.monotonic() + 60.0 * options.stop_after
    for name, files in there.items():
        path = out / f"{name}.json"
        if time.monotonic() >= end or (path.exists() and name not in options.again):
            continue
        row = close_loop_of_case(known[name], files, out / "runs" / name, options)
        write_summary(row, path)
        print(f"{name}: {row.get('sentence') or row.get('error')} ({row['seconds']:.0f} s)", flush=True)


def main() -> None:
    known = cases()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, action="append", help="folder of recordings (may be repeated)")
    parser.add_argument("--out", type=Path, default=Path("reports"), help="rows and runs: OUT/real_rigs")
    parser.add_argument("--only", choices=known, action="append", metavar="NAME", help=", ".join(known))
    parser.add_argument("--again", choices=known, action="append", default=[], metavar="NAME", help="run it anew")
    parser.add_argument("--workers", type=int, default=2, help="processes of a loop")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--max-minutes", type=float, help="[loop] max_minutes of each loop (default: the program's)")
    parser.add_argument("--stop-after", type=float, default=float("inf"), help="start no loop after so many minutes")
    parser.add_argument("--table", action="store_true", help="run no loop")
    options = parser.parse_args()
    out = (options.out / "real_rigs").resolve()
    out.mkdir(parents=True, exist_ok=True)
    folders = options.recordings or RECORDINGS
    found = {name: known[name].find(folders) for name in options.only or known}
    there = {name: files for name, files in found.items() if files is not None}
    print("".join(f"{name}: its recordings are not there\n" for name in found if name not in there), end="")
    if not options.table:
        run(known, there, out, options)
    rows = []
    for name in there:
        if (path := out / f"{name}.json").exists():
            rows.append(judge_answer(json.loads(path.read_text(encoding="utf-8")), known[name]))
    text = table(rows)
    print(text)
    write_summary({"rows": rows}, out / "table.json")
    (out / "table.md").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
