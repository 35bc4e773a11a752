"""Objects of the library as the run directory that a command would have written: what figures are drawn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.result import LoopResult
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.sampling.posterior import Posterior
from aero_bayes.schema import LoopJson, ParameterJson, RunJson
from aero_bayes.simulation.model import Model
from aero_bayes.workflow.curves import band_series, fitted_series, measured_series, only_measured
from aero_bayes.workflow.results import plain, recording_row

Role = Literal["train", "test"]


def view(
    recordings: Sequence[tuple[Recording, Role]],
    series: Mapping[str, FloatArray],
    model: Model | None = None,
    posterior: Mapping[str, FloatArray] | None = None,
    **result: object,
) -> RunDirectory:
    """Return a run directory that is on no disk; ``result`` are further keys of result.json."""
    variables = (*model.inputs, *model.states, *model.outputs) if model is not None else ()
    described = {v.name: {"unit": v.unit, "description": v.description} for v in variables}
    units = {name: unit for recording, _ in recordings for name, unit in recording.units.items()}
    rows = [recording_row(recording, role) for recording, role in recordings]
    found = RunJson.model_validate({"units": units, "signals": described, "recordings": rows, **result})
    measured = measured_series([recording for recording, _ in recordings])
    return RunDirectory(Path(), found, only_measured({**measured, **series}), posterior or {})


def fit_view(fit: Fit) -> RunDirectory:
    """Return a fit with its curves."""
    recordings = fit.calibration.data.recordings
    if not recordings:
        raise InputError("a fit to experiments without recordings has nothing to be drawn over")
    return view([(r, "train") for r in recordings], fitted_series(fit), fit.calibration.model)


def posterior_view(posterior: Posterior) -> RunDirectory:
    """Return a posterior with its fit's curves, its bands and its draws."""
    base = fit_view(posterior.fit)
    bands = posterior.predictive
    names, outputs = posterior.calibration.data.names, posterior.fit.outputs
    series = band_series(names, outputs, [b.lower for b in bands], [b.upper for b in bands])
    draws = {name: posterior.draws[:, :, j] for j, name in enumerate(posterior.names)}
    table = {name: ParameterJson.model_validate(plain(e.to_dict())) for name, e in posterior.parameters.items()}
    result = base.result.model_copy(update={"parameters": table})
    return RunDirectory(base.path, result, only_measured({**base.series, **series}), draws)


def loop_view(loop: LoopResult) -> RunDirectory:
    """Return a closed loop with both models' curves over its recordings."""
    given = loop.recordings
    if given is None:
        raise InputError("this loop's result carries no recordings to be drawn over")
    series = loop.series()
    series |= {f"fitted/{recording}/{output}": y for (recording, output), y in loop.predicted_after.fitted.items()}
    settings: dict[str, object] = {}
    for recording in given.train:
        if recording.name in given.unseen_from:
            held = 1.0 - (given.unseen_from[recording.name] - recording.time[0]) / recording.duration
            settings = {"loop": {"held_out": float(held)}}
    roles: list[tuple[Recording, Role]] = [(r, "train") for r in given.train]
    roles += [(r, "test") for r in given.test]
    return view(
        roles, series, loop.plain, command="close-loop", loop=loop_json(loop), settings=settings, words=dict(loop.words)
    )


def loop_json(loop: LoopResult) -> LoopJson:
    """Return a closed loop as result.json has it."""
    return LoopJson.model_validate(plain(loop.to_dict()))
