"""The results of a finished run, and its page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from aero_bayes.errors import InputError
from aero_bayes.report import write_run_page
from aero_bayes.report.run_directory import RunDirectory

if TYPE_CHECKING:
    from aero_bayes.estimate.result import Fit
    from aero_bayes.loop.result import LoopResult
    from aero_bayes.sampling.posterior import Posterior


def open_run(directory: Path | str) -> RunDirectory:
    """Open what a command left in its output folder.

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
    >>> run = aero_bayes.open_run("out/loop")
    >>> run.result.loop.outcome
    'extended'
    """
    return RunDirectory.read(directory)


def write_report(found: Fit | Posterior | LoopResult | str | Path, path: str | Path | None = None) -> Path:
    """Write the page of a fit, a posterior or a loop, or draw that of a finished run again.

    Parameters
    ----------
    found : Fit, Posterior, LoopResult or path
        What was found, or the folder that a command wrote with ``--out``.
    path : path, optional
        The page to write, where no folder is given; that of a folder is its ``report.html``.

    Returns
    -------
    Path
        The page: a single file that loads nothing from elsewhere.

    Raises
    ------
    InputError
        No ``result.json`` in the folder, or one of the files is damaged.

    Examples
    --------
    >>> aero_bayes.write_report(fit, "fit.html").name
    'fit.html'
    >>> aero_bayes.write_report("out/loop").name
    'report.html'
    """
    from aero_bayes.estimate.result import Fit
    from aero_bayes.loop.result import LoopResult
    from aero_bayes.sampling.posterior import Posterior
    from aero_bayes.workflow.commands import write_page  # a second of imports that a finished run does not need

    if isinstance(found, str | Path):
        return write_run_page(found)
    if not isinstance(found, Fit | Posterior | LoopResult):
        raise InputError(
            f"expected a Fit, a Posterior, a LoopResult or the folder of a run, got {type(found).__name__}"
        )
    if path is None:
        raise InputError("path: say where the page goes, such as fit.html")
    return write_page(found, Path(path))
