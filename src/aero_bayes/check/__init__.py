"""Checks of a fit: tests of its residuals, likelihood profiles, and prediction of what was left out.

``comparison`` and ``crossvalidation`` are imported from their files: they need the sampler, which takes a second.
"""

from aero_bayes.check.blocks import block_edges, block_log_likelihood
from aero_bayes.check.likelihood_profile import LOG_POSTERIOR_DROP_90, profile_likelihood
from aero_bayes.check.residual_tests import (
    MAX_FLOOR_RATIO,
    ResidualReport,
    check_residuals,
    portmanteau_test,
    reports_by_recording,
    slow_variation_test,
    smooth_dependence_test,
    structured_residuals,
)

__all__ = [
    "LOG_POSTERIOR_DROP_90", "MAX_FLOOR_RATIO", "ResidualReport", "block_edges", "block_log_likelihood",
    "check_residuals", "portmanteau_test", "profile_likelihood", "reports_by_recording", "slow_variation_test",
    "smooth_dependence_test", "structured_residuals",
]  # fmt: skip
