"""One rig is one task: its recordings and settings go in, its run directory and its row come out."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.config import Config
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.fleet.parcels import Parcel, local_folder
from aero_bayes.fleet.rigs import Rig, Work
from aero_bayes.fleet.row import fleet_row
from aero_bayes.fleet.runner import failure
from aero_bayes.fleet.table import Row
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.simulation import Model
from aero_bayes.workflow.commands import run_all, run_close_loop, run_fit, run_posterior
from aero_bayes.workflow.job import RunOptions, fit_parameters

#: Folder of the rigs' run directories, and what each says while it runs.
RUNS, LOG = "rigs", "log.txt"
#: What a row is, so that rows of an older kind are computed anew.
KIND = 1

_COMMANDS: Mapping[Work, Callable[[Rig, RunOptions], None]] = {
    "fit": lambda rig, options: run_fit(rig.train, options),
    "posterior": lambda rig, options: run_posterior(rig.train, options),
    "loop": lambda rig, options: run_close_loop(rig.train, rig.test, options),
    "all": lambda rig, options: run_all(rig.train, rig.test, options),
}


@dataclass(frozen=True)
class RigTask:
    """Everything that a worker needs; the files must be readable on its machine.

    Parameters
    ----------
    rig : Rig
    config : Config
    work : {"fit", "posterior", "loop", "all"}
    out : Path
        The fleet's folder.
    seed : int
        The rig's own.
    model : Parcel, optional
        The FMU, or the one that was built from the class.
    """

    rig: Rig
    config: Config
    work: Work
    out: Path
    seed: int
    model: Parcel | None

    @property
    def key(self) -> str:
        """The rig's name."""
        return self.rig.name

    @property
    def made_of(self) -> str:
        """Fingerprint of all that its row depends on; recordings by size and time of change."""
        files = [(path.name, *_stamp(path)) for path in (*self.rig.train, *self.rig.test)]
        sha256 = self.model.sha256 if self.model is not None else ""
        facts = (KIND, self.config.model_dump_json(exclude={"model"}), self.work, self.seed, sha256, files)
        return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return -1, -1
    return found.st_size, found.st_mtime_ns


def attempt(task: RigTask) -> Row:
    """Work on a rig; one that cannot be is a row with its reason.

    The rig's own core is the only one that it uses. Its simulations run in a process of their own that can be killed.
    """
    folder = task.out / RUNS / task.rig.name
    config = task.config
    built = task.model.here() if task.model is not None else None
    if built is not None and config.model.fmu is not None:
        config, built = config.model_copy(update={"model": config.model.model_copy(update={"fmu": built})}), None
    options = RunOptions(
        folder, config=config, seed=task.seed, workers=1, quiet=True, built=built, cache=local_folder() / "loop"
    )
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with (folder / LOG).open("w", encoding="utf-8") as log, _said_to(log):
            _COMMANDS[task.work](task.rig, options)
    except (InputError, CannotFinishError) as error:
        return failure(task.key, str(error))
    run = RunDirectory.read(folder)
    model = Model.load(task.model.here()) if task.model is not None else None
    return fleet_row(task.key, run.result, fit_parameters(model, config) if model is not None else ())


def _said_to(log: object) -> contextlib.ExitStack:
    """Redirect the output of a command to the log of the rig."""
    stack = contextlib.ExitStack()
    stack.enter_context(contextlib.redirect_stdout(log))  # type: ignore[type-var]
    stack.enter_context(contextlib.redirect_stderr(log))  # type: ignore[type-var]
    return stack
