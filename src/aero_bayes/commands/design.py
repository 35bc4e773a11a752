"""``aero-bayes design``: the next experiment, as a signal to play, and what is expected of it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from aero_bayes.commands.commands import fit_job, fit_part, write_page
from aero_bayes.commands.context import resumable
from aero_bayes.commands.job import Job, RunOptions, open_job
from aero_bayes.errors import InputError
from aero_bayes.estimate.information import Limits, SearchSettings
from aero_bayes.estimate.propose import Design, default_limits, expected_outputs, propose_experiment
from aero_bayes.estimate.result import Fit
from aero_bayes.progress import ProgressBar
from aero_bayes.report.results import Series, merge

Json = dict[str, Any]

#: The signal to play, in the run's folder.
SIGNAL_FILE = "next_experiment.csv"


def run_design(
    files: Sequence[Path], options: RunOptions, *, aim: tuple[str, ...], duration: float, rate_hz: float | None,
    amplifier: float | None, travel: dict[str, float],
) -> None:  # fmt: skip
    """Fit, propose the experiment, and write signal, result and page; ``aim``: parameters, by default weak ones."""
    began = time.perf_counter()
    Limits(1.0 if amplifier is None else amplifier, travel)
    job = open_job(files, options)
    _check_request(job, aim, duration, rate_hz, travel)
    with resumable(job, "design") as checkpoint:
        with ProgressBar(options.quiet) as progress:
            base = fit_job(job, progress, checkpoint)
            usual = default_limits(base)
            given: Json = {
                "duration": duration,
                "rate_hz": rate_hz,
                "limits": Limits(amplifier or usual.amplifier, {**usual.travel, **travel}),
                "settings": SearchSettings(seed=options.seed),
                "workers": options.workers,
                "progress": progress,
            }
            design = propose_experiment(base, targets=aim or None, **given)
            plan = _plan(design, base, given)
        about = {"file": SIGNAL_FILE, "unit": base.calibration.model.units[design.input]}
        part: Json = {"design": design.to_dict() | about, "verdict": _verdict(design)}
        result, series = fit_part(job, base)
        design.write_csv(options.out / SIGNAL_FILE)
        closing: Json = {"command": "design", "seconds": time.perf_counter() - began}
        page, _ = write_page(job, merge(result, part, closing), series | plan)
        click.echo(part["verdict"]["text"].replace("`", ""))
        click.echo(f"wrote {options.out / SIGNAL_FILE}, {options.out / 'result.json'} and {page}")


def _plan(proposal: Design, base: Fit, given: Json) -> Series:
    """Return ``plan/...``: the signal and what the fit expects of it."""
    series: Series = {"plan/time": proposal.time, f"plan/input/{proposal.input}": proposal.values}
    for output, band in expected_outputs(proposal, base, given["settings"], given["workers"]).items():
        for part, values in zip(("lower", "middle", "upper"), band, strict=True):
            series[f"plan/{part}/{output}"] = values
    return series


def _check_request(
    job: Job, aim: tuple[str, ...], duration: float, rate_hz: float | None, travel: Mapping[str, float]
) -> None:
    """Check the request before the first simulation."""
    known = {v.name for v in job.model.outputs}
    for name in travel:
        if name not in known:
            raise InputError(f"--travel {name}: model {job.name} has no such output; it has {', '.join(sorted(known))}")
    for name in aim:
        if name not in job.parameters:
            raise InputError(f"--aim {name}: no parameter of the fit; it has {', '.join(job.parameters.names)}")
    rate = rate_hz or job.recordings[0].rate_hz
    if not duration * rate >= 10.0:
        raise InputError(f"an experiment of {duration:g} s at {rate:g} Hz has fewer than ten samples")


def _verdict(design: Design) -> Json:
    aimed = design.targets
    names = ", ".join(f"`{name}`" for name in aimed) if len(aimed) <= 4 else f"{len(aimed)} parameters"
    text = f"{design.duration:g} s of steps would make the intervals of {names} {design.gain:.1f} times narrower."
    return {"level": "good" if design.gain > 1.1 else "warning", "text": text}
