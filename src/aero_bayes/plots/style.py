"""The look of the library's figures: the colours of the page's style sheet, its type sizes, no frame."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any


@cache
def palette(dark: bool = False) -> Mapping[str, str]:
    """Return colours by the names that figures draw with, as the page has them on a light or a dark ground.

    Parameters
    ----------
    dark : bool

    Returns
    -------
    mapping of str to str
        ``ground``, ``ink``, ``muted``, ``rule``, ``measured``, ``accent``, ``warm`` and ``s1`` to ``s6`` (after Okabe
        and Ito, 2008: told apart by colour-blind readers), each as ``#rrggbb``.

    Examples
    --------
    >>> from aero_bayes.plots import palette
    >>> palette()["accent"], palette(dark=True)["ground"]
    ('#0067a8', '#11161b')
    """
    sheet = files("aero_bayes.report") / "templates" / "style.css.jinja"
    themes = re.findall(r":root \{(.*?)\}", sheet.read_text("utf-8"), flags=re.S)
    return MappingProxyType(dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", themes[1 if dark else 0])))


def settings(colours: Mapping[str, str]) -> dict[Any, Any]:
    """Return matplotlib's settings for one figure; they are not set for others."""
    return {
        "font.size": 9.0,
        "text.color": colours["ink"],
        "axes.titlesize": 9.5,
        "axes.titlelocation": "left",
        "axes.labelcolor": colours["muted"],
        "axes.edgecolor": colours["muted"],
        "axes.facecolor": colours["ground"],
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.grid.axis": "y",
        "axes.axisbelow": True,
        "grid.color": colours["rule"],
        "grid.linewidth": 0.7,
        "xtick.color": colours["muted"],
        "ytick.color": colours["muted"],
        "legend.frameon": False,
        "figure.facecolor": colours["ground"],
        "savefig.facecolor": colours["ground"],
        "path.simplify": True,
    }


def mathematics(words: str) -> str:
    """Write ``R_a`` with a subscript, as matplotlib sets it."""
    escaped = words.replace("$", r"\$")
    return re.sub(r"(?<![\w.])([A-Za-zΑ-ω]{1,2})_([A-Za-z0-9]{1,6})(?![\w.])", r"$\\mathrm{\1_{\2}}$", escaped)
