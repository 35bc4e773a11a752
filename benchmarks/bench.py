"""All speed measurements: ``python benchmarks/bench.py --out reports`` writes ``bench.json``."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

import bench_engine
import bench_sampling
import bench_structures

from aero_bayes.files import write_whole


def main() -> None:
    """Print each row as it ends, and write it with those before it: the ratio of each stands under its key, too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {"rows": []}
    parts = (bench_engine, bench_sampling, bench_structures)
    for row in chain.from_iterable(part.measured(options.rounds) for part in parts):
        print(row.line(), flush=True)
        report["rows"].append(asdict(row))
        report[row.key] = row.ratio
        if row.error is not None:
            report["max_relative_error"] = row.error
        write_whole(options.out / "bench.json", json.dumps(report, indent=1) + "\n")
    print(f"written: {options.out / 'bench.json'}; `make results` sets it beside the goals")


if __name__ == "__main__":
    main()
