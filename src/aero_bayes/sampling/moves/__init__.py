"""Moves of an ensemble: one a file, each of them leaves the target distribution unchanged."""

from aero_bayes.sampling.moves.delayed_acceptance import DelayedAcceptanceMove, DelayedAcceptanceWalkMove
from aero_bayes.sampling.moves.differential import DifferentialMove
from aero_bayes.sampling.moves.independence import IndependenceMove
from aero_bayes.sampling.moves.stretch import StretchMove
from aero_bayes.sampling.moves.surrogate import Surrogate
from aero_bayes.sampling.moves.triangular_map import TriangularMap
from aero_bayes.sampling.moves.warp import Warp
from aero_bayes.sampling.moves.warped_student_t import WarpedStudentT

__all__ = [
    "DelayedAcceptanceMove",
    "DelayedAcceptanceWalkMove",
    "DifferentialMove",
    "IndependenceMove",
    "StretchMove",
    "Surrogate",
    "TriangularMap",
    "Warp",
    "WarpedStudentT",
]
