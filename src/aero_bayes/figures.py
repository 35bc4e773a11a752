"""Figures and pages of results: what draws them registers itself here, so that results know no report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from aero_bayes.errors import InputError
from aero_bayes.files import write_whole

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


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure of the page by itself. Notebooks show it; :meth:`save` writes it.

    Parameters
    ----------
    svg : str
        The drawing, a whole SVG file.
    panels : tuple
        What is drawn over time: each panel has a title, and layers with their x and y.

    Examples
    --------
    >>> picture = fit.plot()
    >>> picture.save("fit.svg").name
    'fit.svg'
    >>> picture.panels[-1].title
    'residual of position: measured minus model (mm)'
    """

    svg: str
    panels: tuple[Any, ...] = ()

    def save(self, path: Path | str) -> Path:
        """Write the SVG file; its folder is made where it is not there."""
        path = Path(path)
        if path.suffix.lower() != ".svg":
            raise InputError(f"{path}: a figure is written as SVG, expected a name that ends in .svg")
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_whole(path, self.svg)

    def _repr_svg_(self) -> str:
        return self.svg


def drawn(name: str, *what: Any, dark: bool) -> Picture:
    """Draw the figure of a name."""
    found: Picture = _drawer(name)(*what, dark=dark)
    return found
