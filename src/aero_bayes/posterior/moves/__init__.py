"""Moves of an ensemble: one a file, each of them leaves the target distribution unchanged."""

from aero_bayes.posterior.moves.surrogate import Surrogate
from aero_bayes.posterior.moves.warped_student_t import (
    DelayedAcceptanceMove,
    DelayedAcceptanceWalkMove,
    DifferentialMove,
    IndependenceMove,
    StretchMove,
    TriangularMap,
    Warp,
    WarpedStudentT,
)

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
