"""The models of the replay, exported and opened on one recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording, output_noise_floor, to_experiment
from aero_bayes.estimate import Fit
from aero_bayes.export import export_fmu
from aero_bayes.simulation import Model, Outcome, Problem, Simulator
from paper_replay import visibility
from paper_replay.evaluator import ModelEvaluator, parameter_problem
from paper_replay.published import TABLE_PARAMETERS, TRANSFER_GAIN, UNOPTIMISED

FloatArray = NDArray[np.float64]
Name = Literal["OneDofLinear", "OneDof", "TransferFunction"]

OUTPUTS = ("i_m", "omega_m", "theta")


def export_models(folder: Path, report: Callable[[float], None]) -> dict[Name, Model]:
    """Build the three FMUs into a folder."""
    names: tuple[Name, ...] = ("OneDofLinear", "OneDof", "TransferFunction")
    folder.mkdir(parents=True, exist_ok=True)
    models: dict[Name, Model] = {}
    for k, name in enumerate(names):
        models[name] = Model.load(export_fmu(f"Aero.Systems.{name}", folder / f"{name}.fmu"))
        report((k + 1) / len(names))
    return models


class Rigs:
    """Evaluators of the models: linear law (Table 1's units), quadratic law (Eqs. 4 and 5), transfer function.

    Parameters
    ----------
    recording : Recording
    models : mapping of name to Model
    opened : callable
        Opens a simulator on a problem; who made it closes it.
    """

    def __init__(
        self, recording: Recording, models: Mapping[Name, Model], opened: Callable[[Problem], Simulator]
    ) -> None:
        self._models, self._opened, self.recording = models, opened, recording
        rest = models["OneDof"].declared.recording.zero_at_rest
        self.experiment = to_experiment(recording, OUTPUTS, zero_at_rest=rest)
        start = UNOPTIMISED.model_values
        self.linear = ModelEvaluator(
            opened(parameter_problem(models["OneDofLinear"], self.experiment, TABLE_PARAMETERS)), start
        )
        self.quadratic = ModelEvaluator(
            opened(parameter_problem(models["OneDof"], self.experiment, TABLE_PARAMETERS)), start
        )
        pitch_only = to_experiment(recording, ("theta",), zero_at_rest=rest)
        gain = {"K_pp": TRANSFER_GAIN}
        self.transfer = ModelEvaluator(
            opened(parameter_problem(models["TransferFunction"], pitch_only, tuple(gain))), gain
        )
        self._others: Counter[Outcome] = Counter()

    def look(self, fit: Fit) -> visibility.Visibility:
        """Compute what the recording can see, at a fit of the quadratic law."""
        problem = visibility.sensitivity_problem(self._models["OneDof"], self.experiment)
        defaults = {v.name: v.start or 0.0 for v in self._models["OneDof"].parameters}
        known = defaults | fit.named
        values = np.array([known.get(name, 0.0) for name in (*visibility.COLUMNS, visibility.DELAY)])
        found = self._opened(problem).simulate(values[None, :], active=list(range(values.size)))
        self._others[Outcome(int(found.outcomes[0, 0]))] += 1
        sensitivities = found.sensitivities[0][0] if found.sensitivities is not None else np.full((1, 1, 1), np.nan)
        return visibility.judge_visibility(problem, found.outputs[0][0], sensitivities, values, self.floor)

    @property
    def floor(self) -> FloatArray:
        """What the noise of each output is at most, from its readings alone, shape (3,)."""
        return np.array([output_noise_floor(self.recording, name).at_most for name in OUTPUTS])

    @property
    def outcomes(self) -> Counter[Outcome]:
        """Every simulation so far, by how it ended."""
        return self.linear.outcomes + self.quadratic.outcomes + self.transfer.outcomes + self._others
