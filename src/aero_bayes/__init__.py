"""Modelica model -> FMU -> fit -> honest posterior -> the effect the model lacks.

A model of a package that declares its rigs brings parameters, priors and columns:

>>> import aero_bayes
>>> model = aero_bayes.load_model("Aero.Systems.HalfQuad")  # doctest: +SKIP
>>> recording = aero_bayes.read_recording("step.csv")  # doctest: +SKIP
>>> fit = aero_bayes.fit(recording, model)  # doctest: +SKIP
>>> posterior = aero_bayes.sample(fit)  # doctest: +SKIP
>>> loop = aero_bayes.close_loop(recording, model=model)  # doctest: +SKIP

A model of one's own is told what was recorded and what is free (run in ``examples/cart``):

>>> from aero_bayes.data import Layout
>>> rig = aero_bayes.load_model("Rig.mo")  # doctest: +SKIP
>>> layout = Layout.of(["F"], ["position"])
>>> recording = aero_bayes.read_recording("train.csv", layout=layout)  # doctest: +SKIP
>>> fit = aero_bayes.fit(recording, rig, parameters=["k", "d"])  # doctest: +SKIP
>>> settings = aero_bayes.LoopSettings(free=["k", "d"])
>>> loop = aero_bayes.close_loop(recording, model=rig, settings=settings)  # doctest: +SKIP
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from aero_bayes.plot_backend import register_plot_backend

if TYPE_CHECKING:
    from aero_bayes.data import Recording, read_recording, summarise
    from aero_bayes.design import propose_experiment
    from aero_bayes.errors import CannotFinishError, InputError
    from aero_bayes.estimate import Fit, FitSettings
    from aero_bayes.estimate.fit import fit
    from aero_bayes.export import export_fmu
    from aero_bayes.fleet import Rig, fleet
    from aero_bayes.library import open_run, write_report
    from aero_bayes.loop import LoopResult, LoopSettings, close_loop
    from aero_bayes.plot_backend import PlotBackend
    from aero_bayes.report.run_directory import RunDirectory
    from aero_bayes.sample import Posterior, SampleSettings, sample
    from aero_bayes.simulation import Model
    from aero_bayes.simulation.load_model import load_model

#: The public names and where each lives; they are imported when first used, so that one command pays for one stage.
_HOME = {
    "Recording": "data",
    "read_recording": "data",
    "summarise": "data",
    "propose_experiment": "design",
    "LoopResult": "loop",
    "LoopSettings": "loop",
    "close_loop": "loop",
    "CannotFinishError": "errors",
    "InputError": "errors",
    "export_fmu": "export",
    "Fit": "estimate",
    "FitSettings": "estimate",
    "Posterior": "sample",
    "SampleSettings": "sample",
    "fit": "estimate",
    "Rig": "fleet",
    "fleet": "fleet",
    "sample": "sample",
    "load_model": "simulation.load_model",
    "open_run": "library",
    "RecordingPrediction": "estimate",
    "RunDirectory": "report.run_directory",
    "write_report": "library",
    "Model": "simulation",
}

__all__ = [
    "CannotFinishError",
    "Fit",
    "FitSettings",
    "InputError",
    "LoopResult",
    "LoopSettings",
    "Model",
    "Posterior",
    "Recording",
    "RecordingPrediction",
    "Rig",
    "RunDirectory",
    "SampleSettings",
    "close_loop",
    "export_fmu",
    "fit",
    "fleet",
    "load_model",
    "open_run",
    "propose_experiment",
    "read_recording",
    "sample",
    "summarise",
    "write_report",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__


def _plots() -> PlotBackend:
    from aero_bayes import plots

    return plots


register_plot_backend(_plots)


class _Package(ModuleType):
    """The function ``sample`` keeps its name although its room is called so too."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
