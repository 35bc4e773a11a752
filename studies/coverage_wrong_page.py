"""The study of wrong models as one self-contained page: a figure of coverage over width, and tables."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from coverage_page import STYLE, percent

STATES = {
    "right": "the model is right",
    "missing": "a listed law is missing",
    "mended": "the loop found the law and added it",
    "unlisted": "something acts that no law lists",
    "process_noise": "a random force drives a state",
}
METHODS = {"ours": "aero-bayes", "curve_fit": "least squares, white noise", "mcmc_white": "MCMC, white noise"}
#: Shape and colour of each method: they differ in both (colours of Okabe and Ito).
MARKS = {"ours": ("circle", "#0072b2"), "curve_fit": ("square", "#d55e00"), "mcmc_white": ("triangle", "#009e73")}
#: Coverage of a 90 % interval that is asked for, and the greatest relative width.
HOLDS, WIDEST = (0.85, 0.95), 1.5


def write_page(path: Path, result: Mapping[str, Any]) -> None:
    """Write the page whole or not at all."""
    temporary = path.with_suffix(".part")
    temporary.write_text(page(result), encoding="utf-8")
    temporary.replace(path)


def page(result: Mapping[str, Any]) -> str:
    """The page as HTML."""
    seeds = result["seeds"]
    kind = "report" if seeds["used"] == seeds["report"] else "development"
    missed = "".join(f"<li>{escape(line)}</li>" for line in misses(result)) or "<li>none</li>"
    failed = "".join(f"<li>{escape(line)}</li>" for line in result["failed"])
    bands = result["bands_90"]
    added = "; ".join(f"{name}: {', '.join(ids) or 'nothing'}" for name, ids in result["mended_by"].items())
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Intervals of wrong models</title><style>{STYLE}</style>
<h1>How far do intervals hold where the model is wrong?</h1>
<p>Outside of what is asked for ({percent(HOLDS[0])} to {percent(HOLDS[1])} of 90 % intervals hold, their width at most
{WIDEST:g} times the narrowest):</p>
<ul>{missed}</ul>
{figure(result["states"])}
{table(result["states"])}
<p>{band_sentence(bands, result["bands_90_by_state"])}</p>
<h2>What was done</h2>
<p>Four simulated rigs repeat one experiment each: the AERO, a pendulum, a motor and two reservoirs. Each repetition
draws new random levels of the inputs and new noise of the readings. What is missing has one of two sizes, three times
apart.</p>
<p>Where the model is right, and after the loop has mended it, an interval should hold the true value. Where the model
is wrong there is no true value to hold. The interval should then hold what the same fit would give if the experiment
went on for very long without noise in its readings: the best value for experiments of this kind. It was found on one
recording twenty times as long.</p>
<p>Width is relative to the narrowest interval about this estimate that could hold: 1.645 root mean square errors to
either side. Shares and widths are means over the rigs of the means over their parameters. MCMC under white noise ran on
every fifth recording.</p>
<p>The loop ran once for each rig, on two recordings in which the law was large. It added {escape(added)}. The
extended model was then fitted to every recording of the state "a listed law is missing"; parameters of the law are
among those that are asked for.</p>
<p>{result["repetitions"]} fits, {kind} seeds ({seeds["used"]}).</p>
<ul>{failed}</ul>
<h2>Rig by rig</h2>
{rig_table(result["by_rig"])}
</html>"""


def misses(result: Mapping[str, Any]) -> list[str]:
    """States in which the intervals of the program do not hold as asked for, in words."""
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
    """What the prediction bands held."""
    if bands is None:
        return "No prediction bands were computed."
    parts = ", ".join(f"{STATES[state]} {percent(v)}" for state, v in by_state.items() if v is not None)
    return f"90 % prediction bands hold {percent(bands)} of the readings of a new repetition ({parts})."


def table(states: Mapping[str, Mapping[str, Any]]) -> str:
    """A row for each state: what the intervals of each method hold, and how wide they are."""
    head = "<th>state</th><th>recordings</th>" + "".join(
        f"<th>{name}: 50 %</th><th>90 %</th><th>width</th>" for name in METHODS.values()
    )
    lines = "".join(
        f"<tr><td>{STATES[state]}</td><td>{row['recordings']}</td>{cells(row)}</tr>" for state, row in states.items()
    )
    return f"<table><tr>{head}</tr>{lines}</table>"


def rig_table(rows: list[Mapping[str, Any]]) -> str:
    """The same for each rig, the program's intervals and those of least squares."""
    head = "<th>state</th><th>rig</th><th>recordings</th><th>an output is no noise</th>" + "".join(
        f"<th>{METHODS[m]}: 50 %</th><th>90 %</th><th>width</th>" for m in ("ours", "curve_fit")
    )
    lines = "".join(
        f"<tr><td>{STATES[row['state']]}</td><td>{row['rig']}</td><td>{row['recordings']}</td>"
        f"<td>{percent(row['error_of_model'])}</td>{cells(row, ('ours', 'curve_fit'))}</tr>"
        for row in rows
        if row["recordings"]
    )
    return f"<table><tr>{head}</tr>{lines}</table>"


def cells(row: Mapping[str, Any], methods: tuple[str, ...] = tuple(METHODS)) -> str:
    """Shares and width of some methods."""
    found = ""
    for method in methods:
        own = row.get(method)
        if own is None:
            found += "<td>-</td>" * 3
            continue
        bad = " class=bad" if not HOLDS[0] <= own["90"] else ""
        found += f"<td>{percent(own['50'])}</td><td{bad}>{percent(own['90'])}</td><td>{own['width_90']:.2f}</td>"
    return found


def figure(states: Mapping[str, Mapping[str, Any]]) -> str:
    """Share of 90 % intervals that hold, by state and method."""
    left, right, top, step = 290, 20, 26, 40
    width, height = 760, top + step * len(STATES) + 56
    bottom = top + step * len(STATES)

    def across(share: float) -> float:
        return left + (width - left - right) * share

    low, high = across(HOLDS[0]), across(HOLDS[1])
    parts = [
        f'<rect x="{low:.1f}" y="{top}" width="{high - low:.1f}" height="{bottom - top}" fill="var(--line)"/>',
        f'<path d="M{across(0.9):.1f} {top}V{bottom}" stroke="var(--ink)" stroke-dasharray="4 3"/>',
        f'<path d="M{left} {bottom}H{width - right}" stroke="var(--ink)"/>',
    ]
    for k in range(6):
        parts.append(text(across(0.2 * k), bottom + 18, f"{20 * k} %", "middle"))
    parts.append(text(0.5 * (left + width - right), bottom + 40, "share of 90 % intervals that hold", "middle"))
    for k, (state, name) in enumerate(STATES.items()):
        y = top + step * (k + 0.5)
        parts.append(text(left - 14, y + 5, name, "end"))
        for j, method in enumerate(METHODS):
            own = states.get(state, {}).get(method)
            if own is not None:
                parts.append(mark(method, across(own["90"]), y + 9 * (j - 1)))
    for j, (method, name) in enumerate(METHODS.items()):
        parts += [mark(method, 20 + 245 * j, 10), text(32 + 245 * j, 15, name, "start")]
    said = "Share of 90 % intervals that hold, by state and method; the table has the numbers"
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" width="100%" style="max-width:{width}px" role="img" '
        f'aria-label="{said}">{"".join(parts)}</svg><figcaption>Grey: what is asked for. Dashed: 90 %.</figcaption>'
        "</figure>"
    )


def text(x: float, y: float, words: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="14" fill="var(--ink)" text-anchor="{anchor}">{words}</text>'


def mark(method: str, x: float, y: float) -> str:
    """A method's mark, centred at a point."""
    shape, colour = MARKS[method]
    if shape == "circle":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>'
    if shape == "square":
        return f'<rect x="{x - 4.5:.1f}" y="{y - 4.5:.1f}" width="9" height="9" fill="{colour}"/>'
    return f'<path d="M{x:.1f} {y - 5.5:.1f}l5.5 10h-11z" fill="{colour}"/>'
