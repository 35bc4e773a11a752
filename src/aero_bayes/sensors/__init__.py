"""What sensors add to the physics: noise, ripple, and the counts of an encoder."""

from aero_bayes.sensors.describe import describe_sensors
from aero_bayes.sensors.noise import NoiseKind, NoiseModel, OutputNoise, SampleTimes
from aero_bayes.sensors.noise_estimation import estimate_noise, update_output_noise
from aero_bayes.sensors.quantisation import (
    describe_quantisation,
    interval_log_density,
    quantum,
    rounding_error,
    thin_constant_readings,
)
from aero_bayes.sensors.ripple import Ripple, find_ripple, find_ripples, is_rotor_speed
from aero_bayes.sensors.whiteness import (
    autocorrelation,
    autocovariance,
    block_variance_ratio,
    correlation_p_value,
    correlation_statistic,
    ripple_means,
)
from aero_bayes.sensors.whitening import LOG_2PI, innovations, log_density, reading_log_density, whiten

__all__ = [
    "LOG_2PI", "NoiseKind", "NoiseModel", "OutputNoise", "Ripple", "SampleTimes", "autocorrelation",
    "autocovariance", "block_variance_ratio", "correlation_p_value", "correlation_statistic",
    "describe_quantisation", "describe_sensors", "estimate_noise", "find_ripple", "find_ripples", "innovations",
    "interval_log_density", "is_rotor_speed", "log_density", "quantum", "reading_log_density", "ripple_means",
    "rounding_error", "thin_constant_readings", "update_output_noise", "whiten",
]  # fmt: skip
