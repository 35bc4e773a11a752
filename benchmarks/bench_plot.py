"""The picture of the speed report: one run, growth, and effective samples a second, from ``bench.json``."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, NullLocator

OURS, THEIRS, GUIDE = "#0072b2", "#e69f00", "#777777"  # told apart by the colour-blind (Okabe and Ito)
SAMPLERS = ("sampling", "pints")


def _named(rows: Sequence[dict[str, Any]], group: str, pattern: str) -> tuple[list[float], list[float]]:
    found = []
    for row in rows:
        match = re.fullmatch(pattern, row["name"])
        if row["group"] == group and row["seconds"] is not None and match:
            found.append((float(match[1].replace(",", "")), 1e3 * row["seconds"]))
    x, y = zip(*sorted(found), strict=True) if found else ((), ())
    return list(x), list(y)


def _bars(axes: Axes, rows: Sequence[dict[str, Any]], scale: float, inverse: bool, title: str, unit: str) -> None:
    shown = [row for row in rows if row["seconds"]]
    lengths = [scale / row["seconds"] if inverse else scale * row["seconds"] for row in shown]
    ours = ["FMPy" not in row["name"] and "CasADi" not in row["name"] for row in shown]
    axes.barh(range(len(shown)), lengths, color=[OURS if own else THEIRS for own in ours], height=0.6)
    axes.set_yticks(range(len(shown)), [row["name"] for row in shown])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(0.3 * min(lengths, default=1.0), 6.0 * max(lengths, default=1.0))
    for i, length in enumerate(lengths):
        axes.annotate(f" {length:.3g}", (length, i), va="center", fontsize=8)
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_xlabel(unit)


def _growth(axes: Axes, curves: Sequence[tuple[str, list[float], list[float], str]], title: str, what: str) -> None:
    for label, x, y, colour in curves:
        axes.plot(x, y, marker="o" if colour == OURS else "s", color=colour, label=label)
        if x:
            axes.plot(x, y[-1] * np.array(x) / x[-1], color=GUIDE, linestyle=":", linewidth=1.0)
    axes.plot([], [], color=GUIDE, linestyle=":", label="linear")
    axes.set_title(title, loc="left", fontsize=10)
    ticks = sorted({v for _, x, _, _ in curves for v in x})
    if not ticks:
        axes.set_xlabel("not measured")
        return
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(ticks, [f"{v:,.0f}" for v in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(what)
    axes.set_ylabel("time a run (ms)")
    axes.legend(frameon=False, fontsize=8)


def draw_bench(report: Path, out: Path) -> None:
    """Draw the rows of a report into an SVG (or whatever the suffix says)."""
    rows = json.loads(report.read_text())["rows"]
    figure, grid = plt.subplots(3, 2, figsize=(11.0, 9.6), layout="constrained")
    _bars(
        grid[0, 0], [r for r in rows if r["group"] == "one run"], 1e3, False,
        "One 40 s run of the AERO (shorter is better)", "time a run (ms)",
    )  # fmt: skip
    _bars(
        grid[0, 1], [r for r in rows if r["group"] in SAMPLERS], 1.0, True,
        "Its posterior (longer is better)", "effective samples a second (1/s)",
    )  # fmt: skip
    samples = _named(rows, "growth", r"([\d,]+) samples")
    recordings = _named(rows, "growth", r"(\d+) recordings")
    batch = _named(rows, "growth", r"batch of (\d+)")
    plain, slopes = _named(rows, "states", r"(\d+) states"), _named(rows, "states", r"(\d+) states, Gauss-Newton, 2")
    parameters = _named(rows, "sensitivities", r"trajectories and (\d+) sensitivities")
    _growth(grid[1, 0], [("log-likelihood", *samples, OURS)], "Samples", "samples a recording")
    _growth(grid[1, 1], [("log-likelihood", *recordings, OURS)], "Recordings", "recordings of 2,001 samples")
    _growth(
        grid[2, 0], [("log-likelihood", *plain, OURS), ("Gauss-Newton, 2 parameters", *slopes, THEIRS)],
        "States (an RC ladder)", "states",
    )  # fmt: skip
    axes = grid[2, 1]
    axes.plot(*parameters, marker="o", color=OURS, label="run with sensitivities, by parameters")
    axes.plot(*batch, marker="s", color=THEIRS, label="log-likelihood, by batch size")
    if parameters[0] or batch[0]:
        axes.set_xscale("log")
        axes.set_ylim(bottom=0.0)
    axes.set_title("Parameters and batch", loc="left", fontsize=10)
    axes.set_xlabel("parameters, or runs a batch")
    axes.set_ylabel("time a run (ms)")
    axes.legend(frameon=False, fontsize=8)
    for axes in grid.flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="both" if axes not in grid[0] else "x", alpha=0.25)
    partial = out.with_name(f".{out.name}")
    figure.savefig(partial, format=out.suffix[1:])
    plt.close(figure)
    os.replace(partial, out)
