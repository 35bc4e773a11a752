"""Fit models to recordings: objective, search, noise, intervals, checks of the residual, diagnosis, next experiment."""

from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.calibration import Calibration, SimulatedModel, calibrate
from aero_bayes.estimate.delays import with_few_samples
from aero_bayes.estimate.diagnose import diagnose
from aero_bayes.estimate.fit import declared_overrides, fit, fit_calibration
from aero_bayes.estimate.global_search import GlobalSearch, GlobalSearchResult
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.information import Limits
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.interpolation import choose_interpolation, moving_inputs, with_other_interpolation
from aero_bayes.estimate.levenberg_marquardt import (
    FitSettings,
    FixedCost,
    GlobalSearchSettings,
    LocalResult,
    LocalSettings,
    QuadraticModel,
    Stop,
    levenberg_marquardt,
)
from aero_bayes.estimate.likelihood_profile import profile_likelihood
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import NoiseModel, OutputNoise, SampleTimes
from aero_bayes.estimate.noise_estimation import (
    estimate_noise,
    innovations,
    log_density,
    reading_log_density,
    update_output_noise,
    whiten,
)
from aero_bayes.estimate.objective import Objective, Series
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from aero_bayes.estimate.propose import Design, propose_experiment
from aero_bayes.estimate.quantisation import (
    describe_quantisation,
    interval_log_density,
    quantum,
    rounding_error,
    thin_constant_readings,
)
from aero_bayes.estimate.residual_tests import (
    ResidualReport,
    check_residuals,
    portmanteau_test,
    slow_variation_test,
    smooth_dependence_test,
)
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.separation import Separation, expected_outputs, separating_experiment
from aero_bayes.estimate.signal_search import FAMILIES, SearchSettings
from aero_bayes.estimate.step_rule import CostShape
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.estimate.target import JointTarget, NoiseLayout, Target
from aero_bayes.estimate.whiteness import (
    autocorrelation,
    correlation_p_value,
    correlation_statistic,
    is_rotor_speed,
    ripple_means,
)

__all__ = [
    "FAMILIES",
    "CalibratedModel",
    "Calibration",
    "CalibrationSettings",
    "CostShape",
    "Design",
    "Fit",
    "FitSettings",
    "FixedCost",
    "GlobalSearch",
    "GlobalSearchResult",
    "GlobalSearchSettings",
    "JointTarget",
    "Limits",
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
    "ResidualReport",
    "SampleTimes",
    "SearchSettings",
    "Separation",
    "Series",
    "SimulatedModel",
    "Status",
    "Stop",
    "SwarmSettings",
    "Target",
    "Uniform",
    "autocorrelation",
    "calibrate",
    "check_residuals",
    "choose_interpolation",
    "correlation_p_value",
    "correlation_statistic",
    "declared_overrides",
    "describe_quantisation",
    "diagnose",
    "estimate_noise",
    "expected_outputs",
    "fit",
    "fit_calibration",
    "innovations",
    "interval_log_density",
    "is_rotor_speed",
    "levenberg_marquardt",
    "local_fit",
    "log_density",
    "moving_inputs",
    "parameters_from_model",
    "portmanteau_test",
    "profile_likelihood",
    "propose_experiment",
    "quantum",
    "reading_log_density",
    "ripple_means",
    "rounding_error",
    "separating_experiment",
    "slow_variation_test",
    "smooth_dependence_test",
    "thin_constant_readings",
    "update_output_noise",
    "whiten",
    "with_few_samples",
    "with_other_interpolation",
]
