"""One self-contained page of a study: paragraphs, tables of pandas, figures of matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from html import escape
from pathlib import Path

import matplotlib
import pandas
from matplotlib.figure import Figure

from aero_bayes.files import whole_file

STYLE = """
:root { color-scheme: light dark; --bad: light-dark(#b3261e, #ff8a80) }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: auto; padding: 1rem }
table { border-collapse: collapse; display: block; overflow-x: auto } td { white-space: nowrap }
td, th { padding: .2rem .6rem; border-bottom: 1px solid #8886; text-align: right }
td:first-child, th:first-child { text-align: left } .bad { color: var(--bad); font-weight: 600 }
figure { margin: 1rem 0 } svg { max-width: 100%; height: auto }
"""
#: Text stays text, and one ink that is read on a light and on a dark ground.
LOOK = {
    "svg.fonttype": "none", "font.size": 9, "savefig.transparent": True, "axes.spines.top": False,
    "axes.spines.right": False,
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), "#7a7f87"),
}  # fmt: skip


def write_page(path: Path, title: str, parts: Sequence[str]) -> None:
    """Write the page whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(page(title, parts), encoding="utf-8")


def page(title: str, parts: Sequence[str]) -> str:
    """Return the text of a page; ``parts`` are pieces of HTML below its heading."""
    return (
        '<!doctype html>\n<html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title><style>{STYLE}</style>\n<h1>{escape(title)}</h1>\n" + "\n".join(parts)
    )


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Write a table whose cells may be HTML."""
    frame = pandas.DataFrame([list(map(str, row)) for row in rows], columns=list(columns))
    return str(frame.to_html(index=False, border=0, escape=False))


def marked(text: str, bad: bool) -> str:
    """Mark what is not as it should be."""
    return f'<span class="bad">{text}</span>' if bad else text


def listed(lines: Sequence[str]) -> str:
    """Write a list."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines or ["none"]) + "</ul>"


def drawn(figure: Figure, label: str, caption: str = "") -> str:
    """Write a figure as SVG with a label for those who cannot see it."""
    stream = io.StringIO()
    with matplotlib.rc_context(LOOK):
        figure.savefig(stream, format="svg")
    svg = stream.getvalue().partition("<svg ")[2]
    return f'<figure><svg role="img" aria-label="{escape(label)}" {svg}<figcaption>{caption}</figcaption></figure>'


def percent(share: float) -> str:
    """Write a share in per cent."""
    return f"{100 * share:.1f} %"
