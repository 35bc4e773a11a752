"""A finished run as one self-contained HTML page."""

from aero_bayes.report.page import write_report
from aero_bayes.report.tables import Column, html_table

__all__ = ["Column", "html_table", "write_report"]
