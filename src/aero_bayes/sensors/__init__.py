"""What sensors add to the physics: noise, ripple, and the counts of an encoder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from aero_bayes.sensors.describe import describe_sensors as describe_sensors
    from aero_bayes.sensors.noise import NoiseKind as NoiseKind
    from aero_bayes.sensors.noise import NoiseModel as NoiseModel
    from aero_bayes.sensors.noise import OutputNoise as OutputNoise
    from aero_bayes.sensors.noise import SampleTimes as SampleTimes
    from aero_bayes.sensors.noise_estimation import estimate_noise as estimate_noise
    from aero_bayes.sensors.noise_estimation import update_output_noise as update_output_noise
    from aero_bayes.sensors.quantisation import describe_quantisation as describe_quantisation
    from aero_bayes.sensors.quantisation import interval_log_density as interval_log_density
    from aero_bayes.sensors.quantisation import quantum as quantum
    from aero_bayes.sensors.quantisation import rounding_error as rounding_error
    from aero_bayes.sensors.quantisation import thin_constant_readings as thin_constant_readings
    from aero_bayes.sensors.ripple import Ripple as Ripple
    from aero_bayes.sensors.ripple import find_ripple as find_ripple
    from aero_bayes.sensors.ripple import find_ripples as find_ripples
    from aero_bayes.sensors.ripple import is_rotor_speed as is_rotor_speed
    from aero_bayes.sensors.whiteness import autocorrelation as autocorrelation
    from aero_bayes.sensors.whiteness import autocovariance as autocovariance
    from aero_bayes.sensors.whiteness import block_variance_ratio as block_variance_ratio
    from aero_bayes.sensors.whitening import LOG_2PI as LOG_2PI
    from aero_bayes.sensors.whitening import innovations as innovations
    from aero_bayes.sensors.whitening import log_density as log_density
    from aero_bayes.sensors.whitening import reading_log_density as reading_log_density
    from aero_bayes.sensors.whitening import whiten as whiten

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "describe": "describe_sensors",
        "noise": "NoiseKind NoiseModel OutputNoise SampleTimes",
        "noise_estimation": "estimate_noise update_output_noise",
        "quantisation": "describe_quantisation interval_log_density quantum rounding_error thin_constant_readings",
        "ripple": "Ripple find_ripple find_ripples is_rotor_speed",
        "whiteness": "autocorrelation autocovariance block_variance_ratio",
        "whitening": "LOG_2PI innovations log_density reading_log_density whiten",
    },
)
