"""A finished run, or several side by side, as one self-contained HTML page."""

from aero_bayes.report.compare import write_comparison
from aero_bayes.report.page import write_run_page

__all__ = ["write_comparison", "write_run_page"]
