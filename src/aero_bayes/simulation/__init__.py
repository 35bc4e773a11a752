"""FMU + inputs + parameters -> trajectories, sensitivities and likelihoods."""

from aero_bayes.simulation.engine_library import engine_path
from aero_bayes.simulation.engines import engine_of, open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    DiffusionTarget,
    Experiment,
    GaussNewton,
    InputSignal,
    InputTarget,
    Interpolation,
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
from aero_bayes.simulation.model import Model, ModelicaSource
from aero_bayes.simulation.model_description import BINARY_FOLDERS, Variable
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.python_model import PythonModel
from aero_bayes.simulation.workers import MAX_LOST_RUNS, WorkerPool

__all__ = [
    "BINARY_FOLDERS",
    "MAX_LOST_RUNS",
    "DelayTarget",
    "DiffusionTarget",
    "Experiment",
    "GaussNewton",
    "InputSignal",
    "InputTarget",
    "Interpolation",
    "Likelihoods",
    "Model",
    "ModelicaSource",
    "NativeSimulator",
    "Outcome",
    "ParameterTarget",
    "Problem",
    "ProblemTarget",
    "ProcessNoise",
    "PythonModel",
    "ReadingNoiseTarget",
    "Simulator",
    "SolverSettings",
    "StartTarget",
    "Trajectories",
    "Variable",
    "WorkerPool",
    "engine_of",
    "engine_path",
    "open_simulator",
]
