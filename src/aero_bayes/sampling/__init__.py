"""Sample the posterior of a fit, and predict recordings from its draws."""

from aero_bayes.sampling.adaptation import Adaptation
from aero_bayes.sampling.diagnostics import autocorrelation_time, check_convergence, r_hat
from aero_bayes.sampling.evidence import laplace_evidence
from aero_bayes.sampling.mcmc import Chain, run_chain
from aero_bayes.sampling.posterior import Posterior
from aero_bayes.sampling.predictive import posterior_predictive
from aero_bayes.sampling.sample import sample
from aero_bayes.sampling.settings import SampleSettings
from aero_bayes.sampling.standard_moves import MakeMoves, standard_moves

__all__ = [
    "Adaptation",
    "Chain",
    "MakeMoves",
    "Posterior",
    "SampleSettings",
    "autocorrelation_time",
    "check_convergence",
    "laplace_evidence",
    "posterior_predictive",
    "r_hat",
    "run_chain",
    "sample",
    "standard_moves",
]
