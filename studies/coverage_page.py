"""The calibration study as one self-contained page: coverage tables and rank histograms."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from scipy.stats import binom

from aero_bayes.report import symbol

STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #fff; --bar: #3b6ea8; --bad: #b3261e; --line: #d5d9de }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e8eb; --paper: #15181c; --bar: #7aa7dd; --bad: #ff8a80; --line: #3a4048 } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 62rem; margin: auto; padding: 1rem }
table { border-collapse: collapse; display: block; overflow-x: auto } td { white-space: nowrap } td, th { padding: .2rem .6rem; border-bottom: 1px solid var(--line); text-align: right }
td:first-child, th:first-child { text-align: left } .bad { color: var(--bad); font-weight: 600 }
.grid { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1rem 0 } figure { margin: 0 } figcaption { font-size: .85rem }
"""  # noqa: E501


def write_coverage_page(path: Path, result: dict[str, Any]) -> None:
    """Write the page whole or not at all."""
    temporary = path.with_suffix(".part")
    temporary.write_text(page(result))
    temporary.replace(path)


def page(result: dict[str, Any]) -> str:
    """Return the text of the page."""
    missed = result["outside_two_standard_errors"]
    tests, p_min = result["rank_uniformity_tests"], result["rank_uniformity_p_min"]
    head = "".join(f"<th>{t}</th>" for t in ("noise", "recordings", "50 % interval holds", "90 % interval holds"))
    pooled = "".join(
        f"<tr><td>{kind}</td><td>{result['recordings_by_noise'][kind]}</td><td>{percent(result[kind]['50'])}</td><td>{percent(result[kind]['90'])}</td></tr>"
        for kind in ("white", "correlated")
    )
    by_noise = "".join(
        section(f"{kind} noise, all counted", [r for r in result["by_noise"] if r["cell"] == kind])
        for kind in ("white", "correlated")
    )
    by_cell = "".join(f"<li>{escape(line)}</li>" for line in result["outside_two_standard_errors_by_cell"])
    cells = list(dict.fromkeys(row["cell"] for row in result["rows"]))
    body = "".join(section(name, [r for r in result["rows"] if r["cell"] == name]) for name in cells)
    gap = result["importance_against_sampler"]
    listed = "".join(f"<li>{escape(line)}</li>" for line in missed) or "<li>none</li>"
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Calibration of the intervals</title><style>{STYLE}</style>
<h1>Do the intervals hold what they promise?</h1>
<p>Parameters further from nominal than two binomial standard errors, of {2 * tests} figures (one in twenty is expected
by chance):</p>
<ul>{listed}</ul>
<p>Over {result["recordings"]} simulated recordings ({result["studies"]} studies, {result["failed"]} failed), truths
drawn from the prior, identified parameters pooled:</p>
<table><tr>{head}</tr>{pooled}</table>
<p>Smallest p-value of {tests} tests of uniform ranks: {p_min:.3g} (about {1 / max(tests + 1, 2):.2g} is expected of the
smallest when all is well).</p>
<p>The posterior is importance sampling from the Laplace approximation; the sampler took over in
{result["sampled_instead"]} studies where its diagnostic said no, and was run beside it in {gap["studies"]}: the largest
difference in rank was {gap["largest_rank_gap"]:.3f}. Seed {result["seed"]}.</p>
<p>Histograms: where the truth ranks in the posterior, by tenths. Solid line: the same number in every tenth; between
the dotted lines 98 % of the bars lie if the intervals are right. Bars that pile up at both ends say that intervals are
too narrow, in the middle that they are too wide, at one end that the estimate is biased.</p>
{by_noise}
<h2>Cell by cell</h2>
<p>Smaller numbers, wider errors; further from nominal than two of them:</p><ul>{by_cell or "<li>none</li>"}</ul>
{body}</html>"""


def section(name: str, rows: list[dict[str, Any]]) -> str:
    """Write one cell: its table and histograms."""
    if not rows:
        return ""
    head = "".join(f"<th>{t}</th>" for t in ("parameter", "studies", "50 %", "90 %", "p, ranks uniform"))
    lines = "".join(
        f"<tr><td>{symbol(r['parameter'])}</td><td>{r['studies']}</td>{held(r, 0.5)}{held(r, 0.9)}"
        f"<td>{r['rank_uniformity_p']:.3g}</td></tr>"
        for r in rows
    )
    note = (
        ""
        if rows[0]["counted"]
        else "<p>Not counted above: the noise model is known to describe this noise only roughly.</p>"
    )
    figures = "".join(histogram(r) for r in rows)
    table = f"<table><tr>{head}</tr>{lines}</table>"
    return f"<h2>{escape(name)}</h2>{note}{table}<div class='grid'>{figures}</div>"


def held(row: dict[str, Any], level: float) -> str:
    """Write the table cell of one coverage with its standard error; marked where it is off by more than two of them."""
    share, count = row[str(round(100 * level))], row["studies"]
    bad = abs(share - level) > 2.0 * (level * (1.0 - level) / count) ** 0.5
    error = 100.0 * (level * (1.0 - level) / count) ** 0.5
    return f"<td{' class=bad' if bad else ''}>{percent(share)} ± {error:.1f}</td>"


def percent(share: float) -> str:
    """Write a share in per cent."""
    return f"{100 * share:.1f} %"


def histogram(row: dict[str, Any]) -> str:
    """Draw ranks in tenths, with lines between which 98 % of the bars lie when ranks are uniform."""
    counts, total, width, height = row["ranks"], row["studies"], 200, 90
    low, high = (float(v) for v in binom.interval(0.98, total, 1.0 / len(counts)))
    scale = height / (1.1 * max(*counts, high, 1))
    step = width / len(counts)
    bars = "".join(
        f'<rect x="{k * step + 1:.1f}" y="{height - c * scale:.1f}" width="{step - 2:.1f}" height="{c * scale:.1f}" '
        'fill="var(--bar)"/>'
        for k, c in enumerate(counts)
    )
    limits = "".join(
        f'<path d="M0 {height - v * scale:.1f}H{width}" stroke="var(--ink)" stroke-dasharray="{dash}"/>'
        for v, dash in ((low, "2 3"), (high, "2 3"), (total / len(counts), "none"))
    )
    text = f"Ranks of the true {row['parameter']} in its posterior, by tenths: {', '.join(map(str, counts))}"
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
        f'aria-label="{escape(text)}">{bars}{limits}</svg>'
        f"<figcaption>rank of {symbol(row['parameter'])}, 0 to 1</figcaption></figure>"
    )
