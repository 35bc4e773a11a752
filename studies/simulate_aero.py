"""Write recordings of the simulated AERO, two to fit and one to judge on, and beside them what it truly is.

They are not measurements; nothing in the CSV files tells what they carry.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from aero_bayes.data import write_csv
from simulated_rigs.aero import default_recordings, default_truth


def write_recordings(folder: Path, seed: int) -> list[Path]:
    """Write ``NAME.csv`` for each recording and ``simulated.json``, which holds the truth."""
    folder.mkdir(parents=True, exist_ok=True)
    made = default_recordings(seed)
    paths = [write_csv(recording, folder / f"{recording.name}.csv") for recording in made]
    label = {"simulated": True, "recordings": [recording.name for recording in made], "truth": asdict(default_truth())}
    (folder / "simulated.json").write_text(json.dumps(label, indent=1) + "\n", encoding="utf-8")
    return paths


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same numbers")
    options = parser.parse_args()
    print(f"simulated, not measured: {', '.join(map(str, write_recordings(options.out, options.seed)))}")


if __name__ == "__main__":
    main()
