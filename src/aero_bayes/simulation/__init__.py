"""FMU + inputs + parameters -> trajectories, sensitivities and likelihoods."""

from aero_bayes.simulation.engines import open_simulator

__all__ = ["open_simulator"]
