"""The README's picture from the run directory of plain ``make``: ``readme_picture.py reports OUT.svg``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

BEFORE, AFTER, FLOOR = "#b8500f", "#0b62a4", "#777777"
RECORDING, OUTPUT = "test_1", "theta"


def draw(directory: Path, out: Path) -> None:
    """Draw the residual of the pitch on the unseen recording, before and after the loop, with the lines it wrote."""
    series = np.load(directory / "series.npz")
    loop = json.loads((directory / "result.json").read_text("utf-8"))["loop"]
    time, measured = series[f"time/{RECORDING}"], series[f"measured/{RECORDING}/{OUTPUT}"]
    floor = 1e3 * loop["noise_floor"][OUTPUT]
    matplotlib.rcParams |= {"font.size": 10, "svg.fonttype": "path", "svg.hashsalt": "aero-bayes"}
    figure = Figure(figsize=(9.0, 3.1), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    stories = (("before", "as it stands", BEFORE), ("after", f"with {loop['effects'][0]['id']}", AFTER))
    for axis, (key, title, colour) in zip(axes, stories, strict=True):
        residual = 1e3 * (measured - series[f"{key}/{RECORDING}/{OUTPUT}"])
        axis.axhspan(-2 * floor, 2 * floor, color=FLOOR, alpha=0.2, lw=0)
        axis.plot(time, residual, color=colour, lw=0.8)
        rms = loop[key]["test"][OUTPUT]
        axis.set_title(f"{title}: {1e3 * rms:.2f} mrad RMS", loc="left", fontsize=10.5, color=colour)
        axis.set_xlabel("time (s)")
        axis.spines[["top", "right"]].set_visible(False)
        axis.margins(x=0)
    axes[0].set_ylabel("pitch residual on unseen data (mrad)")
    figure.savefig(out, metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
