"""Sample the posterior of a fit, and predict recordings from its draws."""

from aero_bayes.posterior.adaptation import Adaptation
from aero_bayes.posterior.inferencedata import autocorrelation_time, check_convergence, r_hat
from aero_bayes.posterior.mcmc import Chain, MakeMoves, run_chain, standard_moves
from aero_bayes.posterior.posterior import Posterior
from aero_bayes.posterior.sample import posterior_predictive, sample
from aero_bayes.posterior.settings import SampleSettings

__all__ = [
    "Adaptation",
    "Chain",
    "MakeMoves",
    "Posterior",
    "SampleSettings",
    "autocorrelation_time",
    "check_convergence",
    "posterior_predictive",
    "r_hat",
    "run_chain",
    "sample",
    "standard_moves",
]
