"""The search over model structures: structures, edits, start rules, left-out errors, a beam."""

from aero_bayes.search.beam import StructureSearch
from aero_bayes.search.common_noise import common_noise
from aero_bayes.search.comparison import Comparison, Share
from aero_bayes.search.edits import EDITS, Edit, EditContext, likely_pairs, term_directions
from aero_bayes.search.explored import Library, SearchControl, SearchResult
from aero_bayes.search.left_out import CommonBlocks, newton_errors, refitted_errors
from aero_bayes.search.models import CandidateModel, FitNoise, FittedModel, ModelCache, ModelSource
from aero_bayes.search.parts import PARTS, Parts
from aero_bayes.search.restarts import Restart
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import START_RULES, Start, StartRule, starting_points
from aero_bayes.search.structure import Structure

__all__ = [
    "EDITS",
    "PARTS",
    "START_RULES",
    "CandidateModel",
    "CommonBlocks",
    "Comparison",
    "Edit",
    "EditContext",
    "FitNoise",
    "FittedModel",
    "Library",
    "ModelCache",
    "ModelSource",
    "Parts",
    "Restart",
    "SearchControl",
    "SearchResult",
    "Share",
    "Start",
    "StartRule",
    "Structure",
    "StructureSearch",
    "StructureSettings",
    "common_noise",
    "likely_pairs",
    "newton_errors",
    "refitted_errors",
    "starting_points",
    "term_directions",
]
