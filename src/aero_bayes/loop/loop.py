"""The closed loop: fit, search over model structures, choose, write the missing terms into the model, judge."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from aero_bayes.arguments import paths_of, require_all, require_type
from aero_bayes.data import Recording
from aero_bayes.default_model import DEFAULT_MODEL
from aero_bayes.errors import InputError
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.estimate.plausible import screened
from aero_bayes.estimate.result import Fit
from aero_bayes.files import ScratchFolder
from aero_bayes.judge.choice import Choice
from aero_bayes.judge.choose import Chooser, worth_all_readings
from aero_bayes.judge.recordings import Recordings
from aero_bayes.language.sources import main_class
from aero_bayes.laws.candidate_filter import CandidateFilter
from aero_bayes.laws.fmu_family import FmuFamily
from aero_bayes.laws.fmu_places import FmuPlaces
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.model_family import ModelFamily
from aero_bayes.laws.modelica_family import ModelicaFamily
from aero_bayes.loop.base_fit import BaseFit, fit_base_model
from aero_bayes.loop.conclude import conclude, diagnosed, other_cause
from aero_bayes.loop.context import LoopContext, LoopStatistics
from aero_bayes.loop.from_fit import recordings_of, settings_of
from aero_bayes.loop.long_recordings import on_beginnings
from aero_bayes.loop.make_result import result_of
from aero_bayes.loop.result import LoopResult
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.progress import Progress, watching
from aero_bayes.search.beam import StructureSearch
from aero_bayes.search.explored import Library, SearchControl
from aero_bayes.search.informative_part import informative_share
from aero_bayes.search.models import FitNoise, FittedModel, ModelCache, ModelSource
from aero_bayes.search.structure import Structure
from aero_bayes.simulation import PythonModel, WorkerPool
from aero_bayes.simulation.model import Model, ModelicaSource

__all__ = ["LoopSettings", "close_loop"]

#: Share of the time limit that is kept for fits to all readings where structures are explored on a part of them.
TIME_FOR_ALL_READINGS = 0.3


def close_loop(
    train: Fit | Recording | Sequence[Recording],
    test: Recording | Sequence[Recording] = (),
    *,
    model: str | Path | Model | ModelicaSource = DEFAULT_MODEL,
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
        Without any, the end of each training recording is kept from the fit and predicted.
    model : str, path, Model or ModelicaSource
        Where no fit is given. A Modelica class, a ``.mo`` file, a class with the files that it is loaded from, or a
        model that was built from one; or an FMU (``.fmu``) with Model Exchange, around which laws are put.
    settings : LoopSettings, optional
    seed : int
        Of the swarm, and of the experiments that are proposed.
    workers : int, optional
        Worker processes; all cores by default, 0 for none beside this one.
    out_dir : path, optional
        Where the extended model's Modelica file is written.
    progress : callable, optional
        Told what happens and how far it is (0 to 1); a sentence with a full stop is for the reader to keep. Where it
        returns True, the search for terms ends, and the loop concludes from what was tried. By default a bar in a
        notebook, where an interrupt ends the search likewise.

    Returns
    -------
    LoopResult
        The outcome, the named effects, the models before and after, and their errors on unseen data.

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
    <LoopResult Rig: extended by coulomb_friction@v; RMS on test data: position 0.00481 -> 0.000302>
    """
    settings = require_type(settings or LoopSettings(), LoopSettings, "settings")
    begin: dict[str, float] = {}
    if isinstance(train, Fit):
        begin = {name: entry.value for name, entry in train.parameters.items()}
        model, settings, train = train.calibration.model, settings_of(train, settings), recordings_of(train)
    train, test = require_all(train, Recording, "train"), require_all(test, Recording, "test")
    if not train:
        raise InputError("the closed loop needs at least one training recording")
    if not test and not 0.0 < settings.held_out < 1.0:
        raise InputError(f"held_out is {settings.held_out:g}; expected a share of the recording between 0 and 1")
    # Simulations occupy the cores: BLAS threads for small matrices would fight them, and sum in another order.
    scratch = ScratchFolder()
    family = _family(model, settings.cache or scratch.path / "fmu", settings)
    with (
        threadpool_limits(limits=1, user_api="blas"),
        WorkerPool(workers) as pool,
        watching(progress) as watched,
    ):
        folder = Path(out_dir) if out_dir is not None else scratch.path
        known = [v.name for v in family.base_model().outputs]
        train, test = (screened(recordings, family.base_model()) for recordings in (train, test))
        recordings = Recordings.of(train, test, settings.held_out, known)
        context = LoopContext(family, recordings, settings, pool, folder, watched, LoopStatistics(watched), seed)
        result = _closed(context, begin)
        used = {fit.calibration.model.path for fit in (result.before, result.after)}
        for path in set((scratch.path / "fmu").glob("*.fmu")) - used:
            path.unlink()
        watched("done", 1.0)
        return replace(result, scratch=scratch)


def _closed(context: LoopContext, begin: Mapping[str, float]) -> LoopResult:
    """Fit the first model from some values, search over structures, and conclude."""
    settings = context.settings
    base = fit_base_model(context, begin)
    cache, choice = search_structures(*on_beginnings(context, base, begin))
    conclusion = diagnosed(conclude(context, base, choice), base, settings)
    context.statistics.keep_only(conclusion.written.path if conclusion.written is not None else None)
    cache.close(context.statistics.add_simulations)
    return result_of(context, conclusion)


def search_structures(context: LoopContext, base: BaseFit) -> tuple[ModelCache, Choice]:
    """Search over structures from the first model at its best, and choose."""
    settings, family = context.settings, context.family
    plain = base.plain
    family.prepare(plain, base.fit, context.open)
    interpolation_is_free = settings.fitting.calibration.interpolation == "auto"
    source = ModelSource(family, plain, base.fit.free, context.open_objective, context.open, interpolation_is_free)
    cache, curves = ModelCache(source), tuple(family.curves())
    groups = family.candidate_groups()
    searched = other_cause(base, settings) is None
    library = Library(groups, family.refinements(), curves) if searched else Library((), {}, ())
    fit = replace(settings.local_fit, floors=plain.data.floors)
    work = SearchControl(
        context.statistics.time_is_up, context.map, lambda what, share: context.progress(what, 0.2 + 0.5 * share)
    )
    context.progress("trying each candidate", 0.15)
    root = _first_model(cache, groups[0], base, fit)
    context.statistics.end_stage("models")
    context.statistics.set_time_limit(60.0 * settings.max_minutes)
    parts, structures = settings.search_parts, replace(settings.structures, min_share=settings.min_share)

    def search_on(models: ModelCache) -> StructureSearch:
        return StructureSearch(models, library, structures, fit, base.floors, parts, work)

    searching, share = search_on(cache), informative_share(root)
    if share < 1.0:
        seen = cache.on_beginning(share)
        with context.statistics.time_kept(60.0 * settings.max_minutes * TIME_FOR_ALL_READINGS):
            on_part = search_on(seen).run(_first_model(seen, groups[0], base, fit))
        explored = searching.go_on(root, on_part, worth_all_readings(on_part, settings.choice))
        seen.close(context.statistics.add_simulations)
    else:
        explored = searching.run(root)
    chooser = Chooser(
        settings.choice, fit, searching.complete, searching.alone, context.map,
        lambda share: context.progress("leaving out blocks of readings", 0.7 + 0.05 * share),
    )  # fmt: skip
    choice = chooser.choose(explored)
    context.statistics.end_stage("search")
    return cache, choice


def _first_model(models: ModelCache, terms: Collection[str], base: BaseFit, fit: LocalFitSettings) -> FittedModel:
    """The first model, fitted from its values, on a model that has some terms at hand."""
    model = models.of(Structure(), terms)
    return model.fit(
        Structure(), model.coordinates_of(base.values, ()), FitNoise(base.fit.noise), replace(fit, hold_noise=True)
    )


def _family(model: str | Path | Model | ModelicaSource, folder: Path, settings: LoopSettings) -> ModelFamily:
    """The model and its relatives."""
    if isinstance(model, PythonModel):
        raise InputError(f"model {model.name} is a Python function: the loop extends Modelica, or an FMU")
    if isinstance(model, Model):
        model = model.source or model.path
    if not isinstance(model, ModelicaSource):
        (path,) = paths_of((model,), "model")
        model = ModelicaSource(main_class(path), (path,)) if path.suffix == ".mo" else ModelicaSource(str(model))
    require = settings.structures.require
    narrowed = CandidateFilter(settings.effects, settings.exclude, settings.ports, settings.laws, require)
    given = model.files, model.libraries, narrowed
    if (fmu := Path(model.name)).suffix == ".fmu":
        family: ModelicaFamily = FmuFamily(FmuPlaces(fmu.stem, *given, fmu=fmu), folder)
    else:
        family = ModelicaFamily(LawPlaces(model.name, *given), folder)
    family.check()
    return family
