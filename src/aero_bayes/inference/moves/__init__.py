"""Moves of an ensemble: one a file, each of them leaves the target distribution unchanged."""

from aero_bayes.inference.moves.differential import DifferentialMove
from aero_bayes.inference.moves.heavytail import HeavyTail
from aero_bayes.inference.moves.independence import IndependenceMove
from aero_bayes.inference.moves.screened import ScreenedMove, ScreenedWalkMove
from aero_bayes.inference.moves.shear import Shear
from aero_bayes.inference.moves.stretch import StretchMove
from aero_bayes.inference.moves.surrogate import Surrogate
from aero_bayes.inference.moves.warp import Warp

__all__ = [
    "DifferentialMove",
    "HeavyTail",
    "IndependenceMove",
    "ScreenedMove",
    "ScreenedWalkMove",
    "Shear",
    "StretchMove",
    "Surrogate",
    "Warp",
]
