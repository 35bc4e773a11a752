"""The plotting backend: how results get their figures without importing the code that draws them.

``plots`` imports the classes of results, so they cannot import ``plots``. They ask the backend instead. The package
registers ``plots`` as the backend (``aero_bayes/__init__.py``). Matplotlib is loaded with the first figure.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


class PlotBackend(Protocol):
    """One function for each figure, as ``aero_bayes.report`` has them.

    ``figure`` is what is drawn into: a figure, or the axes whose place is taken; a new figure by default. ``dark``
    chooses colours for a dark background."""

    def recording_figure(
        self, recording: Any, *, figure: Figure | Axes | None = None, dark: bool = False
    ) -> Figure: ...

    def fit_figure(
        self, fit: Any, recording: str | None = None, *, figure: Figure | Axes | None = None, dark: bool = False
    ) -> Figure: ...

    def bands_figure(
        self, posterior: Any, recording: str | None = None, *, figure: Figure | Axes | None = None, dark: bool = False
    ) -> Figure: ...

    def pairs_figure(
        self,
        draws: Mapping[str, NDArray[np.float64]],
        units: Mapping[str, str],
        parameters: Sequence[str] | None = None,
        *,
        figure: Figure | Axes | None = None,
        dark: bool = False,
    ) -> Figure: ...

    def prediction_figure(
        self, prediction: Any, *, figure: Figure | Axes | None = None, dark: bool = False
    ) -> Figure: ...

    def loop_figure(self, loop: Any, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure: ...

    def rounds_figure(self, loop: Any, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure: ...

    def loop_page(self, loop: Any) -> str: ...

    def scene_figure(self, run: Any, *, figure: Figure | Axes | None = None, dark: bool = False) -> Figure: ...

    def run_figure(
        self, run: Any, recording: str | None = None, *, figure: Figure | Axes | None = None, dark: bool = False
    ) -> Figure: ...


_loaders: list[Callable[[], PlotBackend]] = []


def register_plot_backend(load: Callable[[], PlotBackend]) -> None:
    """Make the backend that ``load`` returns the one in use; ``load`` is called when a figure is drawn."""
    _loaders[:] = [load]


def plot_backend() -> PlotBackend:
    """Return the registered backend."""
    return _loaders[-1]()


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
