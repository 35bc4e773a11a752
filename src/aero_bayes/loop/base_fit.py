"""The model as it stands, fitted, with every effect of the catalogue at hand: what the search starts from.

All happens on one FMU that carries every effect switched off, so that a search needs no further export.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.check.structure import ResidualReport, inspect
from aero_bayes.data import floors_of
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.ascent import Climber, straighter
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import ClimbSettings, Optimum
from aero_bayes.estimate.coarse import leading
from aero_bayes.estimate.fit import without_ripple
from aero_bayes.estimate.interpolation import read_otherwise
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.starts import loosened
from aero_bayes.loop.judge import Prediction
from aero_bayes.loop.stand import Held, Stands
from aero_bayes.loop.workbench import Workbench
from aero_bayes.simulation import Model

#: Error of an output, as a share of its range, that a search on fewer samples may make.
CLOSE = 0.005
#: Largest change of an output by a parameter's whole range, over that of the strongest, at which it is not seen at all.
UNSEEN = 1e-12


@dataclass(frozen=True, eq=False)
class BaseFit:
    """The model as it stands, held against the recordings.

    Parameters
    ----------
    plain : Calibration
        Of the model as it stands; a rotor's ripple is taken out of the readings.
    fit : Optimum
        Of ``plain``.
    held : Held
        The same on a stand with the first group of candidates, where a long recording is made shorter.
    stands : Stands
    ids : tuple of str
        All candidates.
    settings : ClimbSettings
        Of each further climb.
    reports : tuple of ResidualReport
        What it leaves.
    floors : mapping of (recording, output) to float
        Noise floors of all recordings.
    close : (Calibration, Optimum)
        The first fit, whose starts are held close to their readings; in ``fit`` a tenth of what the output moves is
        open, since its sensor may be off.
    """

    plain: Calibration
    fit: Optimum
    held: Held
    stands: Stands
    ids: tuple[str, ...]
    settings: ClimbSettings
    reports: tuple[ResidualReport, ...]
    floors: Mapping[tuple[str, str], float]
    close: tuple[Calibration, Optimum]

    def on(
        self, bench: Workbench, model: Model, new: Sequence[Parameter], fixed: Mapping[str, float] | None = None
    ) -> Calibration:
        """The same recordings held against a relative of the model; ``new`` parameters replace the effects'."""
        plain = self.plain
        open_ = replace(plain, parameters=loosened(plain.parameters, plain.experiments, plain.model))
        moved = bench.family.on(open_, model)
        return replace(moved, parameters=moved.parameters.extended(new), fixed={**moved.fixed, **(fixed or {})})

    def at_its_best(self, bench: Workbench) -> tuple[BaseFit, Prediction]:
        """The model as it stands with starts close to their readings, if that predicts the unseen better, and what it
        predicts: a start that made up for what is missing must not count against the model as its user knows it."""
        before = bench.unseen.predict(self.plain, self.fit)
        with suppress(CannotFinishError):
            found = bench.unseen.predict(*self.close, close=True)
            if found.log_unseen < before.log_unseen:
                plain, fit = self.close
                return replace(self, plain=plain, fit=fit, reports=_reports(bench, plain, fit, self.floors)), found
        return self, before

    def report(self, held: Held) -> tuple[ResidualReport, ...]:
        """What a fit leaves."""
        study = held.stand.study
        return inspect(study.calibration, study.series, held.optimum, self.floors)

    @property
    def shared(self) -> list[Parameter]:
        """The model's own parameters that all recordings have in common."""
        return [p for p in self.plain.parameters if p.recording is None]


def fit_as_it_stands(bench: Workbench) -> BaseFit:
    """Fit the model without any effect."""
    bench.progress("building models", 0.0)
    model = bench.family.plain()
    bench.tally.lap("models")
    bench.progress("fitting the model as it stands", 0.05)
    recordings, settings = bench.recordings, bench.settings
    close = _fitted(bench, bench.calibrate(model, _shared(bench, model)))
    plain, fit = _loosened(bench, *close)
    bench.tally.lap("base fit")
    quick = plain
    if max((s.time.size for e in plain.experiments for s in e.inputs), default=0) > 2 * settings.search_samples:
        with bench.open(plain.problem()) as simulator:
            quick = leading(plain, simulator, settings.search_samples, CLOSE)
    ids = bench.family.prepare(quick, fit, bench.open)
    stands = Stands(bench, quick, fit.free)
    climbing = replace(settings.climb, floors=plain.floors)
    values = dict(zip(plain.parameters.names, plain.parameters.from_search(fit.coordinates).tolist(), strict=True))
    held = stands.of(bench.family.groups()[0]).fit(values, (), fit.noise, climbing)
    bench.tally.lap("models")
    floors = floors_of([*recordings.train, *recordings.test], recordings.outputs)
    return BaseFit(plain, fit, held, stands, ids, climbing, _reports(bench, plain, fit, floors), floors, close)


def _loosened(bench: Workbench, plain: Calibration, fit: Optimum) -> tuple[Calibration, Optimum]:
    """The fit as it is where a sensor may be off: what is missing may be just that."""
    parameters = loosened(plain.parameters, plain.experiments, plain.model)
    if parameters == plain.parameters:
        return plain, fit
    values = plain.parameters.from_search(fit.coordinates)
    plain = replace(plain, parameters=parameters)
    return plain, _again(bench, plain, values, fit)


def fit_from_there(bench: Workbench, base: BaseFit, held: Held, stands: Stands) -> BaseFit:
    """The same from where a search was led that found the first fit in a wrong valley, misread, ill solved or with
    parameters held that the data tell."""
    plain, now = base.plain, held.stand.study.calibration
    if now.interpolation != plain.interpolation:
        plain = read_otherwise(plain) or plain
    freed = (replace(p, auto=other.auto) for p, other in zip(plain.parameters, now.parameters, strict=False))
    plain = replace(plain, solver=now.solver, parameters=ParameterSet(tuple(freed)))
    values = np.array([held.values[name] for name in plain.parameters.names])
    fit = _again(bench, plain, values, replace(base.fit, free=held.stand.own, noise=held.optimum.noise))
    reports = _reports(bench, plain, fit, base.floors)
    return replace(base, plain=plain, fit=fit, held=held, stands=stands, reports=reports)


def _again(bench: Workbench, calibration: Calibration, values: NDArray[np.float64], last: Optimum) -> Optimum:
    """A climb from values near an optimum, with what was free there and its noise."""
    with bench.open(calibration.problem()) as simulator:
        study = bench.objective(calibration, simulator)
        found = Climber(study, bench.settings.ascent).again(study.parameters.to_search(values), last.free, last.noise)
        bench.tally.count(study)
    return found


def _reports(
    bench: Workbench, plain: Calibration, fit: Optimum, floors: Mapping[tuple[str, str], float]
) -> tuple[ResidualReport, ...]:
    with bench.open(plain.problem()) as simulator:
        return inspect(plain, bench.objective(plain, simulator).series, fit, floors)


def _shared(bench: Workbench, model: Model) -> ParameterSet:
    overrides = {**bench.family.overrides(model), **bench.settings.overrides}
    free = bench.settings.free or tuple(name for name, override in overrides.items() if not override.auto)
    if not free:
        raise InputError(f"model {model.name} declares no parameters to fit: say which to search")
    held = {name: replace(overrides.get(name, Override()), auto=True) for name in bench.settings.undecided}
    return parameters_from_model(model, free=(*free, *held), overrides={**overrides, **held})


def _fitted(bench: Workbench, calibration: Calibration) -> tuple[Calibration, Optimum]:
    """Fit what the data shows, and again without a rotor's ripple where the residual shows any."""
    settings = bench.settings
    with bench.open(calibration.problem()) as simulator:
        study = bench.objective(calibration, simulator)
        climber = Climber(study, settings.ascent)
        rng = np.random.default_rng(settings.seed)
        ascent = climber.to_optimum(_seen(study), bench.open, rng)
        found = ascent.optimum
        lines = straighter(climber, ascent, bench.open, rng) if settings.calibration.interpolation == "auto" else None
        fitted = tuple(y[0] for y in study.simulate(study.parameters.from_search(found.coordinates)[None]).outputs)
        bench.tally.count(study)
    if lines is not None:
        return lines
    cleaned, ripple = without_ripple(calibration, fitted) if settings.ripple else (calibration, {})
    if not ripple:
        return calibration, found
    return cleaned, _again(bench, cleaned, cleaned.parameters.from_search(found.coordinates), found)


def _seen(study: Objective) -> tuple[int, ...]:
    """Columns that change a recorded output at all, of those that are decided on."""
    every = tuple(j for j, p in enumerate(study.parameters) if not p.auto)
    found = study.evaluate(study.parameters.to_search(study.parameters.start), every)
    if found is None or found.slopes is None:
        return every
    size = np.max([np.max(np.abs(rows), axis=1) for rows in found.slopes], axis=0)
    return tuple(j for j, own in zip(every, size, strict=True) if own > UNSEEN * float(size.max(initial=0.0)))
