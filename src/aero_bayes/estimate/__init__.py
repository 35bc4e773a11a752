"""Estimate parameters and their uncertainty from recordings."""

from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.calibration import Calibration, SimulatedModel, calibrate
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.fit import fit, fit_calibration
from aero_bayes.estimate.fit_settings import FitSettings
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.interpolation import choose_interpolation, moving_inputs, with_other_interpolation
from aero_bayes.estimate.levenberg_marquardt import (
    FixedCost,
    LocalResult,
    LocalSettings,
    QuadraticModel,
    Stop,
    levenberg_marquardt,
)
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.objective import Objective, Series
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from aero_bayes.estimate.reduced_problem import with_few_samples
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.search_settings import GlobalSearchSettings
from aero_bayes.estimate.step_rule import CostShape
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.estimate.target import JointTarget, NoiseLayout, Target
from aero_bayes.sensors.noise import NoiseModel, OutputNoise
from aero_bayes.sensors.noise_estimation import estimate_noise
from aero_bayes.sensors.whitening import innovations

__all__ = [
    "CalibratedModel",
    "Calibration",
    "CalibrationSettings",
    "CostShape",
    "Fit",
    "FitSettings",
    "FixedCost",
    "GlobalSearch",
    "GlobalSearchResult",
    "GlobalSearchSettings",
    "JointTarget",
    "LocalFitSettings",
    "LocalResult",
    "LocalSettings",
    "LogNormal",
    "LogUniform",
    "MeasuredData",
    "NoiseLayout",
    "NoiseModel",
    "Normal",
    "Objective",
    "OutputNoise",
    "Override",
    "Parameter",
    "ParameterSet",
    "Prior",
    "QuadraticModel",
    "Series",
    "SimulatedModel",
    "Status",
    "Stop",
    "SwarmSettings",
    "Target",
    "Uniform",
    "calibrate",
    "choose_interpolation",
    "declared_overrides",
    "estimate_noise",
    "fit",
    "fit_calibration",
    "innovations",
    "levenberg_marquardt",
    "local_fit",
    "moving_inputs",
    "parameters_from_model",
    "with_few_samples",
    "with_other_interpolation",
]
