"""Sample the posterior of a fit, and predict recordings from its draws."""

from aero_bayes.sampling.adaptation import Adaptation
from aero_bayes.sampling.diagnostics import Convergence, autocorrelation_time, check_convergence, r_hat
from aero_bayes.sampling.evidence import importance_posterior, laplace_evidence
from aero_bayes.sampling.importance import WeightedSample, adaptive_importance_sample, importance_sample, pareto_smooth
from aero_bayes.sampling.mcmc import Chain, run_chain
from aero_bayes.sampling.posterior import Posterior
from aero_bayes.sampling.predictive import posterior_predictive
from aero_bayes.sampling.sample import sample
from aero_bayes.sampling.settings import SampleSettings
from aero_bayes.sampling.standard_moves import MakeMoves, standard_moves

__all__ = [
    "Adaptation",
    "Chain",
    "Convergence",
    "MakeMoves",
    "Posterior",
    "SampleSettings",
    "WeightedSample",
    "adaptive_importance_sample",
    "autocorrelation_time",
    "check_convergence",
    "importance_posterior",
    "importance_sample",
    "laplace_evidence",
    "pareto_smooth",
    "posterior_predictive",
    "r_hat",
    "run_chain",
    "sample",
    "standard_moves",
]
