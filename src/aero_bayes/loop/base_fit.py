"""The model as it stands, fitted, with every effect of the catalogue at hand: what the search starts from.

All happens on one FMU that carries every effect switched off, so that a search needs no further export.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.check.structure import ResidualReport, inspect
from aero_bayes.errors import InputError
from aero_bayes.estimate.ascent import Climber
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.fit import without_ripple
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.loop.judge import floors_of
from aero_bayes.loop.workbench import Workbench
from aero_bayes.physics.kin import Candidate
from aero_bayes.simulation import Model

#: Largest change of an output by a parameter's whole range, over that of the strongest, at which it is not seen at all.
UNSEEN = 1e-12


@dataclass(frozen=True, eq=False)
class BaseFit:
    """The model as it stands, held against the recordings.

    Parameters
    ----------
    calibration : Calibration
        The recordings, a rotor's ripple taken out; its parameters are those of the model as it stands, then those of
        the effects, which ``candidates`` refer to by their columns.
    study : Objective
        The model, every effect switched off, against the recordings; the search goes on with it.
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
    model = bench.family.plain()
    bench.tally.lap("models")
    bench.progress("fitting the model as it stands", 0.05)
    recordings, settings = bench.recordings, bench.settings
    calibration = bench.calibrate(model, _shared(bench, model))
    own = calibration.parameters
    calibration, fit = _fitted(bench, calibration)
    bench.tally.lap("base fit")
    offer = bench.family.offer(calibration, fit, bench.open)
    calibration = replace(calibration, model=offer.model, parameters=own.extended(offer.parameters))
    bench.tally.lap("models")
    study = bench.open_objective(calibration)
    at = calibration.parameters.to_search(calibration.parameters.start)
    at[: len(own)] = fit.coordinates
    climbing = replace(settings.climb, floors=calibration.floors)
    fit = climb(study, at, fit.free, noise=fit.noise, settings=climbing)
    floors = floors_of([*recordings.train, *recordings.test], recordings.outputs)
    reports = inspect(study.calibration, study.series, fit, floors)
    return BaseFit(calibration, study, own, offer.candidates, fit, climbing, reports, floors)


def _shared(bench: Workbench, model: Model) -> ParameterSet:
    overrides = {**bench.family.overrides(model), **bench.settings.overrides}
    free = bench.settings.free or tuple(name for name in overrides if name != "L_a")
    if not free:
        raise InputError(f"model {model.name} declares no parameters to fit: say which to search")
    return parameters_from_model(model, free=free, overrides=overrides)


def _fitted(bench: Workbench, calibration: Calibration) -> tuple[Calibration, Optimum]:
    """Fit what the data shows, and again without a rotor's ripple where the residual shows any."""
    with bench.open(calibration.problem()) as simulator:
        study = Objective(calibration, simulator)
        climber = Climber(study, bench.settings.ascent)
        free = _seen(study)
        found = climber.to_optimum(free, bench.open, np.random.default_rng(bench.settings.seed)).optimum
        fitted = tuple(y[0] for y in study.simulate(study.parameters.from_search(found.coordinates)[None]).outputs)
        bench.tally.count(study)
    cleaned, ripple = without_ripple(calibration, fitted)
    if not ripple:
        return calibration, found
    with bench.open(cleaned.problem()) as simulator:
        study = Objective(cleaned, simulator)
        found = Climber(study, bench.settings.ascent).again(found.coordinates, found.free, found.noise)
        bench.tally.count(study)
    return cleaned, found


def _seen(study: Objective) -> tuple[int, ...]:
    """Columns that change a recorded output at all."""
    every = tuple(range(len(study.parameters)))
    found = study.evaluate(study.parameters.to_search(study.parameters.start), every)
    if found is None or found.slopes is None:
        return every
    size = np.max([np.max(np.abs(rows), axis=1) for rows in found.slopes], axis=0)
    return tuple(j for j in every if size[j] > UNSEEN * float(size.max(initial=0.0)))
