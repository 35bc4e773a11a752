"""Moves of an ensemble: one a file, each of them leaves the target distribution unchanged."""

from aero_bayes.sample.moves.differential import DifferentialMove
from aero_bayes.sample.moves.independence import HeavyTail, IndependenceMove
from aero_bayes.sample.moves.stretch import StretchMove
from aero_bayes.sample.moves.warp import Warp

__all__ = ["DifferentialMove", "HeavyTail", "IndependenceMove", "StretchMove", "Warp"]
