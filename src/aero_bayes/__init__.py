"""Modelica model -> FMU -> fit -> honest posterior -> the effect the model lacks.

>>> import aero_bayes
>>> model = aero_bayes.load_model("Aero.Systems.HalfQuad")  # a Modelica class, or the path of an FMU
>>> recordings = aero_bayes.read_recording("step.csv")
>>> fit = aero_bayes.fit(recordings, model)
>>> posterior = aero_bayes.sample(fit)
>>> loop = aero_bayes.close_loop([recordings], model="Aero.Systems.HalfQuad")
"""

from aero_bayes.data import Recording, read_recording, summarise
from aero_bayes.discrepancy import LoopResult, close_loop
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.export import export_fmu
from aero_bayes.inference import Fit, FitSettings, Posterior, SampleSettings, fit, sample
from aero_bayes.library import load_model
from aero_bayes.report import write_report
from aero_bayes.simulation import Model

__all__ = [
    "CannotFinishError",
    "Fit",
    "FitSettings",
    "InputError",
    "LoopResult",
    "Model",
    "Posterior",
    "Recording",
    "SampleSettings",
    "close_loop",
    "export_fmu",
    "fit",
    "load_model",
    "read_recording",
    "sample",
    "summarise",
    "write_report",
]
