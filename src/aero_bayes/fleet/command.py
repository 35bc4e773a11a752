"""``aero-bayes fleet``: a progress bar, and in the end one sentence."""

from __future__ import annotations

from pathlib import Path

import click

from aero_bayes.files import one_run_at_a_time
from aero_bayes.fleet.executors import open_executor
from aero_bayes.fleet.rigs import read_fleet
from aero_bayes.fleet.whole import fleet
from aero_bayes.workflow.progress import ProgressBar


def run_fleet(config: Path, out: Path, *, dask: str | None, seed: int, workers: int | None, quiet: bool) -> None:
    """Fit all rigs of a file and print where the results are."""
    total = sum(1 for _ in read_fleet(config).rigs)
    done = 0
    with one_run_at_a_time(out), open_executor(dask, workers) as executor, ProgressBar(quiet) as bar:

        def progress(count: int) -> None:
            nonlocal done
            done += count
            bar("rigs", done / total, f"{done} of {total}")

        progress(0)
        try:
            found = fleet(config, out, seed=seed, executor=executor, progress=progress)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"run the same command again to continue from {out / 'rigs.sqlite'}") from None
    click.echo(found.verdict.text.replace("`", "") if found.verdict else "")
    click.echo(f"wrote {out / 'fleet.json'} and {out / 'report.html'}")
