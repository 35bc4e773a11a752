"""Modelica model -> FMU -> fit -> posterior -> the effect the model lacks.

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
>>> settings = aero_bayes.LoopSettings(parameters=["k", "d"])
>>> loop = aero_bayes.close_loop(recording, model=rig, settings=settings)  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from aero_bayes.diagnosis_backend import register_diagnosis
from aero_bayes.plot_backend import register_plot_backend

if TYPE_CHECKING:
    from collections.abc import Callable

    from aero_bayes.data import Recording, read_recording, summarise
    from aero_bayes.design import propose_experiment
    from aero_bayes.errors import CannotFinishError, InputError
    from aero_bayes.estimate import Fit, FitSettings
    from aero_bayes.estimate.diagnosis import Diagnosis
    from aero_bayes.estimate.fit import fit
    from aero_bayes.export import export_fmu
    from aero_bayes.fleets import Rig
    from aero_bayes.fleets.whole import fleet
    from aero_bayes.library import compare, load_result, save, write_report
    from aero_bayes.loop import LoopResult, LoopSettings, close_loop
    from aero_bayes.plot_backend import PlotBackend
    from aero_bayes.report.run_directory import RunDirectory
    from aero_bayes.sampling import Posterior, SampleSettings, sample
    from aero_bayes.simulation import Model, PythonModel
    from aero_bayes.simulation.load_model import load_model

__all__ = [
    "CannotFinishError",
    "Fit",
    "FitSettings",
    "InputError",
    "LoopResult",
    "LoopSettings",
    "Model",
    "Posterior",
    "PythonModel",
    "Recording",
    "RecordingPrediction",
    "Rig",
    "RunDirectory",
    "SampleSettings",
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
    "summarise",
    "write_report",
]


#: By file or room the names that are imported when first used (PEP 562), so that one command pays for one stage.
_HOMES = {
    "data": "Recording read_recording summarise",
    "design": "propose_experiment",
    "errors": "CannotFinishError InputError",
    "estimate": "Fit FitSettings fit",
    "estimate.prediction": "RecordingPrediction",
    "export": "export_fmu",
    "fleets": "Rig",
    "fleets.whole": "fleet",
    "library": "compare load_result save write_report",
    "loop": "LoopResult LoopSettings close_loop",
    "report.run_directory": "RunDirectory",
    "sampling": "Posterior SampleSettings sample",
    "simulation": "Model PythonModel",
    "simulation.load_model": "load_model",
}


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names.split():
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


def _plots() -> PlotBackend:
    from aero_bayes import plots

    return plots


register_plot_backend(_plots)


def _diagnosis() -> Callable[[Fit], Diagnosis]:
    from aero_bayes.diagnosis import diagnose

    return diagnose


register_diagnosis(_diagnosis)
