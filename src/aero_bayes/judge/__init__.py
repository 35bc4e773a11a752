"""What a model predicts of recordings, fitted and unseen, and how far it is off."""

from aero_bayes.judge.prediction import Prediction, RmsError, describe_error_change, rms_error
from aero_bayes.judge.recordings import Recordings
from aero_bayes.judge.unseen import Unseen

__all__ = ["Prediction", "Recordings", "RmsError", "Unseen", "describe_error_change", "rms_error"]
