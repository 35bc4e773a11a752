"""From the configuration to the settings of each stage."""

from __future__ import annotations

from aero_bayes.estimate.aero import RESTING, aero_overrides
from aero_bayes.estimate.calibration import CalibrationSettings
from aero_bayes.estimate.fit import FitSettings
from aero_bayes.estimate.search import LocalSettings
from aero_bayes.estimate.staged import Stage
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.sample.mcmc import SampleSettings
from aero_bayes.workflow.job import Job


def fit_settings(job: Job) -> FitSettings:
    """How the job wants its fits done."""
    section = job.config.fit
    aero = bool(aero_overrides(job.model))
    # A model of the user's own gets a delay where it is asked for; that of a rig that is known, where it has one.
    delay = section.max_input_delay if section.max_input_delay is not None else CalibrationSettings.delay_limit * aero
    return FitSettings(
        method="chain" if section.method == "pso+local" else section.method,
        cost=section.cost,
        staged=section.staged,
        stages=tuple(Stage(s.parameters, s.outputs) for s in section.stages) if section.stages else None,
        swarm=SwarmSettings(
            particles=section.pso.particles, iterations=section.pso.iterations, tolerance=section.pso.tolerance
        ),
        local=LocalSettings(max_iterations=section.local.iterations, tolerance=section.local.tolerance),
        starts=section.local.starts,
        ripple=section.ripple,
        engine=job.engine,
        calibration=CalibrationSettings(
            outputs=job.config.data.outputs,
            delay="auto" if delay > 0.0 else "none",
            delay_limit=delay if delay > 0.0 else CalibrationSettings.delay_limit,
            start=section.initial_states,
            interpolation=job.config.data.interpolation or ("hold" if aero else "auto"),
            resting=RESTING if aero else None,
            solver=job.solver,
        ),
    )


def sample_settings(job: Job) -> SampleSettings:
    """How long the job wants its posterior sampled."""
    section = job.config.posterior
    return SampleSettings(
        ensembles=section.ensembles,
        walkers=section.walkers,
        max_steps=section.max_steps,
        time_limit=60.0 * section.max_minutes,
        r_hat=section.r_hat,
        ess=section.ess,
    )
