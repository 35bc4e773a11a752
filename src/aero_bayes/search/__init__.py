"""The search over structures: models with laws attached, what laws promise, left-out errors, and a table of them."""

from aero_bayes.search.left_out import Blocks, newton_errors, refitted_errors
from aero_bayes.search.models import CandidateModel, FittedModel
from aero_bayes.search.search import Search
from aero_bayes.search.table import Row, Table

__all__ = ["Blocks", "CandidateModel", "FittedModel", "Row", "Search", "Table", "newton_errors", "refitted_errors"]
