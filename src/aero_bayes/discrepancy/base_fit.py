"""The model as it stands, fitted, with every effect of the catalogue at hand: what the search starts from.

All happens on one FMU that carries every effect switched off, so that a search needs no further export.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from aero_bayes.discrepancy.attribute import Candidate
from aero_bayes.discrepancy.baseline import Prepared, fit_base, nuisance_parameters, prepare, without_ripple
from aero_bayes.discrepancy.catalogue import candidates_of
from aero_bayes.discrepancy.judge import floors_of
from aero_bayes.discrepancy.refit import Refit, RefitSettings, refit
from aero_bayes.discrepancy.residual import ResidualReport, inspect
from aero_bayes.discrepancy.study import Study
from aero_bayes.discrepancy.workbench import Workbench
from aero_bayes.export import CATALOGUE
from aero_bayes.inference.aero import aero_overrides
from aero_bayes.inference.parameters import Parameter, ParameterSet, parameters_from_model
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
    prepared : Prepared
        The recordings, the rotor's ripple taken out.
    study : Study
        ``model`` against ``prepared``; the search goes on with it.
    own : ParameterSet
        Parameters of the model as it stands.
    everything : ParameterSet
        ``own``, then those of the effects, which ``candidates`` refer to by their columns.
    refit : Refit
        Fit of ``own``; the effects stay off.
    settings : RefitSettings
        Of this and each further refit of ``model``.
    reports : tuple of ResidualReport
        What it leaves.
    floors : mapping of (recording, output) to float
        Noise floors of all recordings; ``floors_by_index`` those of the training recordings by their index.
    """

    model: Model
    prepared: Prepared
    study: Study
    own: ParameterSet
    everything: ParameterSet
    candidates: tuple[Candidate, ...]
    refit: Refit
    settings: RefitSettings
    reports: tuple[ResidualReport, ...]
    floors: Mapping[tuple[str, str], float]
    floors_by_index: Mapping[tuple[int, str], float]

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
    prepared = prepare(recordings.fitted, recordings.outputs, settings.most_readings)
    own = _own_parameters(bench, model, prepared)
    extra, candidates = candidates_of(
        settings.effects or tuple(CATALOGUE), len(own), recordings.outputs, recordings.train
    )
    everything = own.extended(extra)
    fit = bench.refit_settings(prepared)
    study, base, prepared = _fitted(bench, model, everything, len(own), prepared, fit)
    bench.tally.lap("base fit")
    floors = floors_of([*recordings.train, *recordings.test], recordings.outputs)
    by_index = {
        (e, output): floors[name, output]
        for e, name in enumerate(recordings.names)
        for output in recordings.outputs
        if (name, output) in floors
    }
    reports = inspect(study, base, by_index, recordings.names)
    return BaseFit(model, prepared, study, own, everything, candidates, base, fit, reports, floors, by_index)


def _own_parameters(bench: Workbench, model: Model, prepared: Prepared) -> ParameterSet:
    overrides = {**aero_overrides(model), **bench.settings.overrides}
    free = bench.settings.free or tuple(name for name in overrides if name != "L_a")
    if "theta" not in bench.recordings.outputs:
        free = tuple(name for name in free if name in MOTOR)
    shared = parameters_from_model(model, free=free, overrides=overrides)
    return shared.extended(nuisance_parameters(prepared, model))


def _fitted(
    bench: Workbench, model: Model, parameters: ParameterSet, count: int, prepared: Prepared, fit: RefitSettings
) -> tuple[Study, Refit, Prepared]:
    """Fit the first ``count`` parameters, and again without the rotor's ripple where the residual shows any."""
    study = bench.open_study(model, parameters, prepared, {})
    base = fit_base(study, range(count), fit)
    cleaned = without_ripple(prepared, study, base)
    if cleaned.ripples:
        bench.tally.count(study)
        study.close()
        study = bench.open_study(model, parameters, cleaned, {})
        base = refit(study, base.coordinates, base.free, noise=base.noise, settings=fit)
    return study, base, cleaned
