"""The next experiment: the input that would tell most about what is still uncertain."""

from aero_bayes.design.check import GainCheck, check_gain
from aero_bayes.design.check_separation import SeparationCheck, check_separation
from aero_bayes.design.families import FAMILIES, Family
from aero_bayes.design.forecast import Forecast, forecast
from aero_bayes.design.information import Limits
from aero_bayes.design.optimise import SearchSettings
from aero_bayes.design.propose import Design, propose_experiment
from aero_bayes.design.separate import Separation, separating_experiment

__all__ = [
    "FAMILIES",
    "Design",
    "Family",
    "Forecast",
    "GainCheck",
    "Limits",
    "SearchSettings",
    "Separation",
    "SeparationCheck",
    "check_gain",
    "check_separation",
    "forecast",
    "propose_experiment",
    "separating_experiment",
]
