"""One rig is one task: its recordings and settings go in, its run directory and its row come out."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.config import Config
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.fleets.rigs import Rig, Work
from aero_bayes.fleets.row import fleet_row
from aero_bayes.fleets.runner import failure
from aero_bayes.fleets.table import Row
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.simulation import Model
from aero_bayes.workflow.commands import run_all, run_close_loop, run_fit, run_posterior
from aero_bayes.workflow.job import RunOptions, fit_parameters

#: Folder of the rigs' run directories, and what each says while it runs.
RUNS, LOG = "rigs", "log.txt"
#: What a row is, so that rows of an older kind are computed anew.
KIND = 3
_COMMANDS: Mapping[Work, Callable[[Rig, RunOptions], None]] = {
    "fit": lambda rig, options: run_fit(rig.train, options),
    "posterior": lambda rig, options: run_posterior(rig.train, options),
    "loop": lambda rig, options: run_close_loop(rig.train, rig.test, options),
    "all": lambda rig, options: run_all(rig.train, rig.test, options),
}


@dataclass(frozen=True)
class RigTask:
    """Everything that a worker needs; the files must be readable on its machine."""

    rig: Rig
    config: Config | str
    work: Work
    out: Path
    seed: int
    model: Path | None = None

    @property
    def key(self) -> str:
        """The rig's name."""
        return self.rig.name

    @property
    def made_of(self) -> str:
        """Fingerprint of all that its row depends on; recordings by size and time of change."""
        paths = (*self.rig.train, *self.rig.test)
        files = [(p.name, (s := p.stat()).st_size, s.st_mtime_ns) if p.exists() else p.name for p in paths]
        config = self.config if isinstance(self.config, str) else self.config.model_dump_json(exclude={"model"})
        facts = (KIND, config, self.work, self.seed, self.model.stem if self.model is not None else "", files)
        return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def attempt(task: RigTask) -> Row:
    """Work on a rig; one that cannot be fitted is a row with its reason.

    The rig's own core is the only one that it uses. Its simulations run in a process of their own that can be killed.
    """
    config, folder = task.config, task.out / RUNS / task.rig.name
    if isinstance(config, str):
        return failure(task.key, config)
    fmu = built = task.model
    if fmu is not None and hashlib.sha256(fmu.read_bytes()).hexdigest() != fmu.stem:
        return failure(task.key, f"{fmu}: has changed since the fleet was started")
    if fmu is not None and config.model.fmu is not None:
        config, built = config.model_copy(update={"model": config.model.model_copy(update={"fmu": fmu})}), None
    # Rigs of one model share the extended models that their loops export.
    cache = fmu.parent / "loop" if fmu is not None else None
    options = RunOptions(folder, config=config, seed=task.seed, workers=1, quiet=True, built=built, cache=cache)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with (
            (folder / LOG).open("w", encoding="utf-8") as log,
            contextlib.redirect_stdout(log),
            contextlib.redirect_stderr(log),
        ):
            _COMMANDS[task.work](task.rig, options)
    except (InputError, CannotFinishError) as error:
        return failure(task.key, str(error))
    parameters = fit_parameters(Model.load(fmu), config) if fmu is not None else ()
    return fleet_row(task.key, RunDirectory.read(folder).result, parameters)
