"""From a fit to its posterior: independent ensembles of walkers, and what they say."""

from aero_bayes.sample.mcmc import SampleSettings
from aero_bayes.sample.posterior import Posterior, sample
from aero_bayes.sample.predictive import Predictive

__all__ = ["Posterior", "Predictive", "SampleSettings", "sample"]
