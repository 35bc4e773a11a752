"""From recordings to parameters and how sure they are."""

from aero_bayes.estimate.calibration import Calibration, CalibrationSettings, calibrate
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.fit import FitSettings, fit, fit_calibration
from aero_bayes.estimate.identifiability import Combination, Identifiability, Status
from aero_bayes.estimate.levenberg_marquardt import LocalSettings, Stop
from aero_bayes.estimate.parameter_estimates import Estimate
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.stage_report import StageReport
from aero_bayes.estimate.staged import Stage, causal_stages
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.sensors.noise import NoiseModel, OutputNoise, estimate_noise, innovations

__all__ = [
    "Calibration",
    "CalibrationSettings",
    "Combination",
    "Estimate",
    "Fit",
    "FitSettings",
    "Identifiability",
    "LocalSettings",
    "LogNormal",
    "LogUniform",
    "NoiseModel",
    "Normal",
    "OutputNoise",
    "Override",
    "Parameter",
    "ParameterSet",
    "Prior",
    "Stage",
    "StageReport",
    "Status",
    "Stop",
    "SwarmSettings",
    "Uniform",
    "calibrate",
    "causal_stages",
    "declared_overrides",
    "estimate_noise",
    "fit",
    "fit_calibration",
    "innovations",
    "parameters_from_model",
]
