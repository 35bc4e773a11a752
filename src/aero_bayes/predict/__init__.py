"""A fitted model on other inputs: its outputs, and the band that the posterior draws about them."""

from aero_bayes.predict.carry import first_reading, typical
from aero_bayes.predict.prediction import RecordingPrediction, predict
from aero_bayes.predict.simulate import simulate

__all__ = ["RecordingPrediction", "first_reading", "predict", "simulate", "typical"]
