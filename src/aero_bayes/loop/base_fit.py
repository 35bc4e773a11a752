"""The model as it stands, fitted, with every effect of the catalogue at hand: what the search starts from.

All happens on one FMU that carries every effect switched off, so that a search needs no further export.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.check.structure import ResidualReport, inspect
from aero_bayes.estimate.aero import aero_overrides
from aero_bayes.estimate.ascent import Climber
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import ClimbSettings, Optimum
from aero_bayes.estimate.fit import without_ripple
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.export import CATALOGUE
from aero_bayes.loop.attribute import Candidate
from aero_bayes.loop.judge import floors_of
from aero_bayes.loop.workbench import Workbench
from aero_bayes.physics.catalogue import candidates_of
from aero_bayes.simulation import Model

#: Parameters that current and speed alone tell something of.
MOTOR = frozenset({"R_a", "c_m", "J_r", "k_d"})


@dataclass(frozen=True, eq=False)
class BaseFit:
    """The model as it stands, held against the recordings.

    Parameters
    ----------
    model : Model
        Every effect switched off, and an input at every port.
    calibration : Calibration
        The recordings, a rotor's ripple taken out; its parameters are those of the model as it stands, then those of
        the effects, which ``candidates`` refer to by their columns.
    study : Objective
        ``model`` against the recordings; the search goes on with it.
    own : ParameterSet
        Parameters of the model as it stands.
    fit : Optimum
        Of ``own``; the effects stay off.
    settings : ClimbSettings
        Of each further climb.
    reports : tuple of ResidualReport
        What it leaves.
    floors : mapping of (recording, output) to float
        Noise floors of all recordings.
    """

    model: Model
    calibration: Calibration
    study: Objective
    own: ParameterSet
    candidates: tuple[Candidate, ...]
    fit: Optimum
    settings: ClimbSettings
    reports: tuple[ResidualReport, ...]
    floors: Mapping[tuple[str, str], float]

    @property
    def everything(self) -> ParameterSet:
        """Parameters of the model, then those of the effects."""
        return self.calibration.parameters

    def on(self, model: Model, new: Sequence[Parameter], fixed: Mapping[str, float] | None = None) -> Calibration:
        """The same recordings held against a relative of the model; ``new`` parameters replace the effects'."""
        return replace(
            self.calibration, model=model, parameters=self.own.extended(new),
            fixed={**self.calibration.fixed, **(fixed or {})},
        )  # fmt: skip

    @property
    def shared(self) -> list[Parameter]:
        """The model's own parameters that all recordings have in common."""
        return [p for p in self.own if p.recording is None]


def fit_as_it_stands(bench: Workbench) -> BaseFit:
    """Fit the model without any effect."""
    bench.progress("building models", 0.0)
    model = bench.family.screening()
    bench.tally.lap("models")
    bench.progress("fitting the model as it stands", 0.05)
    recordings, settings = bench.recordings, bench.settings
    calibration = bench.calibrate(model, _shared(bench, model))
    own = calibration.parameters
    extra, candidates = candidates_of(
        settings.effects or tuple(CATALOGUE), len(own), recordings.outputs, recordings.train
    )
    calibration = replace(calibration, parameters=own.extended(extra))
    study, fit = _fitted(bench, calibration, len(own))
    bench.tally.lap("base fit")
    floors = floors_of([*recordings.train, *recordings.test], recordings.outputs)
    reports = inspect(study.calibration, study.series, fit, floors)
    climbing = replace(settings.climb, floors=calibration.floors)
    return BaseFit(model, study.calibration, study, own, candidates, fit, climbing, reports, floors)


def _shared(bench: Workbench, model: Model) -> ParameterSet:
    overrides = {**aero_overrides(model), **bench.settings.overrides}
    free = bench.settings.free or tuple(name for name in overrides if name != "L_a")
    if "theta" not in bench.recordings.outputs:
        free = tuple(name for name in free if name in MOTOR)
    return parameters_from_model(model, free=free, overrides=overrides)


def _fitted(bench: Workbench, calibration: Calibration, count: int) -> tuple[Objective, Optimum]:
    """Fit the first ``count`` parameters, and again without a rotor's ripple where the residual shows any."""
    study = bench.open_objective(calibration)
    climber = Climber(study, bench.settings.ascent)
    found = climber.to_optimum(range(count), bench.open, np.random.default_rng(bench.settings.seed)).optimum
    fitted = tuple(y[0] for y in study.simulate(study.parameters.from_search(found.coordinates)[None]).outputs)
    cleaned, ripple = without_ripple(calibration, fitted)
    if not ripple:
        return study, found
    bench.tally.count(study)
    study.simulator.close()
    study = bench.open_objective(cleaned)
    return study, Climber(study, bench.settings.ascent).again(found.coordinates, found.free, found.noise)
