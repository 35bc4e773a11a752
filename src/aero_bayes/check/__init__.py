"""Checks of a fit: tests of its residuals, likelihood profiles, and prediction of what was left out.

``comparison`` and ``crossvalidation`` are imported from their files: they need the sampler, which takes a second.
"""

from aero_bayes.check.blocks import block_edges, block_log_likelihood
from aero_bayes.check.likelihood_profile import profile_likelihood
from aero_bayes.check.residual_tests import (
    ResidualReport,
    check_residuals,
    portmanteau_test,
    slow_variation_test,
    smooth_dependence_test,
)

__all__ = [
    "ResidualReport", "block_edges", "block_log_likelihood",
    "check_residuals", "portmanteau_test", "profile_likelihood", "slow_variation_test",
    "smooth_dependence_test",
]  # fmt: skip
