"""Estimate parameters and their uncertainty from recordings."""

from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.calibration import Calibration, calibrate
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.fit import FitSettings, fit, fit_calibration
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.identifiability import Combination, Identifiability, Status
from aero_bayes.estimate.interpolation import choose_interpolation, moving_inputs, with_other_interpolation
from aero_bayes.estimate.laplace import Laplace, curvature_adjustment
from aero_bayes.estimate.levenberg_marquardt import (
    CostFunction,
    FixedCost,
    LocalResult,
    LocalSettings,
    QuadraticModel,
    Stop,
    levenberg_marquardt,
)
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.objective import Objective, Series
from aero_bayes.estimate.parameter_estimates import Estimate
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.prediction import RecordingPrediction
from aero_bayes.estimate.predictive import Predictive
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from aero_bayes.estimate.reduced_problem import with_few_samples
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.ripple_removal import without_ripple
from aero_bayes.estimate.search_settings import GlobalSearchSettings
from aero_bayes.estimate.stage_report import StageReport
from aero_bayes.estimate.staged import Stage, causal_stages
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
    "Combination",
    "CostFunction",
    "CostShape",
    "Estimate",
    "Fit",
    "FitSettings",
    "FixedCost",
    "GlobalSearch",
    "GlobalSearchResult",
    "GlobalSearchSettings",
    "Identifiability",
    "JointTarget",
    "Laplace",
    "LocalFitSettings",
    "LocalResult",
    "LocalSettings",
    "LogNormal",
    "LogUniform",
    "NoiseLayout",
    "NoiseModel",
    "Normal",
    "Objective",
    "Optimum",
    "OutputNoise",
    "Override",
    "Parameter",
    "ParameterSet",
    "Predictive",
    "Prior",
    "QuadraticModel",
    "RecordingPrediction",
    "Series",
    "Stage",
    "StageReport",
    "Status",
    "Stop",
    "SwarmSettings",
    "Target",
    "Uniform",
    "calibrate",
    "causal_stages",
    "choose_interpolation",
    "curvature_adjustment",
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
    "without_ripple",
]
