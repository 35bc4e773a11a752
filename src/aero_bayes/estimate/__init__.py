"""Fit models to recordings: objective, search, noise, intervals, checks of the residual, diagnosis, next experiment."""

from aero_bayes.estimate.information import Limits, SearchSettings
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import ParameterSpec, parameters_from_model
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Uniform

__all__ = [
    "CalibrationSettings",
    "Limits",
    "LogNormal",
    "LogUniform",
    "NoiseModel",
    "Normal",
    "ParameterSpec",
    "SearchSettings",
    "Uniform",
    "parameters_from_model",
]
