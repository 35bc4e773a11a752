"""All speed measurements: ``python benchmarks/bench.py --out reports`` writes ``bench.json``."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

PARTS = ("bench_engine", "bench_sampling")


def main() -> None:
    """Run every part that is there, each of which adds its keys and rows to the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    for name in PARTS:
        if (Path(__file__).parent / f"{name}.py").is_file():
            importlib.import_module(name).run(options.out, options.rounds)


if __name__ == "__main__":
    main()
