"""From a fit to its posterior: independent ensembles of walkers, and what they say."""

from aero_bayes.sample.mcmc import SampleSettings
from aero_bayes.sample.posterior import Posterior
from aero_bayes.sample.prediction import RecordingPrediction
from aero_bayes.sample.predictive import Predictive
from aero_bayes.sample.sample import sample

__all__ = ["Posterior", "Predictive", "RecordingPrediction", "SampleSettings", "sample"]
