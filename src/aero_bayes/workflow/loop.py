"""The closed loop as a command: its settings from the job, its findings as keys of result.json."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.check.residual_tests import reports_by_recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.noise_report import noise_at_interval
from aero_bayes.estimate.parameter_estimates import fixed_reasons
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.loop import LoopResult, LoopSettings, close_loop
from aero_bayes.loop.judgement import errors_by_recording
from aero_bayes.progress import ProgressBar
from aero_bayes.simulation import Model, ModelicaSource
from aero_bayes.simulation.load_model import load_model
from aero_bayes.workflow.curves import Series
from aero_bayes.workflow.job import Job, later_of
from aero_bayes.workflow.settings import filled, fit_settings

Json = dict[str, Any]


def run_loop(job: Job, progress: ProgressBar, base: Fit | None = None) -> LoopResult:
    """Close the loop on a job; from the fit of its model where there is one."""
    return close_loop(
        job.recordings if base is None else base,
        job.tests,
        model=_model_of(job),
        settings=loop_settings(job),
        seed=job.options.seed,
        workers=job.options.workers,
        out_dir=job.options.out,
        progress=lambda what, share: progress(f"loop: {what}", share),
    )


def _model_of(job: Job) -> ModelicaSource | Path:
    section = job.config.model
    return ModelicaSource(job.name, section.sources, section.libraries) if job.modelica else job.model.path


def with_chosen_values(job: Job, found: Fit) -> Job:
    """Hold the likeliest of the listed values of a job, as a fit of it found them; the same job if none are listed.

    Values that are not Real are modifiers of a class that is written beside the results."""
    if not found.trials:
        return job
    best, source = found.trials[0], job.model.source
    held = {name: number for name, number in best.numbers.items() if name not in best.modifiers}
    job = replace(job, fixed={**job.fixed, **held}, values={})
    if not best.modifiers or source is None:
        return job
    chosen = CalibratedModel(source, dict(best.modifiers), suffix="chosen")
    section = job.config.model
    files = (*section.sources, chosen.write(job.options.out))
    model = load_model(chosen.name, sources=files, libraries=section.libraries, folder=job.options.out)
    config = job.config.model_copy(update={"model": section.model_copy(update={"sources": files})})
    return replace(job, name=chosen.name, model=model, config=config)


def loop_settings(job: Job) -> LoopSettings:
    """Return the settings of the loop that the job wants."""
    _check(job)
    section, fit_section, known = job.config.loop, job.config.fit, bool(job.model.declared.parameters)
    given = fit_section.model_fields_set
    fitting, defaults = fit_settings(job), LoopSettings()
    method, solver = fitting.method, fitting.calibration.solver
    if known:
        # For a rig that is known, looser tolerances and one local fit are enough unless the user says otherwise.
        wanted = {key: getattr(job.solver, key) for key in job.config.solver.model_fields_set - {"engine"}}
        solver = replace(defaults.solver, **wanted)
        asked = {"method", "pso"} & given or "starts" in fit_section.local.model_fields_set
        method = method if asked else "local"
    searched = ParameterSet(tuple(p for p in job.parameters if not p.free_if_identified))
    later = tuple(replace(p, free_if_identified=True) for p in later_of(job))
    fixed = {
        **{p.name: p.start for p in job.parameters if p.free_if_identified},
        **{name: value for name, value in job.fixed.items() if name not in {p.name for p in later}},
    }
    staged = fitting.staged and bool(known or {"staged", "stages"} & given)
    settings = LoopSettings(
        fit=replace(fitting, method=method, staged=staged, fixed=fixed),
        parameters=searched.extended(later),
        solver=solver,
        cache=job.options.cache,
    )
    return filled(settings, section)


def _check(job: Job) -> None:
    fit_section = job.config.fit
    if job.engine != "native":
        raise InputError(f"the loop needs the native engine, not {job.engine}")
    if fit_section.cost != "posterior":
        raise InputError(f'the loop fits by the posterior: [fit] cost is "{fit_section.cost}", expected "posterior"')
    if fit_section.method == "pso":
        raise InputError('the loop needs a local search: [fit] method is "pso", expected "pso+local" or "local"')


def extended_job(job: Job, loop: LoopResult) -> Job:
    """Return the job of the model that came out of the loop: its FMU, and the new parameters among the free ones.

    The same job if nothing of the catalogue was added."""
    added = [effect for effect in loop.effects if effect.kind == "catalogue"]
    if not added:
        return job
    out = job.options.out
    section = job.config.model
    if job.modelica:
        sources = [*section.sources, out / loop.modelica_path]
        model = load_model(loop.model, sources=sources, libraries=section.libraries, folder=out)
    else:
        model = Model.load(out / f"{loop.model}.fmu")
    freed = [p for p in later_of(job) if p.name in loop.parameters]
    fixed = {name: value for name, value in job.fixed.items() if name not in loop.parameters}
    parameters = job.parameters.extended([*freed, *loop.added])
    found = [loop[p.name].value if p.name in loop.parameters else p.start for p in parameters]
    return replace(job, name=loop.model, model=model, parameters=parameters.with_start(np.array(found)), fixed=fixed)


def loop_part(job: Job, loop: LoopResult) -> Json:
    """Return the keys of result.json that the loop fills."""
    interval = min(1.0 / recording.rate_hz for recording in job.recordings)
    return {
        "parameters": loop_parameters(job, loop),
        "fit": {
            "rms": {role: loop.predicted_after.pooled(role) for role in ("train", "test")},
            "interpolation": dict(loop.interpolation),
        },
        "residual": reports_by_recording(loop.residual_after),
        "noise": noise_at_interval(loop.noise, interval),
        "diagnosis": (loop.diagnosis if loop.after is loop.before else loop.after.diagnosis).to_list(),
        "loop": {
            **loop.to_dict(),
            "errors": [error.to_dict() for error in errors_by_recording(loop)],
            "diagnosis_before": loop.diagnosis.to_list(),
        },
        "words": dict(loop.words),
        "failures": {"completed": loop.simulations - loop.failures, "failed": loop.failures},
        "identifiability": loop.identifiability.to_dict(),
    }


def loop_parameters(job: Job, loop: LoopResult) -> Json:
    """Make the table of all parameters of the final model: estimates with their status, and why others were fixed."""
    new = {item.name: item for item in (*loop.added, *later_of(job))}
    table: Json = {}
    for name, estimate in loop.parameters.items():
        base = name.partition("@")[0]
        item = job.parameters[base] if base in job.parameters else new.get(base)
        entry: Json = estimate.to_dict() | {"status": str(loop.identifiability.status[name])}
        if name in loop.after.failed_intervals:
            entry["note"] = loop.after.failed_intervals[name]
        if item is not None:
            entry |= {
                "description": item.description, "prior": item.prior.describe(item.unit), "start": item.start,
                "lower": item.lower, "upper": item.upper,
            }  # fmt: skip
        if entry["status"] in ("unidentified", "at_bound"):
            entry |= {"sd": None, "q05": None, "q50": None, "q95": None}
        table[name] = entry
    reasons = fixed_reasons(job.model, job.fixed)
    for variable in job.model.parameters:
        name = variable.name
        value = job.fixed.get(name, variable.start)
        reason = reasons.get(name, "")
        own = any(other.startswith(f"{name}@") for other in table)
        if name in job.parameters and not reason and not own:
            reason = "not fitted by the loop; kept at its start value"
            value = job.parameters[name].start
            found = loop.calibrated.parameters.get(name, value) if loop.calibrated is not None else value
            if found != value and not isinstance(found, str):
                reason, value = "acts in steps: no slope to fit it by; the search found this value", found
        if name not in table and reason and value is not None:
            table[name] = {
                "value": value, "sd": None, "q05": None, "q50": None, "q95": None, "unit": variable.unit,
                "status": "fixed", "description": variable.description, "note": reason,
            }  # fmt: skip
    return table


def loop_series(job: Job, loop: LoopResult) -> Series:
    """Return the curves that the loop adds to the page: its own, and the final model's outputs as fitted ones."""
    fitted = {f"fitted/{recording}/{output}": y for (recording, output), y in loop.predicted_after.fitted.items()}
    return fitted | loop.series()
