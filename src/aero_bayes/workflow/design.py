"""``aero-bayes design``: the next experiment, as a signal to play, an expectation, and a simulated check of it."""

from __future__ import annotations

import difflib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np

from aero_bayes.config import load_config
from aero_bayes.design import (
    Design,
    GainCheck,
    Limits,
    Separation,
    SeparationCheck,
    check_gain,
    check_separation,
    expected_outputs,
    propose_experiment,
    separating_experiment,
)
from aero_bayes.design.propose import default_limits
from aero_bayes.design.proposed_input import ProposedInput
from aero_bayes.design.signal_search import SearchSettings
from aero_bayes.errors import InputError
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.result import Fit
from aero_bayes.laws.candidate_filter import CandidateFilter
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.modelica_family import ModelicaFamily
from aero_bayes.progress import ProgressBar
from aero_bayes.report import write_run_page
from aero_bayes.simulation import Model, open_simulator
from aero_bayes.workflow.commands import fit_job, fit_part
from aero_bayes.workflow.context import context_part
from aero_bayes.workflow.curves import Series, only_measured
from aero_bayes.workflow.job import Job, RunOptions, open_job, which_model
from aero_bayes.workflow.results import merge, write_result, write_series
from aero_bayes.workflow.resume import resumable
from aero_bayes.workflow.settings import fit_settings

Json = dict[str, Any]

#: The signal to play, in the run's folder.
SIGNAL_FILE = "next_experiment.csv"
#: Starting values tried for a rival effect's parameters, at most.
MAX_STARTS = 4


@dataclass(frozen=True)
class DesignOptions:
    """What the experiment is for and what the rig allows.

    ``aim`` names parameters, by default the weak ones; ``separate`` two effects, or ``loop`` a finished run of the
    closed loop whose first pair of equivalent effects is meant."""

    aim: tuple[str, ...] = ()
    separate: tuple[str, str] | None = None
    loop: Path | None = None
    duration: float = 30.0
    rate_hz: float | None = None
    amplifier: float | None = None
    travel: Mapping[str, float] | None = None
    repeats: int = 20


@dataclass(frozen=True)
class Rivals:
    """Two effects to tell apart, and those that both models have besides."""

    first: str
    second: str
    common: tuple[str, ...] = ()


def run_design(files: Sequence[Path], options: RunOptions, wanted: DesignOptions) -> None:
    """Fit, propose the experiment, check its gain in simulation, and write signal, result and page."""
    began = time.perf_counter()
    Limits(1.0 if wanted.amplifier is None else wanted.amplifier, dict(wanted.travel or {}))
    rivals = _rivals(wanted, options)
    job = open_job(files, options)
    _check_request(job, wanted, rivals)
    with resumable(job, "design") as checkpoint:
        with ProgressBar(options.quiet) as progress:
            base = fit_job(job, progress, checkpoint)
            limits = _limits(base, wanted)
            part, plan, signal = (
                _narrow(job, base, limits, wanted, progress)
                if rivals is None
                else _separate(job, base, rivals, limits, wanted, progress)
            )
        result, series = fit_part(job, base)
        closing: Json = {"command": "design", "seconds": time.perf_counter() - began}
        write_series(options.out, only_measured(series) | plan)
        signal.write_csv(options.out / SIGNAL_FILE)
        result = merge(result, part, closing)
        result |= context_part(job, result)
        write_result(options.out, result)
        page = write_run_page(options.out)
        click.echo(result["verdict"]["text"].replace("`", ""))
        click.echo(f"wrote {options.out / SIGNAL_FILE}, {options.out / 'result.json'} and {page}")


def _narrow(
    job: Job, base: Fit, limits: Limits, wanted: DesignOptions, progress: ProgressBar
) -> tuple[Json, Series, ProposedInput]:
    """Return the experiment for parameters."""
    common: Any = {"seed": job.options.seed, "engine": job.engine, "workers": job.options.workers}
    design = propose_experiment(
        base, duration=wanted.duration, rate_hz=wanted.rate_hz, limits=limits, targets=wanted.aim or None,
        settings=_effort(job), workers=job.options.workers, progress=progress,
    )  # fmt: skip
    check = check_gain(design, base, repeats=wanted.repeats, progress=progress, **common)
    found = design.to_dict()
    parameters: Any = found["parameters"]
    for name, entry in parameters.items():
        entry["sd_achieved"] = check.realised[name] * entry["sd_before"]
    found |= {"kind": "narrow", "file": SIGNAL_FILE, "unit": design.unit, "check": check.to_dict()}
    return {"design": found, "verdict": _narrow_verdict(design, check)}, _plan(design, {"expected": base}, job), design


def _effort(job: Job) -> SearchSettings:
    return SearchSettings(seed=job.options.seed, engine=job.engine)


def _separate(
    job: Job, base: Fit, rivals: Rivals, limits: Limits, wanted: DesignOptions, progress: ProgressBar
) -> tuple[Json, Series, ProposedInput]:
    """Return the experiment for two effects."""
    section, ids = job.config.model, (*rivals.common, rivals.first, rivals.second)
    folder, narrowed = job.options.out / "fmu", CandidateFilter(effects=ids)
    family = ModelicaFamily(LawPlaces(job.name, section.sources, section.libraries, narrowed), folder)
    family.prepare(base.calibration, base.optimum, open_simulator)
    first, of_first = _with_effect(job, base, family, rivals.first, rivals.common, progress)
    second, of_second = _with_effect(job, base, family, rivals.second, rivals.common, progress)
    common: Any = {"seed": job.options.seed, "engine": job.engine, "workers": job.options.workers}
    apart = separating_experiment(
        first, second, duration=wanted.duration, rate_hz=wanted.rate_hz, limits=limits, settings=_effort(job),
        workers=job.options.workers, progress=progress,
    )  # fmt: skip
    check = check_separation(apart, first, second, repeats=wanted.repeats, progress=progress, **common)
    found = apart.to_dict() | {
        "kind": "separate",
        "file": SIGNAL_FILE,
        "unit": base.calibration.model.units[apart.input],
        "effects": [rivals.first, rivals.second],
        "common": list(rivals.common),
        "log_posterior_now": [first.log_posterior, second.log_posterior],
        "models": [_effect_entry(rivals.first, first, of_first), _effect_entry(rivals.second, second, of_second)],
        "check": check.to_dict(),
    }
    plan = _plan(apart, {rivals.first: first, rivals.second: second}, job)
    words = {id_: family.describe(id_) for id_ in ids}
    return {"design": found, "verdict": _separate_verdict(rivals, apart, check), "words": words}, plan, apart


def _effect_entry(name: str, found: Fit, names: Sequence[str]) -> Json:
    """Return an effect as it was fitted to the recordings at hand."""
    table = found.parameters
    parameters = {own: table[own].to_dict() for own in names if own in table}
    return {"id": name, "model": found.calibration.model.name, "parameters": parameters}


def _with_effect(
    job: Job, base: Fit, family: ModelicaFamily, name: str, common: Sequence[str], progress: ProgressBar
) -> tuple[Fit, list[str]]:
    """Return the base model with an effect (and those that both rivals have), written, built and fitted.

    Its parameters."""
    ids = (*common, name)
    names = {id_: [p.name for p in family.parameters(id_)] for id_ in ids}
    rows = product(*(family.starts(id_) or (tuple(p.start for p in family.parameters(id_)),) for id_ in ids))
    tried = [
        {n: v for id_, own in zip(ids, row, strict=True) for n, v in zip(names[id_], own, strict=True)} for row in rows
    ]
    written = family.extend(ids, tried[0], job.options.out)
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
    return max(found, key=lambda candidate: candidate.log_posterior), [here[n] for n in names[name]]


def _plan(proposal: Design | Separation, models: Mapping[str, Fit], job: Job) -> Series:
    """Return ``plan/...``: the signal and the prediction of each model."""
    series: Series = {"plan/time": proposal.time, f"plan/input/{proposal.input}": proposal.values}
    for label, found in models.items():
        seen = expected_outputs(proposal, found, seed=job.options.seed, engine=job.engine, workers=job.options.workers)
        for k, output in enumerate(seen.outputs):
            series[f"plan/middle/{label}/{output}"] = seen.middle[:, k]
            series[f"plan/lower/{label}/{output}"] = seen.lower[:, k]
            series[f"plan/upper/{label}/{output}"] = seen.upper[:, k]
    return series


def _rivals(wanted: DesignOptions, options: RunOptions) -> Rivals | None:
    """Return which effects to tell apart, if any."""
    if sum((bool(wanted.aim), wanted.separate is not None, wanted.loop is not None)) > 1:
        raise InputError("--aim, --separate and --loop exclude each other: give one of them")
    if wanted.separate is None and wanted.loop is None:
        return None
    config = load_config(options.config)
    name, fmu = which_model(config, options)
    if fmu is None:
        every = LawPlaces(name, config.model.sources, config.model.libraries).candidates
        known = [candidate.id for candidate in every]
    else:
        known = list(Model.load(fmu).declared.effects)
    if wanted.separate is not None:
        first, second = wanted.separate
        for id_ in wanted.separate:
            if id_ not in known:
                near = difflib.get_close_matches(id_, known, n=1, cutoff=0.0)
                raise InputError(f"--separate: unknown effect {id_!r}; did you mean {', '.join(near) or 'none'}?")
        if first == second:
            raise InputError(f"--separate {first} {second}: expected two different effects")
        return Rivals(first, second)
    assert wanted.loop is not None
    return _rivals_of_loop(wanted.loop / "result.json", known)


def _rivals_of_loop(path: Path, known: Sequence[str]) -> Rivals:
    """Return the first two equivalent effects of a finished loop."""
    try:
        found = json.loads(path.read_text("utf-8"))["loop"]
        classes = [[str(id_) for id_ in group if id_ in known] for group in found["equivalent"]]
        added = [str(entry["id"]) for entry in found["effects"] if entry["id"] in known]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a finished close-loop run") from None
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: holds no result of a closed loop; expected a finished close-loop run") from None
    same = next((group for group in classes if len(group) > 1), None)
    if same is None:
        raise InputError(f"{path}: the loop has no effects that it could not tell apart; use --separate or --aim")
    return Rivals(same[0], same[1], tuple(id_ for id_ in added if id_ not in same))


def _check_request(job: Job, wanted: DesignOptions, rivals: Rivals | None) -> None:
    """Check the request before the first simulation."""
    known = {v.name for v in job.model.outputs}
    for name in wanted.travel or ():
        if name not in known:
            raise InputError(f"--travel {name}: model {job.name} has no such output; it has {', '.join(sorted(known))}")
    for name in wanted.aim:
        if name not in job.parameters:
            raise InputError(f"--aim {name}: no parameter of the fit; it has {', '.join(job.parameters.names)}")
    if rivals is not None and not job.modelica:
        raise InputError(f"{job.model.path}: effects are written into Modelica source; --model must name a class")
    rate = wanted.rate_hz or job.recordings[0].rate_hz
    if not wanted.duration * rate >= 10.0:
        raise InputError(f"an experiment of {wanted.duration:g} s at {rate:g} Hz has fewer than ten samples")


def _limits(base: Fit, wanted: DesignOptions) -> Limits:
    usual = default_limits(base)
    return Limits(wanted.amplifier or usual.amplifier, {**usual.travel, **(wanted.travel or {})})


def _narrow_verdict(design: Design, check: GainCheck) -> Json:
    aimed = design.targets
    names = ", ".join(f"`{name}`" for name in aimed) if len(aimed) <= 4 else f"{len(aimed)} parameters"
    achieved = float(np.exp(-np.mean([np.log(check.realised[name]) for name in aimed])))
    repeats = check.repeats - check.failures
    text = (
        f"{design.in_words} would make the intervals of {names} {design.gain:.1f} times "
        f"narrower. In {repeats} simulated repetitions they became {achieved:.1f} times narrower."
    )
    return {"level": "good" if check.agrees and design.gain > 1.1 else "warning", "text": text}


def _separate_verdict(rivals: Rivals, apart: Separation, check: SeparationCheck) -> Json:
    pair = f"`{rivals.first}` and `{rivals.second}`"
    if apart.log_evidence < 1.0:
        return {
            "level": "warning",
            "text": f"No experiment within these limits that was tried would tell {pair} apart.",
        }
    text = (
        f"{apart.in_words} would tell {pair} apart. The expected difference in log-evidence is "
        f"{apart.log_evidence:.3g}; in simulated repetitions it was {check.achieved:.3g}, and {check.told_apart:.0%} "
        "of them found the true effect."
    )
    return {"level": "good" if check.told_apart > 0.8 else "warning", "text": text.replace("%", " %")}
