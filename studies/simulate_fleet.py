"""Write the recordings and ``fleet.toml`` of a simulated fleet of rigs, some with an effect that the others lack.

They are not measurements. ``aero-bayes fleet --config OUT/fleet.toml --out DIR`` fits them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from simulated_rigs import rig_kinds, write_fleet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kind", choices=rig_kinds(), default="cart", help="kind of rig (default: cart)")
    parser.add_argument("--rigs", type=int, default=12, help="how many rigs (default: 12)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same numbers")
    options = parser.parse_args()
    path = write_fleet(options.out, options.kind, options.rigs, seed=options.seed)
    print(f"simulated, not measured: {path}")


if __name__ == "__main__":
    main()
