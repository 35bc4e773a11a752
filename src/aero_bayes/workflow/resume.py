"""Keep the checkpoint of a command in its folder until it is done, for ``--resume``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.files import CHECKPOINT, one_run_at_a_time
from aero_bayes.workflow.job import Job
from aero_bayes.workflow.results import versions


@contextmanager
def resumable(job: Job, command: str) -> Iterator[Checkpoint]:
    """Yield the checkpoint of a command: read with ``--resume``, removed once the command is done."""
    options = job.options
    path = options.out / CHECKPOINT
    data = [recording.to_dict() for recording in job.read]
    settings = job.config.model_dump(exclude={"posterior": True, "loop": {"max_minutes"}})
    identity = digest(command, versions(), options.seed, job.engine, job.model.sha256, data, settings)
    with one_run_at_a_time(options.out):
        if not options.resume:
            path.unlink(missing_ok=True)
        yield Checkpoint(path, identity)
        path.unlink(missing_ok=True)
