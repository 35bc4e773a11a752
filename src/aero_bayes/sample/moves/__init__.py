"""Moves of an ensemble: one a file, each of them leaves the target distribution unchanged."""

from aero_bayes.sample.moves.differential import DifferentialMove
from aero_bayes.sample.moves.heavytail import WarpedStudentT
from aero_bayes.sample.moves.independence import IndependenceMove
from aero_bayes.sample.moves.screened import ScreenedMove, ScreenedWalkMove
from aero_bayes.sample.moves.shear import Shear
from aero_bayes.sample.moves.stretch import StretchMove
from aero_bayes.sample.moves.surrogate import Surrogate
from aero_bayes.sample.moves.warp import Warp

__all__ = [
    "DifferentialMove",
    "IndependenceMove",
    "ScreenedMove",
    "ScreenedWalkMove",
    "Shear",
    "StretchMove",
    "Surrogate",
    "Warp",
    "WarpedStudentT",
]
