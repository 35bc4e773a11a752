"""A fit in a folder: what simulations and predictions need of it, beside the FMU that was fitted."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import write_arrays
from aero_bayes.data.recording import Recording, to_experiment
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.intervals import Laplace
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.prediction import FittedPredictor
from aero_bayes.estimate.priors import Uniform
from aero_bayes.estimate.result import Fit, parameter_draws
from aero_bayes.files import whole_file
from aero_bayes.plain import plain
from aero_bayes.simulation.interface import DelayTarget, ParameterTarget, SolverSettings, StartTarget
from aero_bayes.simulation.model import Model

#: Names of the files.
VALUES, MODEL = "fit.npz", "model.fmu"
#: What a parameter acts on, by its name in the file.
_TARGETS = {kind.__name__: kind for kind in (ParameterTarget, StartTarget, DelayTarget)}


@dataclass(frozen=True)
class StoredFit:
    """A fit that was read from a folder."""

    predictor: FittedPredictor
    laplace: Laplace

    def points(self, draws: int, seed: int, posterior: Mapping[str, FloatArray]) -> FloatArray:
        """Return draws of free and noise parameters: those of a posterior where it has all, else of the Gaussian."""
        names = self.laplace.names
        if names and all(name in posterior for name in names):
            every = np.column_stack([posterior[name].ravel() for name in names])
            return np.asarray(every[np.unique(np.linspace(0, len(every) - 1, min(draws, len(every))).astype(np.int64))])
        p = self.predictor
        return parameter_draws(self.laplace, p.calibration.parameters, p.values, p.free, draws, seed)


def store(fit: Fit, folder: Path) -> None:
    """Write a fit beside the files of its run; nothing where its model is no FMU, or has process noise."""
    calibration, predictor = fit.calibration, fit.predictor
    data = calibration.data
    if calibration.process is not None or calibration.model.interface == "python":
        return
    told = {
        "outputs": data.outputs, "names": data.names, "sha256": [r.sha256 for r in data.recordings],
        "units": [dict(r.units) for r in data.recordings], "known": [dict(r.known) for r in data.recordings],
        "start": [dict(e.start) for e in data.experiments],
        "interpolation": [{s.name: s.interpolation for s in e.inputs} for e in data.experiments],
        "fixed": calibration.fixed, "solver": asdict(calibration.solver),
        "noise": {o: asdict(n) for o, n in fit.noise.items()}, "laplace": fit.laplace.names,
        "settings": {**vars(calibration.settings), "solver": {}},
        "model": calibration.model.name, "free": fit.free, "parameters": [_told(p) for p in calibration.parameters],
    }  # fmt: skip
    arrays = {"values": fit.values, "mean": fit.laplace.mean, "covariance": fit.laplace.covariance,
              "band_factors": predictor.band_factors}  # fmt: skip
    for k, r in enumerate(data.recordings):
        columns = {"time": r.time, **{f"input/{n}": v for n, v in r.inputs.items()}}
        columns |= {f"output/{n}": v for n, v in r.outputs.items()}
        arrays |= {f"{k}/{n}": v for n, v in columns.items()}
    with whole_file(folder / MODEL) as temporary:
        shutil.copyfile(calibration.model.path, temporary)
    write_arrays(folder / VALUES, {"told": np.array(json.dumps(plain(told))), **arrays}, compressed=True)


def stored(folder: Path) -> StoredFit:
    """Read what :func:`store` wrote; InputError where there is none, or it is damaged."""
    path = folder / VALUES
    if not path.is_file() or not (folder / MODEL).is_file():
        raise InputError(f"{folder}: its model cannot be run again: the folder has no {VALUES} and {MODEL}")
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        told = json.loads(str(arrays.pop("told")))
        return _fit(told, arrays, replace(Model.load(folder / MODEL), name=told["model"]))
    except (ValueError, OSError, EOFError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is damaged ({error})") from None


def _told(p: Parameter) -> dict[str, Any]:
    kept = ["name", "unit", "start", "lower", "upper", "scale", "description", "recording", "starts", "shared_with"]
    target = [type(p.target).__name__, *asdict(p.target).values()]
    return {key: getattr(p, key) for key in kept} | {"target": target}


def _parameter(told: Mapping[str, Any]) -> Parameter:
    kind, *names = told["target"]
    own: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in told.items()}
    own |= {"target": _TARGETS[kind](*names), "prior": Uniform(told["lower"], told["upper"])}
    return Parameter(**own)


def _fit(told: Mapping[str, Any], arrays: Mapping[str, FloatArray], model: Model) -> StoredFit:
    recordings = []
    for k, name in enumerate(told["names"]):
        inputs, outputs = (
            {n.removeprefix(f"{k}/{role}/"): v for n, v in arrays.items() if n.startswith(f"{k}/{role}/")}
            for role in ("input", "output")
        )
        units, known = told["units"][k], told["known"][k]
        one = Recording(name, arrays[f"{k}/time"], inputs, outputs, units, told["sha256"][k], known=known)
        recordings.append(one)
    experiments = tuple(
        replace(to_experiment(r, told["outputs"], start=start, interpolation=between), known=r.known)
        for r, start, between in zip(recordings, told["start"], told["interpolation"], strict=True)
    )
    calibration = Calibration(
        MeasuredData(experiments, tuple(told["names"]), tuple(recordings)), model,
        ParameterSet(tuple(map(_parameter, told["parameters"]))), fixed=told["fixed"],
        solver=SolverSettings(**told["solver"]),
        settings=CalibrationSettings(**{**told.get("settings", {}), "solver": SolverSettings(**told["solver"])}),
    )  # fmt: skip
    noise = {o: OutputNoise(**n) for o, n in told["noise"].items()}
    free, names = tuple(told["free"]), tuple(told["laplace"])
    factors = arrays["band_factors"]
    predictor = FittedPredictor(calibration, arrays["values"], free, noise, factors)
    return StoredFit(predictor, Laplace(names, arrays["mean"], arrays["covariance"], len(free)))
