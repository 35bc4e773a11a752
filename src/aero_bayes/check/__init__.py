"""Checks of a fit: tests of its residuals, likelihood profiles, and prediction of what was left out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from aero_bayes.check.blocks import block_edges as block_edges
    from aero_bayes.check.blocks import block_log_likelihood as block_log_likelihood
    from aero_bayes.check.comparison import compare_elpd as compare_elpd
    from aero_bayes.check.comparison import leave_future_out as leave_future_out
    from aero_bayes.check.comparison import leave_one_out as leave_one_out
    from aero_bayes.check.comparison import pooled_blocks as pooled_blocks
    from aero_bayes.check.comparison import waic as waic
    from aero_bayes.check.crossvalidation import leave_one_recording_out as leave_one_recording_out
    from aero_bayes.check.crossvalidation import time_ordered_scores as time_ordered_scores
    from aero_bayes.check.likelihood_profile import LOG_POSTERIOR_DROP_90 as LOG_POSTERIOR_DROP_90
    from aero_bayes.check.likelihood_profile import profile_likelihood as profile_likelihood
    from aero_bayes.check.residual_tests import MAX_FLOOR_RATIO as MAX_FLOOR_RATIO
    from aero_bayes.check.residual_tests import ResidualReport as ResidualReport
    from aero_bayes.check.residual_tests import check_residuals as check_residuals
    from aero_bayes.check.residual_tests import portmanteau_test as portmanteau_test
    from aero_bayes.check.residual_tests import reports_by_recording as reports_by_recording
    from aero_bayes.check.residual_tests import slow_variation_test as slow_variation_test
    from aero_bayes.check.residual_tests import smooth_dependence_test as smooth_dependence_test
    from aero_bayes.check.residual_tests import structured_residuals as structured_residuals

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "blocks": "block_edges block_log_likelihood",
        "comparison": "compare_elpd leave_future_out leave_one_out pooled_blocks waic",
        "crossvalidation": "leave_one_recording_out time_ordered_scores",
        "likelihood_profile": "LOG_POSTERIOR_DROP_90 profile_likelihood",
        "residual_tests": "MAX_FLOOR_RATIO ResidualReport check_residuals portmanteau_test "
        "reports_by_recording slow_variation_test smooth_dependence_test structured_residuals",
    },
)
