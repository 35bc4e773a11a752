"""Results in folders and on pages: saved, loaded, drawn, and set side by side."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from aero_bayes.errors import InputError
from aero_bayes.figures import draws
from aero_bayes.files import ScratchFolder
from aero_bayes.report.compare import write_comparison
from aero_bayes.report.page import render
from aero_bayes.report.run_directory import RunDirectory

if TYPE_CHECKING:
    from aero_bayes.estimate.posterior import Posterior
    from aero_bayes.estimate.result import Fit
    from aero_bayes.loop.result import LoopResult

    Result: TypeAlias = Fit | Posterior | LoopResult


def load_result(directory: Path | str) -> RunDirectory:
    """Open what a command, or :func:`save`, left in a folder.

    Parameters
    ----------
    directory : path
        What was given as ``--out``.

    Returns
    -------
    RunDirectory
        ``result`` is result.json, typed; ``series`` are its curves, ``posterior`` its draws where there are any.

    Raises
    ------
    InputError
        No ``result.json`` there, or one of the files is damaged.

    Examples
    --------
    >>> run = aero_bayes.load_result("out/loop")
    >>> run.result.loop.outcome
    'extended'
    """
    return RunDirectory.read(directory)


def save(found: Result, directory: Path | str) -> Path:
    """Write a fit, a posterior or a loop into a folder, as a command does: result.json, its curves, draws and page.

    Parameters
    ----------
    found : Fit, Posterior or LoopResult
    directory : path
        It is made where it is not there.

    Returns
    -------
    Path
        The folder, for :func:`load_result`.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> aero_bayes.load_result(aero_bayes.save(fit, "out/saved")).result.parameters["k"].unit
    'N/m'
    """
    from aero_bayes.commands.commands import write_folder

    return write_folder(_result(found), Path(directory)).parent


@draws
def result_page(found: Result | RunDirectory) -> str:
    """Return the page of a result: HTML that loads nothing from elsewhere."""
    if isinstance(found, RunDirectory):
        return render(found)
    with ScratchFolder() as scratch:
        return (save(found, scratch) / "report.html").read_text("utf-8")


def compare(*found: Result | str | Path, path: str | Path = "compare.html") -> Path:
    """Write a page that sets results side by side in a table: parameters, errors, settings that differ.

    Parameters
    ----------
    *found : Fit, Posterior, LoopResult or path
        Two or more; folders are those that commands wrote.
    path : path
        The page to write.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    InputError
        For fewer than two, or more than a page can hold.

    Examples
    --------
    >>> aero_bayes.compare(fit, posterior, "out/loop", path="three.html").name
    'three.html'
    """
    with ExitStack() as stack:
        scratch = stack.enter_context(ScratchFolder())
        folders = [
            Path(one) if isinstance(one, str | Path) else save(one, scratch / f"{type(one).__name__} {k}")
            for k, one in enumerate(found, 1)
        ]
        return write_comparison(folders, path)


def _result(found: Result) -> Result:
    from aero_bayes.estimate.posterior import Posterior
    from aero_bayes.estimate.result import Fit
    from aero_bayes.loop.result import LoopResult

    if not isinstance(found, Fit | Posterior | LoopResult):
        raise InputError(
            f"expected a Fit, a Posterior, a LoopResult or the folder of a run, got {type(found).__name__}"
        )
    return found
