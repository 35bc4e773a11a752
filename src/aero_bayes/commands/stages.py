"""What a job's configuration says of a fit, the loop and the sampler; what the loop and profiles add to result.json."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel
from threadpoolctl import threadpool_limits

from aero_bayes.commands.job import Job, later_of
from aero_bayes.data.split import ROLES
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.exports import noise_at_interval
from aero_bayes.estimate.identifiability import Status, fixed_reasons
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.levenberg_marquardt import FitSettings, LocalSettings, Stage
from aero_bayes.estimate.log_posterior import LOG_POSTERIOR_DROP_90, profile_likelihood
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.residual_tests import reports_by_recording
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.first_fit import LoopSettings
from aero_bayes.loop.loop import close_loop
from aero_bayes.loop.result import LoopResult
from aero_bayes.plain import plain
from aero_bayes.progress import Piece, ProgressBar
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.load_model import load_model
from aero_bayes.simulation.model import Model, ModelicaSource
from aero_bayes.unknown_names import known_names_hint

Settings = TypeVar("Settings", bound=Any)


def filled(settings: Settings, section: BaseModel) -> Settings:
    """Take every key of a section that has the name of a setting, tables within tables alike."""
    own: Mapping[str, Any] = {key: getattr(section, key) for key in type(section).model_fields}
    known = {f.name: getattr(settings, f.name) for f in fields(settings)}
    taken = {key: value for key, value in own.items() if key in known}
    nested = {k: filled(known[k], value) for k, value in taken.items() if isinstance(value, BaseModel)}
    return replace(settings, **{**taken, **nested})


def fit_settings(job: Job) -> FitSettings:
    """Return how the job wants its fits done."""
    section, data = job.config.fit, job.config.data
    calibration = CalibrationSettings(
        outputs=data.outputs,
        interpolation=data.interpolation or job.model.declared.recording.interpolation,
        solver=job.solver,
    )
    stages = tuple(Stage(**s.model_dump()) for s in section.stages) if section.stages else None
    settings = FitSettings(
        noise=_noise(job), fixed=job.fixed, values=job.values,
        calibration=filled(calibration, section),
    )  # fmt: skip
    return replace(filled(filled(settings, section.local), section), stages=stages)


def _noise(job: Job) -> NoiseModel:
    section, known = job.config.noise, [v.name for v in job.model.outputs]
    for name in section.outputs:
        if name not in known:
            hint = known_names_hint(name, known)
            raise InputError(f"[noise.{name}]: model {job.model.name} has no output {name}{hint}")
    kinds = tuple((name, own.kind) for name, own in section.outputs.items())
    known_sd = {name: own.sd for name, own in section.outputs.items() if own.sd is not None}
    return filled(NoiseModel(outputs=kinds, sd=known_sd), section)


def sample_settings(job: Job) -> SampleSettings:
    """Return how long the job wants its posterior sampled."""
    return filled(SampleSettings(), job.config.posterior)


Json = dict[str, Any]


def run_loop(job: Job, progress: ProgressBar, base: Fit | None = None) -> LoopResult:
    """Close the loop on a job; from the fit of its model where there is one."""
    return close_loop(
        job.recordings if base is None else base,
        job.tests,
        validation=job.validation,
        model=_model_of(job),
        settings=loop_settings(job),
        seed=job.options.seed,
        workers=job.options.workers,
        out_dir=job.options.out,
        progress=Piece(progress, "loop"),
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
    section, fit_section, known = job.config.loop, job.config.fit, bool(job.model.declared.parameters)
    given = fit_section.model_fields_set
    fitting, defaults = fit_settings(job), LoopSettings()
    _check(fitting)
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


def _check(settings: FitSettings) -> None:
    if settings.cost != "posterior":
        raise InputError(f'the loop fits by the posterior: [fit] cost is "{settings.cost}", expected "posterior"')
    if settings.method == "pso":
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
    parameters = job.parameters.extended([*freed, *loop.final.added])
    found = [loop[p.name].value if p.name in loop.parameters else p.start for p in parameters]
    return replace(job, name=loop.model, model=model, parameters=parameters.with_start(np.array(found)), fixed=fixed)


def loop_part(job: Job, loop: LoopResult) -> Json:
    """Return the keys of result.json that the loop fills."""
    interval = min(1.0 / recording.rate_hz for recording in job.recordings)
    return {
        "parameters": loop_parameters(job, loop),
        "fit": {
            "rms": {role: loop.predicted_after.pooled(role) for role in ROLES},
            "interpolation": dict(loop.after.calibration.data.interpolation),
        },
        "residual": reports_by_recording(loop.final.reports),
        "noise": noise_at_interval(loop.noise, interval),
        "diagnosis": plain((loop.diagnosis if loop.after is loop.before else loop.after.diagnosis).rows),
        "loop": loop.to_dict(),
        "words": dict(loop.words),
        "failures": {"completed": loop.simulations - loop.failures, "failed": loop.failures},
        "identifiability": loop.identifiability.to_dict(),
    }


def loop_parameters(job: Job, loop: LoopResult) -> Json:
    """Make the table of all parameters of the final model: estimates with their status, and why others were fixed."""
    table: Json = plain(loop.parameters)
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


#: Points of a profile, iterations of its search, and seconds after which no further one is begun.
PROFILE_POINTS, MAX_PROFILE_ITERATIONS, PROFILE_TIME_LIMIT = 15, 15, 4.0
#: Distance from a bound, in standard deviations, below which a parameter gets a profile.
MIN_BOUND_DEVIATIONS = 2.0


def _parameters_to_profile(found: Fit) -> list[str]:
    """List fitted physical parameters that are weak or not identified, or that lie at a bound; the weakest first."""
    low, high = found.calibration.parameters.box
    point = found.calibration.parameters.to_search(found.values)
    doubts = []
    for position, column in enumerate(found.free):
        item = found.calibration.parameters.items[column]
        room = min(point[column] - low[column], high[column] - point[column])
        identified = found.identifiability.status[item.name] is Status.IDENTIFIED
        unsure = not identified or room < MIN_BOUND_DEVIATIONS * found.laplace.sd[position]
        if isinstance(item.target, ParameterTarget) and unsure:
            doubts.append((-found.identifiability.ratio[item.name], item.name))
    return [name for _, name in sorted(doubts)]


def profile_part(job: Job, found: Fit, progress: ProgressBar) -> Json:
    """Return the ``profiles`` of result.json's ``identifiability``: nothing where no parameter is doubtful."""
    names = _parameters_to_profile(found)
    if not names:
        return {}
    began = time.perf_counter()
    profiles: Json = {}
    skipped: list[str] = []
    with (
        threadpool_limits(limits=1, user_api="blas"),
        open_simulator(found.calibration.problem(), job.options.workers) as simulator,
    ):
        for k, name in enumerate(names):
            if profiles and (time.perf_counter() - began) * (k + 1) / k > PROFILE_TIME_LIMIT:
                skipped = names[k:]
                break
            progress("profiles", k / len(names), name)
            try:
                profiles[name] = profile_likelihood(
                    found, name, simulator, points=PROFILE_POINTS,
                    settings=LocalSettings(iterations=MAX_PROFILE_ITERATIONS, tolerance=1e-3),
                )  # fmt: skip
            except CannotFinishError:
                skipped.append(name)
    return {
        "identifiability": {"profiles": profiles, "profile_drop_90": LOG_POSTERIOR_DROP_90, "not_profiled": skipped}
    }
