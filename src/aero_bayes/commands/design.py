"""``aero-bayes design``: the next experiment, as a signal to play, and what is expected of it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from aero_bayes.commands.commands import fit_job, fit_part, write_page
from aero_bayes.commands.context import resumable
from aero_bayes.commands.job import Job, RunOptions, open_job, which_model
from aero_bayes.commands.loop import fit_settings
from aero_bayes.config import load_config
from aero_bayes.errors import InputError
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.information import Limits, SearchSettings
from aero_bayes.estimate.propose import (
    Design,
    Proposal,
    Separation,
    default_limits,
    expected_outputs,
    propose_experiment,
    separating_experiment,
)
from aero_bayes.estimate.result import Fit
from aero_bayes.plain import plain
from aero_bayes.progress import ProgressBar
from aero_bayes.report.results import Series, merge
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import Model
from aero_bayes.structure.law_places import CandidateFilter, LawPlaces
from aero_bayes.structure.modelica_family import ModelicaFamily
from aero_bayes.unknown_names import closest_name

Json = dict[str, Any]

#: The signal to play, in the run's folder.
SIGNAL_FILE = "next_experiment.csv"
#: Starting values tried for a rival effect's parameters, at most.
MAX_STARTS = 4


@dataclass(frozen=True)
class DesignOptions:
    """What the experiment is for and what the rig allows.

    ``aim`` names parameters, by default the weak ones; ``separate`` two effects."""

    aim: tuple[str, ...] = ()
    separate: tuple[str, str] | None = None
    duration: float = 30.0
    rate_hz: float | None = None
    amplifier: float | None = None
    travel: Mapping[str, float] | None = None


def run_design(files: Sequence[Path], options: RunOptions, wanted: DesignOptions) -> None:
    """Fit, propose the experiment, and write signal, result and page."""
    began = time.perf_counter()
    Limits(1.0 if wanted.amplifier is None else wanted.amplifier, dict(wanted.travel or {}))
    _check_rivals(wanted, options)
    job = open_job(files, options)
    _check_request(job, wanted)
    with resumable(job, "design") as checkpoint:
        with ProgressBar(options.quiet) as progress:
            base = fit_job(job, progress, checkpoint)
            usual = default_limits(base)
            given: Json = {
                "duration": wanted.duration,
                "rate_hz": wanted.rate_hz,
                "limits": Limits(wanted.amplifier or usual.amplifier, {**usual.travel, **(wanted.travel or {})}),
                "settings": SearchSettings(seed=options.seed, engine=job.engine),
                "workers": options.workers,
                "progress": progress,
            }
            signal: Proposal
            if wanted.separate is None:
                signal = design = propose_experiment(base, targets=wanted.aim or None, **given)
                part: Json = {"design": plain(design) | {"kind": "narrow"}, "verdict": _narrow_verdict(design)}
                models = {"expected": base}
            else:
                signal, models, part = _separate(job, base, wanted.separate, given)
            plan = _plan(signal, models, given)
        part["design"] |= {"file": SIGNAL_FILE, "unit": base.calibration.model.units[signal.input]}
        result, series = fit_part(job, base)
        signal.write_csv(options.out / SIGNAL_FILE)
        closing: Json = {"command": "design", "seconds": time.perf_counter() - began}
        page, _ = write_page(job, merge(result, part, closing), series | plan)
        click.echo(part["verdict"]["text"].replace("`", ""))
        click.echo(f"wrote {options.out / SIGNAL_FILE}, {options.out / 'result.json'} and {page}")


def _separate(job: Job, base: Fit, ids: tuple[str, str], given: Json) -> tuple[Separation, dict[str, Fit], Json]:
    """Return the experiment for two effects, the models with each, and what result.json has of them."""
    section, folder, narrowed = job.config.model, job.options.out / "fmu", CandidateFilter(effects=ids)
    family = ModelicaFamily(LawPlaces(job.name, section.sources, section.libraries, narrowed), folder)
    family.prepare(base.calibration, base.optimum, open_simulator)
    (first, own), (second, others) = (_with_effect(job, base, family, name, given["progress"]) for name in ids)
    apart = separating_experiment(first, second, **given)
    found = plain(apart) | {
        "kind": "separate",
        "effects": list(ids),
        "log_posterior_now": [first.log_posterior, second.log_posterior],
        "models": [_effect_entry(ids[0], first, own), _effect_entry(ids[1], second, others)],
    }
    words = {id_: family.describe(id_) for id_ in ids}
    part: Json = {"design": found, "verdict": _separate_verdict(ids, apart), "words": words}
    return apart, {ids[0]: first, ids[1]: second}, part


def _effect_entry(name: str, found: Fit, names: Sequence[str]) -> Json:
    """Return an effect as it was fitted to the recordings at hand."""
    table = found.parameters
    parameters = {own: table[own] for own in names if own in table}
    return {"id": name, "model": found.calibration.model.name, "parameters": parameters}


def _with_effect(
    job: Job, base: Fit, family: ModelicaFamily, name: str, progress: ProgressBar
) -> tuple[Fit, list[str]]:
    """Return the base model with an effect, written, built and fitted, and the names of the effect's parameters."""
    own = [p.name for p in family.parameters(name)]
    rows = family.starts(name) or (tuple(p.start for p in family.parameters(name)),)
    tried = [dict(zip(own, row, strict=True)) for row in rows]
    written = family.extend([name], tried[0], job.options.out)
    here = {old: new for pairs in written.names.values() for old, new in pairs}
    values = [float(base[p.name]) if p.name in base else p.start for p in job.parameters]
    found: list[Fit] = []
    for k, row in enumerate(tried[:: max(1, -(-len(tried) // MAX_STARTS))]):
        progress(f"fit with {name}", k / MAX_STARTS, "")
        starts = {here[n]: v for n, v in row.items()}
        started = [
            replace(p, start=min(max(starts.get(p.name, p.start), p.lower), p.upper)) for p in written.parameters
        ]
        found.append(
            fit(
                job.recordings,
                written.model,
                parameters=job.parameters.with_start(np.array(values)).extended(started),
                settings=replace(fit_settings(job), method="local"),
                seed=job.options.seed,
                workers=job.options.workers,
            )
        )
    return max(found, key=lambda candidate: candidate.log_posterior), [here[n] for n in own]


def _plan(proposal: Proposal, models: Mapping[str, Fit], given: Json) -> Series:
    """Return ``plan/...``: the signal and the prediction of each model."""
    series: Series = {"plan/time": proposal.time, f"plan/input/{proposal.input}": proposal.values}
    for label, found in models.items():
        for output, band in expected_outputs(proposal, found, given["settings"], given["workers"]).items():
            for part, values in zip(("lower", "middle", "upper"), band, strict=True):
                series[f"plan/{part}/{label}/{output}"] = values
    return series


def _check_rivals(wanted: DesignOptions, options: RunOptions) -> None:
    """Check the effects to tell apart, if any."""
    if wanted.separate is None:
        return
    if wanted.aim:
        raise InputError("--aim and --separate exclude each other: give one of them")
    config = load_config(options.config)
    name, fmu = which_model(config, options)
    if fmu is None:
        every = LawPlaces(name, config.model.sources, config.model.libraries).candidates
        known = [candidate.id for candidate in every]
    else:
        known = list(Model.load(fmu).declared.effects)
    first, second = wanted.separate
    for id_ in wanted.separate:
        if id_ not in known:
            near = closest_name(id_, known, cutoff=0.0)
            raise InputError(f"--separate: unknown effect {id_!r}; did you mean {near or 'none'}?")
    if first == second:
        raise InputError(f"--separate {first} {second}: expected two different effects")


def _check_request(job: Job, wanted: DesignOptions) -> None:
    """Check the request before the first simulation."""
    known = {v.name for v in job.model.outputs}
    for name in wanted.travel or ():
        if name not in known:
            raise InputError(f"--travel {name}: model {job.name} has no such output; it has {', '.join(sorted(known))}")
    for name in wanted.aim:
        if name not in job.parameters:
            raise InputError(f"--aim {name}: no parameter of the fit; it has {', '.join(job.parameters.names)}")
    if wanted.separate is not None and not job.modelica:
        raise InputError(f"{job.model.path}: effects are written into Modelica source; --model must name a class")
    rate = wanted.rate_hz or job.recordings[0].rate_hz
    if not wanted.duration * rate >= 10.0:
        raise InputError(f"an experiment of {wanted.duration:g} s at {rate:g} Hz has fewer than ten samples")


def _narrow_verdict(design: Design) -> Json:
    aimed = design.targets
    names = ", ".join(f"`{name}`" for name in aimed) if len(aimed) <= 4 else f"{len(aimed)} parameters"
    text = f"{design.in_words} would make the intervals of {names} {design.gain:.1f} times narrower."
    return {"level": "good" if design.gain > 1.1 else "warning", "text": text}


def _separate_verdict(ids: tuple[str, str], apart: Separation) -> Json:
    pair = f"`{ids[0]}` and `{ids[1]}`"
    if apart.log_evidence < 1.0:
        return {
            "level": "warning",
            "text": f"No experiment within these limits that was tried would tell {pair} apart.",
        }
    expected = f"The expected difference in log-evidence is {apart.log_evidence:.3g}."
    text = f"{apart.in_words} would tell {pair} apart. {expected}"
    return {"level": "good" if apart.log_evidence > 3.0 else "warning", "text": text}
