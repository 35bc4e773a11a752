"""All speed measurements: ``python benchmarks/bench.py --out reports`` writes ``bench.json``."""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from pathlib import Path

import bench_engine
import bench_sampling
import bench_structures


def main() -> None:
    """Run every part, each of which adds its rows and keys to the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    failed = []
    for part in (bench_engine, bench_sampling, bench_structures):
        start = time.perf_counter()
        try:
            part.run(options.out, options.rounds)
        except Exception:  # the figures of the other parts are wanted all the same
            traceback.print_exc()
            failed.append(part.__name__)
        print(f"{part.__name__}: {time.perf_counter() - start:.0f} s", flush=True)
    print(f"written: {options.out / 'bench.json'}; `make results` sets it beside the goals")
    if failed:
        sys.exit(f"not measured: {', '.join(failed)}")


if __name__ == "__main__":
    main()
