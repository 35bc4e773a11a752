"""The closed loop: fit, search, decide, write the missing terms into the model, refit, judge."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from aero_bayes.arguments import paths_of, require_all, require_type
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import Recordings
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import steps_taken, templates, with_step_budget
from aero_bayes.estimate.fit import declared_overrides
from aero_bayes.estimate.initial_states import mended_recordings
from aero_bayes.estimate.parameters import ParameterSet, ParameterSpec, chosen_parameters
from aero_bayes.estimate.result import Fit
from aero_bayes.files import ScratchFolder
from aero_bayes.laws.law_places import CandidateFilter, LawPlaces
from aero_bayes.loop.decide import ClaimKind, Decision, decide
from aero_bayes.loop.extend import ExtendedFit, extend
from aero_bayes.loop.first_fit import (
    FITTED_FIRST,
    FirstFit,
    LoopContext,
    LoopSettings,
    LoopStatistics,
    beginning_share,
    first_fit,
)
from aero_bayes.loop.fmu_family import FmuFamily, FmuPlaces
from aero_bayes.loop.held_terms import held_values
from aero_bayes.loop.make_result import Ended, result_of
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.loop.models import FittedModel, ModelSource
from aero_bayes.loop.result import LoopResult
from aero_bayes.loop.search import Effort, Library, Search
from aero_bayes.loop.table import Structure
from aero_bayes.loop.validation import Validation
from aero_bayes.modelica.sources import main_class
from aero_bayes.progress import Progress, watching
from aero_bayes.simulation.function_model import FunctionModel
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model, ModelicaSource
from aero_bayes.simulation.workers import WorkerPool

#: Decisions after which the last one stands.
MOST_DECISIONS = 40


def close_loop(
    train: Fit | Recording | Sequence[Recording],
    test: Recording | Sequence[Recording] = (),
    *,
    validation: Recording | Sequence[Recording] = (),
    model: str | Path | Model | ModelicaSource | None = None,
    settings: LoopSettings | None = None,
    seed: int = 1,
    workers: int | None = None,
    out_dir: Path | str | None = None,
    progress: Progress | None = None,
) -> LoopResult:
    """Find the effect that a model lacks, add it to the model, and judge the gain on data that was not fitted.

    Parameters
    ----------
    train : Fit, Recording or sequence of Recording
        A fit, whose recordings, model and parameters are taken; or recordings for training.
    test : Recording or sequence of Recording
        Without any, the end of each training recording is not fitted, and stands for them.
    validation : Recording or sequence of Recording
        Recordings that confirm what was found in training. Without any, the first half of each test recording does; the
        second half is then the test part, which decides nothing and is only reported.
    model : str, path, Model or ModelicaSource
        Where no fit is given. A Modelica class, a ``.mo`` file, a class with the files that it is loaded from, or a
        model that was built from one; or an FMU (``.fmu``) with Model Exchange, around which laws are put.
    settings : LoopSettings, optional
    seed : int
        Of the swarm, and of the experiments that are proposed.
    workers : int, optional
        Worker processes; all cores by default, 0 for none beside this one.
    out_dir : path, optional
        Where the extended model's Modelica file and ``structures.json`` are written.
    progress : callable, optional
        Told what happens and how far it is (0 to 1); a sentence with a full stop is for the reader to keep. Where it
        returns True, the search for terms ends, and the loop concludes from what was tried. By default a bar in a
        notebook, where an interrupt ends the search likewise.

    Returns
    -------
    LoopResult
        The outcome, the effects with what is claimed of each, the models before and after, and their errors on each
        part of the data.

    Raises
    ------
    InputError
        If the recordings and the model do not belong together, or a setting makes no sense.
    CannotFinishError
        If the model cannot be simulated.

    Examples
    --------
    >>> settings = aero_bayes.LoopSettings(laws=("coulomb_friction", "gain"))
    >>> aero_bayes.close_loop(fit, test, settings=settings, workers=0)
    <LoopResult Rig: extended by coulomb_friction@v; RMS on test data: position 0.00524 -> 0.000304>
    """
    settings = require_type(settings or LoopSettings(), LoopSettings, "settings")
    given = train if isinstance(train, Fit) else None
    if isinstance(train, Fit):
        calibration, settings = train.calibration, settings_of(train, settings)
        model, train = calibration.model, calibration.data.recordings
    train, test = require_all(train, Recording, "train"), require_all(test, Recording, "test")
    confirming = require_all(validation, Recording, "validation")
    if settings.fitting.noise.process:
        raise InputError("the loop knows no process noise: [noise.process] is for a fit")
    if not train:
        raise InputError("the closed loop needs at least one training recording")
    if model is None:
        raise InputError("model: name a model, or give a fit in place of recordings")
    if not test and not 0.0 < settings.held_out < 1.0:
        raise InputError(f"held_out is {settings.held_out:g}; expected a share of the recording between 0 and 1")
    # Simulations occupy the cores: BLAS threads for small matrices would fight them, and sum in another order.
    scratch = ScratchFolder()
    family = _family(model, settings.cache or scratch.path / "fmu", settings)
    with threadpool_limits(limits=1, user_api="blas"), WorkerPool(workers) as pool, watching(progress) as watched:
        folder = Path(out_dir) if out_dir is not None else scratch.path
        base = family.base_model()
        if settings.parameters is None and not declared_overrides(base):
            has = ", ".join(v.name for v in base.parameters)
            raise InputError(
                f"model {base.name} declares no parameters to fit: name some of {has} by LoopSettings(parameters=[...])"
            )
        known = [v.name for v in base.outputs]
        train, test, confirming = (mended_recordings(recordings, base) for recordings in (train, test, confirming))
        recordings = Recordings.of(train, test, settings.held_out, known, confirming)
        context = LoopContext(family, recordings, settings, pool, folder, LoopStatistics(watched), seed)
        result = _closed(context, given)
        used = {fit.calibration.model.path for fit in (result.before, result.after)}
        for path in set((scratch.path / "fmu").glob("*.fmu")) - used:
            path.unlink()
        context.statistics.tell("done", 1.0)
        return replace(result, scratch=scratch)


def _closed(context: LoopContext, given: Fit | None) -> LoopResult:
    """Fit the first model, if no fit of it is given, search over structures, decide, extend, and judge."""
    settings, statistics = context.settings, context.statistics
    first = first_fit(context, given)
    cause = None if settings.require else first.fit.diagnosis.explanation
    # With a noise that differs from reading to reading, the first model was found to explain all.
    explained = cause is not None or (bool(first.plain.data.spreads) and not settings.require)
    search = searched(context, first, explained=explained)
    search.work("leaving out folds of readings", 1.0)
    decision = settled(search)
    if not explained:
        told = {*decision.model, *search.library.curves, *search.source.held}
        search.screen(decision.model, [t for t in search.library.offered if t not in told])
    statistics.end_search()
    extended = extend(context, first, search, decision) if decision.model else None
    context.folder.mkdir(parents=True, exist_ok=True)
    statistics.tell("judging what was found", 0.96)
    (context.folder / "structures.json").write_text(json.dumps(search.table.to_dict(), separators=(",", ":")))
    predicted = context.predictor.predict(first.plain, first.fit.optimum)
    final = extended or ExtendedFit(None, (), (), first.fit, first.reports, predicted)
    found = result_of(context, Ended(first, predicted, search, decision, final), cause)
    search.models.close()
    return found


def searched(context: LoopContext, first: FirstFit, *, explained: bool = False) -> Search:
    """Search over structures from the first model; not where another cause has ``explained`` what it leaves."""
    settings, family, statistics = context.settings, context.family, context.statistics
    placed = family.prepare(first.plain, first.fit.optimum, context.open)
    experiments, optimum = first.plain.data.experiments, first.fit.optimum
    share = beginning_share(experiments, first.fit.series, optimum.whitened, optimum.evaluation.residual)
    plain = first.plain if share >= 1.0 else replace(first.plain, data=first.plain.data.beginning(share))
    with context.open(plain.problem()) as simulator:
        steps = steps_taken(plain, simulator, first.fit.optimum.coordinates)
    plain = with_step_budget(plain, steps)
    held = {} if explained else held_values(first.plain, family.places.candidate_filter)
    source = ModelSource(family, plain, first.fit.free, context.objective, context.open, held)
    laws = () if explained else placed
    curves = frozenset(family.curves())
    library = Library((*laws, *held), family.refinements(), curves, settings.require, settings.max_effects)
    statistics.tell("trying each candidate", FITTED_FIRST)
    statistics.set_time_limit(60.0 * settings.max_minutes)
    predictor = context.predictor

    def validated_by(fitted: FittedModel) -> Validation | None:
        return Validation.of(predictor, fitted.model.objective.calibration, fitted.optimum)

    effort = Effort.of(sum(steps) or sum(e.time.size for e in experiments))
    search = Search(source, library, first.floors, context.map, statistics, validated_by, effort)
    search.begin(first.values)
    statistics.end_stage("models")
    search.run()
    return search


def _family(model: str | Path | Model | ModelicaSource, folder: Path, settings: LoopSettings) -> ModelicaFamily:
    """The model and its relatives."""
    if isinstance(model, FunctionModel):
        raise InputError(f"model {model.name} is a Python function: the loop extends Modelica, or an FMU")
    if isinstance(model, Model):
        model = model.source or model.path
    if not isinstance(model, ModelicaSource):
        (path,) = paths_of((model,), "model")
        model = ModelicaSource(main_class(path), (path,)) if path.suffix == ".mo" else ModelicaSource(str(model))
    narrowed = CandidateFilter(settings.effects, settings.exclude, settings.ports, settings.laws, settings.require)
    given = model.files, model.libraries, narrowed
    if (fmu := Path(model.name)).suffix == ".fmu":
        family: ModelicaFamily = FmuFamily(FmuPlaces(fmu.stem, *given, fmu=fmu), folder)
    else:
        family = ModelicaFamily(LawPlaces(model.name, *given), folder)
    family.places.check()
    return family


def settings_of(fit: Fit, settings: LoopSettings) -> LoopSettings:
    """Return the settings of a loop that begins at a fit: how it was fitted, its free parameters and its fixed values.

    Free ones keep their declared values, from which the search fits structures too. What the settings say themselves
    counts."""
    calibration, own = fit.calibration, settings.fit or fit.settings
    shared = [p for p in templates(calibration.parameters) if isinstance(p.target, ParameterTarget)]
    free = {calibration.parameters.items[j].name for j in fit.free}
    chosen = ParameterSet(
        tuple(replace(p, free_if_identified=False) for p in shared if p.name in free or p.per_recording)
    )
    if settings.parameters is not None:
        known = {
            p.name: ParameterSpec(
                p.start, p.lower, p.upper, p.prior, p.scale, per_recording=p.per_recording, joint=p.joint
            )
            for p in chosen
        }
        chosen = chosen_parameters(calibration.model, settings.parameters, known)
    fixed = {p.name: float(fit[p.name]) for p in shared if p.name not in chosen}
    fixed = {**calibration.fixed, **fixed, **own.fixed}
    first = replace(own, method="local", cost="posterior", staged=False, fixed=fixed)
    return replace(settings, fit=first, parameters=chosen)


def settled(search: Search) -> Decision:
    """The decision on a search's table once all that it hangs on was fitted without each fold, and held against what
    else may be in the place of each of its terms."""
    required = search.library.required
    for _ in range(MOST_DECISIONS):
        decision = decide(search.table, required)
        new = [k for k in decision.compared if not search.table.rows[k].refitted]
        todo = [k for k in _parts(search, decision) if k not in search.completed]
        if search.statistics.time_is_up() or not (new or todo):
            break
        if new:
            search.refit(new)
        else:
            for part in todo:
                search.complete(decision.model, part)
    return _as_far_as_tried(search, decide(search.table, required))


def _as_far_as_tried(search: Search, decision: Decision) -> Decision:
    """No law is claimed in whose place not all was tried: of one its place is told, of several places nothing."""
    less: dict[ClaimKind, ClaimKind] = {"law": "place", "mechanism": "one of"}
    claims = dict(decision.claims)
    for term, found in decision.claims.items():
        if not search.completed.get(tuple(x for x in decision.model if x != term)):
            claims[term] = replace(found, kind=less.get(found.kind, found.kind), tried_all=False)
    return replace(decision, claims=claims)


def _parts(search: Search, decision: Decision) -> list[Structure]:
    """The model without each of its terms, in whose place all others are to be tried; and of a law beside a curve what
    it does without the curve."""
    model, curves = decision.model, set(search.library.curves)
    parts = [tuple(x for x in model if x != t) for t in decision.claims]
    laws = tuple(t for t in model if t not in curves)
    if laws != model:
        parts += [tuple(x for x in laws if x != t) for t in laws if t in decision.claims]
    return list(dict.fromkeys(parts))
