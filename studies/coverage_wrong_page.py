"""The study of wrong models as one page: coverage and width by state, method and rig."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from study_page import listed, marked, percent, table

TITLE = "How far do intervals hold where the model is wrong?"
#: What was done is told in docs/explanation/intervals.md; the page says how to read its tables.
HOW_TO_READ = """<p>Where the model is right, and after the loop has mended it, an interval should hold the true value.
Where it is wrong, the best value for experiments of this kind, found on one recording twenty times as long. Width is
relative to the narrowest interval about this estimate that could hold: 1.645 root mean square errors to either side.
Shares and widths are means over the rigs of the means over their parameters.</p>"""
STATES = {
    "right": "the model is right",
    "missing": "a listed law is missing",
    "mended": "the loop found the law and added it",
    "unlisted": "something acts that no law lists",
    "process_noise": "a random force drives a state",
}
METHODS = {"ours": "aero-bayes", "curve_fit": "least squares, white noise", "mcmc_white": "MCMC, white noise"}
#: Coverage of a 90 % interval that is asked for, and the greatest relative width.
HOLDS, WIDEST = (0.85, 0.95), 1.5


def parts(result: Mapping[str, Any]) -> list[str]:
    """Return the pieces of the page."""
    seeds = result["seeds"]
    kind = "report" if seeds["used"] == seeds["report"] else "development"
    added = "; ".join(f"{name}: {', '.join(ids) or 'nothing'}" for name, ids in result["mended_by"].items())
    return [
        f"<p>Outside of what is asked for ({percent(HOLDS[0])} to {percent(HOLDS[1])} of 90 % intervals hold, their "
        f"width at most {WIDEST:g} times the narrowest):</p>",
        listed(misses(result)),
        state_table(result["states"]),
        f"<p>{band_sentence(result['bands_90'], result['bands_90_by_state'])}</p>",
        HOW_TO_READ,
        f"<p>The loop, run once for each rig where the law was large, added {escape(added)}.</p>",
        f"<p>{result['repetitions']} fits, {kind} seeds ({seeds['used']}). Failed:</p>",
        listed(result["failed"]),
        "<h2>Rig by rig</h2>",
        rig_table(result["by_rig"]),
    ]


def misses(result: Mapping[str, Any]) -> list[str]:
    """Say in which states the intervals of the program do not hold as asked for."""
    lines = []
    for state, row in result["states"].items():
        own = row.get("ours")
        if own is None:
            continue
        name = STATES[state]
        low, high = (HOLDS[0], 1.0) if state == "mended" else HOLDS
        if not low <= own["90"] <= high:
            lines.append(f"{name}: 90 % intervals hold in {percent(own['90'])}")
        if not 0.43 <= own["50"] <= 0.57:
            lines.append(f"{name}: 50 % intervals hold in {percent(own['50'])}")
        if own["width_90"] > WIDEST:
            lines.append(f"{name}: {own['width_90']:.2f} times the narrowest width")
    if result["bands_90"] is not None and not HOLDS[0] <= result["bands_90"] <= HOLDS[1]:
        lines.append(f"90 % bands hold {percent(result['bands_90'])} of unseen readings")
    return lines


def band_sentence(bands: float | None, by_state: Mapping[str, float | None]) -> str:
    """Return what the prediction bands held."""
    if bands is None:
        return "No prediction bands were computed."
    parts = ", ".join(f"{STATES[state]} {percent(v)}" for state, v in by_state.items() if v is not None)
    return f"90 % prediction bands hold {percent(bands)} of the readings of a new repetition ({parts})."


def state_table(states: Mapping[str, Mapping[str, Any]]) -> str:
    """Write a row for each state: what the intervals of each method hold, and how wide they are."""
    rows = [(STATES[state], row["recordings"], *cells(row, METHODS)) for state, row in states.items()]
    return table(("state", "recordings", *_heads(METHODS)), rows)


def rig_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Write the same for each rig, the program's intervals and those of least squares."""
    methods = ("ours", "curve_fit")
    lines = [
        (STATES[row["state"]], row["rig"], row["recordings"], percent(row["error_of_model"]), *cells(row, methods))
        for row in rows
        if row["recordings"]
    ]
    return table(("state", "rig", "recordings", "an output is no noise", *_heads(methods)), lines)


def _heads(methods: Iterable[str]) -> list[str]:
    return [head for method in methods for head in (f"{METHODS[method]}: 50 %", "90 %", "width")]


def cells(row: Mapping[str, Any], methods: Iterable[str]) -> list[str]:
    """Write shares and width of some methods."""
    texts: list[str] = []
    for method in methods:
        own = row.get(method)
        if own is None:
            texts += ["-"] * 3
        else:
            texts += [percent(own["50"]), marked(percent(own["90"]), own["90"] < HOLDS[0]), f"{own['width_90']:.2f}"]
    return texts
