"""Write recordings of the simulated AERO, two to fit and one to judge on, and beside them what it truly is.

They are not measurements.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from simulated_rigs.aero import default_recordings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same numbers")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    train, test = default_recordings(options.seed).write(options.out)
    print(f"simulated, not measured: {', '.join(str(path) for path in (*train, *test))}")


if __name__ == "__main__":
    main()
