"""Sample the posterior of a fit, and predict recordings from its draws."""

from aero_bayes.sample.adaptation import Adaptation
from aero_bayes.sample.diagnostics import Diagnosis, autocorrelation_time, diagnose, r_hat
from aero_bayes.sample.evidence import importance_posterior, laplace_evidence
from aero_bayes.sample.importance import WeightedSample, adaptive_importance_sample, importance_sample, pareto_smooth
from aero_bayes.sample.mcmc import Chain, run_chain
from aero_bayes.sample.posterior import Posterior
from aero_bayes.sample.predictive import posterior_predictive
from aero_bayes.sample.sample import sample
from aero_bayes.sample.settings import SampleSettings
from aero_bayes.sample.standard_moves import MakeMoves, standard_moves

__all__ = [
    "Adaptation",
    "Chain",
    "Diagnosis",
    "MakeMoves",
    "Posterior",
    "SampleSettings",
    "WeightedSample",
    "adaptive_importance_sample",
    "autocorrelation_time",
    "diagnose",
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
