"""Figures and pages of results: how a result finds what draws it, and what every figure takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from aero_bayes.files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class HasPage:
    """A result that has a page."""

    def to_html(self, path: Path | str) -> Path:
        """Write the page: a single file that loads nothing from elsewhere.

        Parameters
        ----------
        path : path
            Its folder is made where it is not there.

        Returns
        -------
        Path

        Examples
        --------
        >>> fit.to_html("fit.html").name
        'fit.html'
        """
        page: str = import_module("aero_bayes.library").page_of(self)
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_whole(path, page)


def drawn(name: str, *what: Any, figure: Figure | Axes | None, dark: bool) -> Figure:
    """Draw a figure by its file in ``report`` and its name; results cannot import what uses their classes.

    ``figure`` is what is drawn into: a figure, or the axes whose place is taken; a new one by default."""
    file, _, function = name.partition(".")
    found: Figure = getattr(import_module(f"aero_bayes.report.{file}"), function)(*what, figure=figure, dark=dark)
    return found


Method = TypeVar("Method", bound=Callable[..., object])
_FIGURE_PARAMETERS = """ax : matplotlib.axes.Axes, optional
    Axes whose place in a larger figure it takes.
figure : matplotlib.figure.Figure, optional
    To draw into; a new one by default.
dark : bool
    Colours for a dark background.
"""


def describe_figure_parameters(method: Method) -> Method:
    """Add to a method's docstring the parameters that each figure takes, and the figure that it returns."""
    title, blank, rest = inspect.cleandoc(method.__doc__ or "").partition("\n\n")
    heads = ("Parameters\n-", "Returns\n-", "Raises\n-", "Examples\n-")
    sections = rest.split("\n\n") if blank else []
    at = next((k for k, s in enumerate(sections) if s.startswith(heads)), len(sections))
    text, sections = [title, *sections[:at]], sections[at:]
    own = sections.pop(0) if sections and sections[0].startswith("Parameters") else "Parameters\n----------"
    if not sections or not sections[0].startswith("Returns"):
        sections.insert(0, "Returns\n-------\nmatplotlib.figure.Figure")
    method.__doc__ = "\n\n".join([*text, f"{own}\n{_FIGURE_PARAMETERS.rstrip()}", *sections])
    return method
