"""Figures and pages of results: what draws them registers itself here, so that results know no report."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from aero_bayes.files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Method = TypeVar("Method", bound=Callable[..., object])
Drawer = TypeVar("Drawer", bound=Callable[..., object])

#: What draws a figure or a page, by its name; and what is called with a name to import it, by the package.
_DRAWERS: dict[str, Callable[..., Any]] = {}
IMPORTERS: list[Callable[[str], None]] = []


def draws(drawer: Drawer) -> Drawer:
    """Register a function as what draws the figure or the page of its name."""
    _DRAWERS[drawer.__name__] = drawer
    return drawer


def _drawer(name: str) -> Callable[..., Any]:
    for importer in IMPORTERS if name not in _DRAWERS else ():
        importer(name)
    return _DRAWERS[name]


def page_of(found: object) -> str:
    """Return the page of a result: HTML that loads nothing from elsewhere."""
    page: str = _drawer("result_page")(found)
    return page


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
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_whole(path, page_of(self))


def drawn(name: str, *what: Any, figure: Figure | Axes | None, dark: bool) -> Figure:
    """Draw the figure of a name into a figure, or in the place of axes; into a new figure by default."""
    found: Figure = _drawer(name)(*what, figure=figure, dark=dark)
    return found


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
