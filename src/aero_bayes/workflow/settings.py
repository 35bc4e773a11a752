"""From the configuration to the settings of each stage."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.fit import FitSettings
from aero_bayes.estimate.search_settings import WHOLE_MODEL_LOCAL
from aero_bayes.estimate.staged import Stage
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.unknown_names import known_names_hint
from aero_bayes.workflow.job import Job

if TYPE_CHECKING:  # the sampler takes a second to import
    from aero_bayes.sampling.settings import SampleSettings


def fit_settings(job: Job) -> FitSettings:
    """Return how the job wants its fits done."""
    section = job.config.fit
    return FitSettings(
        method="chain" if section.method == "pso+local" else section.method,
        cost=section.cost,
        staged=section.staged,
        stages=tuple(Stage(s.parameters, s.outputs) for s in section.stages) if section.stages else None,
        swarm=SwarmSettings(
            particles=section.pso.particles, iterations=section.pso.iterations, tolerance=section.pso.tolerance
        ),
        local=replace(WHOLE_MODEL_LOCAL, max_iterations=section.local.iterations, tolerance=section.local.tolerance),
        starts=section.local.starts,
        ripple=section.ripple,
        noise=_noise(job),
        engine=job.engine,
        fixed=job.fixed,
        values=job.values,
        calibration=CalibrationSettings(
            outputs=job.config.data.outputs,
            delay_limit=section.max_input_delay,
            start=section.initial_states,
            interpolation=job.config.data.interpolation or job.model.declared.recording.interpolation,
            solver=job.solver,
        ),
    )


def _noise(job: Job) -> NoiseModel:
    section, known = job.config.noise, [v.name for v in job.model.outputs]
    for name in section.outputs:
        if name not in known:
            hint = known_names_hint(name, known)
            raise InputError(f"[noise.{name}]: model {job.model.name} has no output {name}{hint}")
    kinds = tuple((name, own.kind) for name, own in section.outputs.items())
    return NoiseModel(outputs=kinds, process=section.process, initial_sd=section.initial_sd)


def sample_settings(job: Job) -> SampleSettings:
    """Return how long the job wants its posterior sampled."""
    from aero_bayes.sampling.settings import SampleSettings

    section = job.config.posterior
    return SampleSettings(
        ensembles=section.ensembles,
        walkers=section.walkers,
        max_steps=section.max_steps,
        time_limit=60.0 * section.max_minutes,
        r_hat=section.r_hat,
        ess=section.ess,
    )
