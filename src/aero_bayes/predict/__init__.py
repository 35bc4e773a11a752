"""A fitted model on other inputs: its outputs, and the band that the posterior draws about them."""

from aero_bayes.predict.carry import first_reading, typical
from aero_bayes.predict.forecast import Forecast, predict
from aero_bayes.predict.simulate import simulate

__all__ = ["Forecast", "first_reading", "predict", "simulate", "typical"]
