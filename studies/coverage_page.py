"""The calibration study as one page: coverage tables and rank histograms."""

from __future__ import annotations

from html import escape
from typing import Any

import matplotlib.pyplot as plt
from scipy.stats import binom

from aero_bayes.report import symbol
from study_page import LOOK, drawn, listed, marked, percent, table

TITLE = "Do the intervals hold what they promise?"
KINDS = ("white", "correlated")


def parts(result: dict[str, Any]) -> list[str]:
    """Return the pieces of the page."""
    tests, gap = result["rank_uniformity_tests"], result["importance_against_sampler"]
    pooled = [(kind, result["recordings_by_noise"][kind], *map(percent, result[kind].values())) for kind in KINDS]
    cells = list(dict.fromkeys(row["cell"] for row in result["rows"]))
    return [
        f"<p>Parameters further from nominal than two binomial standard errors, of {2 * tests} figures (one in twenty "
        "is expected by chance):</p>",
        listed(result["outside_two_standard_errors"]),
        f"<p>Over {result['recordings']} simulated recordings ({result['studies']} studies, {result['failed']} "
        "failed), truths drawn from the prior, identified parameters pooled:</p>",
        table(("noise", "recordings", "50 % interval holds", "90 % interval holds"), pooled),
        f"<p>Smallest p-value of {tests} tests of uniform ranks: {result['rank_uniformity_p_min']:.3g} (about "
        f"{1 / max(tests + 1, 2):.2g} is expected of the smallest when all is well).</p>",
        "<p>The posterior is importance sampling from the Laplace approximation; the sampler took over in "
        f"{result['sampled_instead']} studies where its diagnostic said no, and was run beside it in {gap['studies']}: "
        f"the largest difference in rank was {gap['largest_rank_gap']:.3f}. Seed {result['seed']}.</p>",
        "<p>Histograms: where the truth ranks in the posterior, by tenths. Solid line: the same number in every tenth; "
        "between the dotted lines 98 % of the bars lie if the intervals are right. Bars that pile up at both ends say "
        "that intervals are too narrow, in the middle that they are too wide, at one end that the estimate is "
        "biased.</p>",
        *(
            section(f"{kind} noise, all counted", [r for r in result["by_noise"] if r["cell"] == kind])
            for kind in KINDS
        ),
        "<h2>Cell by cell</h2><p>Smaller numbers, wider errors; further from nominal than two of them:</p>",
        listed(result["outside_two_standard_errors_by_cell"]),
        *(section(name, [r for r in result["rows"] if r["cell"] == name]) for name in cells),
    ]


def section(name: str, rows: list[dict[str, Any]]) -> str:
    """Write one cell: its table and histograms."""
    if not rows:
        return ""
    lines = [
        (symbol(r["parameter"]), r["studies"], held(r, 0.5), held(r, 0.9), f"{r['rank_uniformity_p']:.3g}")
        for r in rows
    ]
    note = "<p>Not counted above: the noise model is known to describe this noise only roughly.</p>"
    return (
        f"<h2>{escape(name)}</h2>{'' if rows[0]['counted'] else note}"
        + table(("parameter", "studies", "50 %", "90 %", "p, ranks uniform"), lines)
        + histograms(rows)
    )


def held(row: dict[str, Any], level: float) -> str:
    """Write one coverage with its standard error; marked where it is off by more than two of them."""
    share, error = row[str(round(100 * level))], (level * (1.0 - level) / row["studies"]) ** 0.5
    return marked(f"{percent(share)} ± {100 * error:.1f}", abs(share - level) > 2.0 * error)


def histograms(rows: list[dict[str, Any]]) -> str:
    """Draw ranks in tenths, with lines between which 98 % of the bars lie when ranks are uniform."""
    with plt.rc_context(LOOK):
        figure, axes = plt.subplots(-(-len(rows) // 4), 4, figsize=(9.0, 1.6 * -(-len(rows) // 4)), squeeze=False)
        for ax, row in zip(axes.flat, rows, strict=False):
            counts, total = row["ranks"], row["studies"]
            ax.bar([(k + 0.5) / len(counts) for k in range(len(counts))], counts, 0.9 / len(counts), color="#3b6ea8")
            ax.axhline(total / len(counts), color="#7a7f87")
            for limit in binom.interval(0.98, total, 1.0 / len(counts)):
                ax.axhline(limit, color="#7a7f87", linestyle=":")
            ax.set_title(row["parameter"])
        for ax in axes.flat[len(rows) :]:
            ax.remove()
        figure.tight_layout()
        text = "; ".join(f"{row['parameter']}: {', '.join(map(str, row['ranks']))}" for row in rows)
        plt.close(figure)
    return drawn(figure, f"Ranks of the true value in its posterior, by tenths: {text}", "ranks, 0 to 1")
