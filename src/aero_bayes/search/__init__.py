"""The search over structures: models with laws attached, what laws promise, left-out errors, and a table of them."""

from aero_bayes.search.left_out import Blocks, newton_errors, refitted_errors
from aero_bayes.search.models import CandidateModel, FittedModel, Models, ModelSource
from aero_bayes.search.screen import Promise, Screen, Screened
from aero_bayes.search.search import Control, Library, Search
from aero_bayes.search.table import Row, Table

__all__ = [
    "Blocks",
    "CandidateModel",
    "Control",
    "FittedModel",
    "Library",
    "ModelSource",
    "Models",
    "Promise",
    "Row",
    "Screen",
    "Screened",
    "Search",
    "Table",
    "newton_errors",
    "refitted_errors",
]
