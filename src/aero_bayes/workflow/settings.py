"""From the configuration to the settings of each stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel

from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.fit_settings import FitSettings
from aero_bayes.estimate.staged import Stage
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.unknown_names import known_names_hint
from aero_bayes.workflow.job import Job

if TYPE_CHECKING:  # the sampler takes a second to import
    from aero_bayes.sampling.settings import SampleSettings

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
    stages = tuple(Stage(s.parameters, s.outputs) for s in section.stages) if section.stages else None
    settings = FitSettings(
        starts=section.local.starts, noise=_noise(job), engine=job.engine, fixed=job.fixed, values=job.values,
        calibration=filled(calibration, section),
    )  # fmt: skip
    return replace(filled(settings, section), stages=stages)


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
    from aero_bayes.sampling.settings import SampleSettings

    return filled(SampleSettings(), job.config.posterior)
