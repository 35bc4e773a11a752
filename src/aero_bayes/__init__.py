"""Modelica model -> FMU -> fit -> posterior -> the effect the model lacks.

A model of a package that declares its rigs brings parameters, priors and columns:

>>> import aero_bayes
>>> model = aero_bayes.load_model("Aero.Systems.HalfQuad")  # doctest: +SKIP
>>> recording = aero_bayes.read_recording("step.csv", model=model)  # doctest: +SKIP
>>> fit = aero_bayes.fit(recording, model)  # doctest: +SKIP
>>> posterior = aero_bayes.sample(fit)  # doctest: +SKIP
>>> loop = aero_bayes.close_loop(recording, model=model)  # doctest: +SKIP

A model of one's own is told what was recorded and what is free (run in ``examples/cart``):

>>> rig = aero_bayes.load_model("Rig.mo")  # doctest: +SKIP
>>> recording = aero_bayes.read_recording("train.csv", inputs=["F"], outputs=["position"])  # doctest: +SKIP
>>> fit = aero_bayes.fit(recording, rig, parameters=["k", "d"])  # doctest: +SKIP
>>> settings = aero_bayes.LoopSettings(parameters=["k", "d"])
>>> loop = aero_bayes.close_loop(recording, model=rig, settings=settings)  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from aero_bayes.figures import IMPORTERS

if TYPE_CHECKING:
    from aero_bayes.commands.fleet import Rig, fleet
    from aero_bayes.data.columns import ColumnMap
    from aero_bayes.data.read import read_recording
    from aero_bayes.data.recording import Recording
    from aero_bayes.errors import CannotFinishError, InputError
    from aero_bayes.estimate.convergence import SampleSettings
    from aero_bayes.estimate.fit import fit
    from aero_bayes.estimate.initial_states import CalibrationSettings
    from aero_bayes.estimate.levenberg_marquardt import FitSettings
    from aero_bayes.estimate.parameters import ParameterSpec
    from aero_bayes.estimate.posterior import Posterior
    from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Uniform
    from aero_bayes.estimate.propose import propose_experiment
    from aero_bayes.estimate.result import Fit
    from aero_bayes.estimate.sample import sample
    from aero_bayes.library import compare, load_result, save
    from aero_bayes.loop.first_fit import LoopSettings
    from aero_bayes.loop.loop import close_loop
    from aero_bayes.loop.result import LoopResult
    from aero_bayes.modelica.compilers import export_fmu
    from aero_bayes.report.run_directory import RunDirectory
    from aero_bayes.simulation.function_model import FunctionModel
    from aero_bayes.simulation.load_model import load_model
    from aero_bayes.simulation.model import Model

__all__ = [
    "CalibrationSettings",
    "CannotFinishError",
    "ColumnMap",
    "Fit",
    "FitSettings",
    "FunctionModel",
    "InputError",
    "LogNormal",
    "LogUniform",
    "LoopResult",
    "LoopSettings",
    "Model",
    "Normal",
    "ParameterSpec",
    "Posterior",
    "Recording",
    "RecordingPrediction",
    "Rig",
    "RunDirectory",
    "SampleSettings",
    "Uniform",
    "close_loop",
    "compare",
    "export_fmu",
    "fit",
    "fleet",
    "load_model",
    "load_result",
    "propose_experiment",
    "read_recording",
    "sample",
    "save",
]


#: By file or room the names that are imported when first used (PEP 562), so that one command pays for one stage.
_HOMES = {
    "commands.fleet": "Rig fleet",
    "data": "ColumnMap Recording read_recording",
    "errors": "CannotFinishError InputError",
    "estimate.fit": "fit",
    "estimate.initial_states": "CalibrationSettings",
    "estimate.levenberg_marquardt": "FitSettings",
    "estimate.prediction": "RecordingPrediction",
    "estimate.parameters": "ParameterSpec",
    "estimate.priors": "LogNormal LogUniform Normal Uniform",
    "estimate.propose": "propose_experiment",
    "estimate.result": "Fit",
    "library": "compare load_result save",
    "loop": "LoopResult LoopSettings close_loop",
    "modelica.compilers": "export_fmu",
    "estimate.convergence": "SampleSettings",
    "estimate.posterior": "Posterior",
    "estimate.sample": "sample",
    "report.run_directory": "RunDirectory",
    "simulation.load_model": "load_model",
    "simulation.model": "Model",
    "simulation.function_model": "FunctionModel",
}


def _import_drawers(name: str) -> None:
    """Import what draws the page of results, or what draws figures: neither before it is asked for."""
    if name == "result_page":
        from aero_bayes import library  # noqa: F401
    else:
        from aero_bayes.report import plots  # noqa: F401


IMPORTERS.append(_import_drawers)


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names.split():
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
