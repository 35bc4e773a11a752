"""What sensors add to the physics: noise, and the counts of an encoder."""

from aero_bayes.sensors.noise import OutputNoise, SampleTimes
from aero_bayes.sensors.noise_estimation import update_output_noise
from aero_bayes.sensors.quantisation import (
    describe_quantisation,
    interval_log_density,
    quantum,
    rounding_error,
    thin_constant_readings,
)
from aero_bayes.sensors.whiteness import (
    autocorrelation,
    correlation_p_value,
    correlation_statistic,
    is_rotor_speed,
    ripple_means,
)
from aero_bayes.sensors.whitening import innovations, log_density, reading_log_density, whiten

__all__ = [
    "OutputNoise", "SampleTimes", "autocorrelation",
    "correlation_p_value", "correlation_statistic",
    "describe_quantisation", "innovations",
    "interval_log_density", "is_rotor_speed", "log_density", "quantum", "reading_log_density", "ripple_means",
    "rounding_error", "thin_constant_readings", "update_output_noise", "whiten",
]  # fmt: skip
