"""The search over model structures: structures, edits, start rules, one score, a beam."""

from aero_bayes.search.edits import Edit, Surroundings
from aero_bayes.search.models import FittedModel
from aero_bayes.search.parts import PARTS, Parts
from aero_bayes.search.restarts import Restart
from aero_bayes.search.settings import StructureSettings
from aero_bayes.search.starts import Start, StartRule
from aero_bayes.search.structure import Structure

__all__ = [
    "PARTS",
    "Edit",
    "FittedModel",
    "Parts",
    "Restart",
    "Start",
    "StartRule",
    "Structure",
    "StructureSettings",
    "Surroundings",
]
