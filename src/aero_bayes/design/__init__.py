"""The next experiment: the input that would tell most about what is still uncertain."""

from aero_bayes.design.expected_outputs import expected_outputs
from aero_bayes.design.information import Limits
from aero_bayes.design.propose import Design, propose_experiment
from aero_bayes.design.separation import Separation, separating_experiment
from aero_bayes.design.signal_families import FAMILIES
from aero_bayes.design.signal_search import SearchSettings

__all__ = [
    "FAMILIES",
    "Design",
    "Limits",
    "SearchSettings",
    "Separation",
    "expected_outputs",
    "propose_experiment",
    "separating_experiment",
]
