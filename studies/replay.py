"""Replay the paper's Table 1 and Fig. 6 on a simulated recording, and write the table and the figure."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from pathlib import Path

from aero_bayes.files import one_run_at_a_time
from paper_replay import replay_paper, write_run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("reports/replay"))
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same numbers")
    parser.add_argument("--workers", type=int, help="simulation processes; by default one a core")
    options = parser.parse_args()
    with one_run_at_a_time(options.out):
        table = write_run(replay_paper(seed=options.seed, workers=options.workers, out=options.out), options.out)
    print(f"wrote {table}")


if __name__ == "__main__":
    main()
