"""From recordings to parameters and how sure they are."""

from aero_bayes.inference.aero import aero_overrides
from aero_bayes.inference.calibration import Calibration, CalibrationSettings, calibrate
from aero_bayes.inference.fit import FitSettings, fit, fit_calibration
from aero_bayes.inference.identifiability import Combination, Identifiability, Status
from aero_bayes.inference.local import LocalSettings, Stop
from aero_bayes.inference.mcmc import SampleSettings
from aero_bayes.inference.noise import NoiseEstimate, NoiseModel, estimate_noise, innovations
from aero_bayes.inference.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.inference.posterior import Posterior, sample
from aero_bayes.inference.predictive import Predictive
from aero_bayes.inference.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from aero_bayes.inference.pso import SwarmSettings
from aero_bayes.inference.result import Estimate, Fit, StageReport
from aero_bayes.inference.staged import PAPER_STAGES, Stage, causal_stages

__all__ = [
    "PAPER_STAGES",
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
    "NoiseEstimate",
    "NoiseModel",
    "Normal",
    "Override",
    "Parameter",
    "ParameterSet",
    "Posterior",
    "Predictive",
    "Prior",
    "SampleSettings",
    "Stage",
    "StageReport",
    "Status",
    "Stop",
    "SwarmSettings",
    "Uniform",
    "aero_overrides",
    "calibrate",
    "causal_stages",
    "estimate_noise",
    "fit",
    "fit_calibration",
    "innovations",
    "parameters_from_model",
    "sample",
]
