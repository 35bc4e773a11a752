"""The recording of the replay, simulated, and its models, exported and opened on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, to_experiment
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.interface import Outcome, ParameterTarget, Problem, Simulator, SolverSettings
from aero_bayes.simulation.model import Model
from paper_replay.published import TRANSFER_GAIN, UNOPTIMISED
from simulated_rigs.aero import default_truth, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.sensors import white

Name = Literal["OneDofLinear", "OneDof", "TransferFunction"]
NAMES: tuple[Name, ...] = ("OneDofLinear", "OneDof", "TransferFunction")
OUTPUTS = ("i_m", "omega_m", "theta")


class ModelEvaluator:
    """One model on one recording, with a column for each value of ``start``: outputs and Eq. 6, failures counted."""

    def __init__(self, simulator: Simulator, start: Mapping[str, float]) -> None:
        self.simulator = simulator
        self.names = tuple(start)
        self.start = dict(start)
        self.outcomes: Counter[Outcome] = Counter()
        experiment = simulator.problem.experiments[0]
        assert experiment.measured is not None
        self.time, self.outputs, self.measured = experiment.time, experiment.outputs, experiment.measured

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the columns' values, shape (p,), with the starting ones where none is given."""
        return np.array([values.get(name, self.start[name]) for name in self.names])

    def simulate(self, values: FloatArray) -> FloatArray:
        """Simulate a batch (n, p): outputs of shape (n, samples, m), NaN where a run failed."""
        found = self.simulator.simulate(np.atleast_2d(values))
        self.outcomes.update(map(Outcome, found.outcomes.ravel().tolist()))
        outputs = found.outputs[0].copy()
        outputs[found.outcomes[:, 0] != Outcome.OK] = np.nan
        return outputs

    def cost(self, values: FloatArray, output: str) -> FloatArray:
        """Compute Eq. 6 of one output for a batch (n, p): shape (n,), infinite where a run failed."""
        k = self.outputs.index(output)
        runs = self.simulate(values)[:, :, k]
        return np.array([np.nansum((self.measured[:, k] - y) ** 2) if np.isfinite(y).all() else np.inf for y in runs])


def paper_recording(seed: int = 0) -> Recording:
    """Simulate the paper's experiment, whose recording is not public: 24 V for 20 s, 0 V for 20 s, 2,001 samples."""
    rng = np.random.default_rng([seed, 2])
    return simulate_recording(
        default_truth(), paper_step(), white(), rng, duration=40.0, rate_hz=50.0, name="paper_step"
    )


def export_models(folder: Path) -> dict[Name, Model]:
    """Build the three FMUs into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return {name: Model.load(export_fmu(f"Aero.Systems.{name}", folder / f"{name}.fmu")) for name in NAMES}


def open_models(
    recording: Recording, models: Mapping[Name, Model], opened: Callable[[Problem], Simulator]
) -> tuple[ModelEvaluator, ModelEvaluator]:
    """Open the model under the linear law (Table 1's units) and the transfer function on a recording."""
    rest = models["OneDof"].declared.recording.zero_at_rest

    def open_one(name: Name, outputs: Sequence[str], start: Mapping[str, float]) -> ModelEvaluator:
        experiment = to_experiment(recording, outputs, zero_at_rest=rest)
        targets = tuple(map(ParameterTarget, start))
        settings = SolverSettings(time_limit=5.0)
        return ModelEvaluator(opened(Problem(models[name], (experiment,), (targets,), settings=settings)), start)

    linear = open_one("OneDofLinear", OUTPUTS, UNOPTIMISED.model_values)
    return linear, open_one("TransferFunction", ("theta",), {"K_pp": TRANSFER_GAIN})
