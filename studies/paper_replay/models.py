"""The recording of the replay, simulated, and its models, exported and opened on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from aero_bayes.data import Recording, to_experiment
from aero_bayes.export import export_fmu
from aero_bayes.simulation import Experiment, Model, ParameterTarget, Problem, Simulator, SolverSettings
from paper_replay.evaluator import ModelEvaluator
from paper_replay.published import TABLE_PARAMETERS, TRANSFER_GAIN, UNOPTIMISED
from simulated_rigs.aero import default_truth, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.sensors import white

Name = Literal["OneDofLinear", "OneDof", "TransferFunction"]
NAMES: tuple[Name, ...] = ("OneDofLinear", "OneDof", "TransferFunction")
OUTPUTS = ("i_m", "omega_m", "theta")


def paper_recording(seed: int = 0) -> Recording:
    """Simulate the paper's experiment, whose recording is not public: 24 V for 20 s, 0 V for 20 s, 2,001 samples.

    The rig is that of :func:`simulated_rigs.aero.default_truth`; the seed decides the white noise.
    """
    rng = np.random.default_rng([seed, 2])
    return simulate_recording(
        default_truth(), paper_step(), white(), rng, duration=40.0, rate_hz=50.0, name="paper_step"
    )


def export_models(folder: Path, report: Callable[[float], None]) -> dict[Name, Model]:
    """Build the three FMUs into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    models: dict[Name, Model] = {}
    for k, name in enumerate(NAMES):
        models[name] = Model.load(export_fmu(f"Aero.Systems.{name}", folder / f"{name}.fmu"))
        report((k + 1) / len(NAMES))
    return models


def open_models(
    recording: Recording, models: Mapping[Name, Model], opened: Callable[[Problem], Simulator]
) -> tuple[ModelEvaluator, ModelEvaluator]:
    """Open the model under the linear law (Table 1's units) and the transfer function on a recording.

    Parameters
    ----------
    recording : Recording
    models : mapping of str to Model
    opened : callable
        Opens a simulator on a problem; who made it closes it.

    Returns
    -------
    tuple of ModelEvaluator
    """
    rest = models["OneDof"].declared.recording.zero_at_rest
    experiment, pitch_only = (to_experiment(recording, names, zero_at_rest=rest) for names in (OUTPUTS, ("theta",)))
    linear = opened(_problem(models["OneDofLinear"], experiment, TABLE_PARAMETERS))
    transfer = opened(_problem(models["TransferFunction"], pitch_only, ("K_pp",)))
    return ModelEvaluator(linear, UNOPTIMISED.model_values), ModelEvaluator(transfer, {"K_pp": TRANSFER_GAIN})


def _problem(model: Model, experiment: Experiment, names: Sequence[str]) -> Problem:
    """Pose the problem with one column for each named parameter of the model."""
    targets = tuple(ParameterTarget(name) for name in names)
    return Problem(model, (experiment,), (targets,), settings=SolverSettings(time_limit=5.0))
