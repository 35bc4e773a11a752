"""FMU + inputs + parameters -> trajectories, sensitivities and likelihoods."""

from aero_bayes.simulation.engines import engine_of, open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    DiffusionTarget,
    Experiment,
    Filter,
    Filtered,
    FilteredStates,
    GaussNewton,
    InputSignal,
    InputTarget,
    Likelihoods,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    ProcessNoise,
    ReadingNoiseTarget,
    Simulator,
    SolverSettings,
    StartTarget,
    Trajectories,
)
from aero_bayes.simulation.model import Model, Variable
from aero_bayes.simulation.native import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool

__all__ = [
    "DelayTarget",
    "DiffusionTarget",
    "Experiment",
    "Filter",
    "Filtered",
    "FilteredStates",
    "GaussNewton",
    "InputSignal",
    "InputTarget",
    "Likelihoods",
    "Model",
    "NativeSimulator",
    "Outcome",
    "ParameterTarget",
    "Problem",
    "ProblemTarget",
    "ProcessNoise",
    "ReadingNoiseTarget",
    "Simulator",
    "SolverSettings",
    "StartTarget",
    "Trajectories",
    "Variable",
    "WorkerPool",
    "engine_of",
    "open_simulator",
]
