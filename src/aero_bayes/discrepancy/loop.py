"""The closed loop: fit, look at what is left, find the effect that is missing, write it into the model, judge.

Everything happens on one FMU that carries every effect switched off; the chosen ones are then written as a model of
their own, exported, refitted and judged.
"""

from __future__ import annotations

import difflib
import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording
from aero_bayes.discrepancy.attribute import AttributeSettings, Candidate, Selection, select
from aero_bayes.discrepancy.baseline import Prepared, fit_base, nuisance_parameters, prepare, without_ripple
from aero_bayes.discrepancy.catalogue import candidates_of, describe, effect_parameter
from aero_bayes.discrepancy.family import ModelFamily
from aero_bayes.discrepancy.judge import Prediction, floors_of, predict, shifts
from aero_bayes.discrepancy.refit import Refit, RefitSettings, refit
from aero_bayes.discrepancy.residual import ResidualReport, inspect
from aero_bayes.discrepancy.result import FoundEffect, LoopOutcome, LoopResult, NewParameter
from aero_bayes.discrepancy.study import Study, problem_of
from aero_bayes.errors import InputError
from aero_bayes.export import CATALOGUE, Compiler, EffectUse, ExtendedModel
from aero_bayes.inference.aero import aero_overrides
from aero_bayes.inference.parameters import Override, ParameterSet, parameters_from_model
from aero_bayes.simulation import Model, WorkerPool, open_simulator
from aero_bayes.simulation.interface import SolverSettings

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class LoopSettings:
    """How the loop works.

    Parameters
    ----------
    attribute, refit : settings of the search and of each refit
    effects : tuple of str, optional
        Ids of the catalogue to consider; all by default.
    held_out : float
        Share of each recording, at its end, that is kept from the fit where no test recording is given.
    fixed : mapping of str to float
        Model parameters held at other values than the model's own.
    overrides : mapping of str to Override
        Priors and bounds in place of the defaults.
    free : tuple of str, optional
        Parameters of the base model to fit; by default those of the AERO but for the inductance.
    solver : SolverSettings
    most_readings : int
        Readings an output and recording that the search uses; more are thinned.
    """

    attribute: AttributeSettings = field(default_factory=AttributeSettings)
    refit: RefitSettings = field(default_factory=RefitSettings)
    effects: tuple[str, ...] | None = None
    held_out: float = 0.3
    fixed: Mapping[str, float] = field(default_factory=dict)
    overrides: Mapping[str, Override] = field(default_factory=dict)
    free: tuple[str, ...] | None = None
    solver: SolverSettings = field(default_factory=lambda: SolverSettings(1e-5, 1e-5))
    most_readings: int = 8000


def close_loop(
    train: Sequence[Recording],
    test: Sequence[Recording] = (),
    *,
    model: str = "Aero.Systems.OneDof",
    compiler: Compiler = "auto",
    settings: LoopSettings | None = None,
    workers: int | None = None,
    out_dir: Path | None = None,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> LoopResult:
    """Find the effect that a model lacks, add it to the model, and judge the gain on data that was not fitted.

    Parameters
    ----------
    train, test : sequences of Recording
        Without ``test``, the end of each training recording is kept from the fit and predicted.
    model : str
        A base system with slots for effects.
    workers : int, optional
        Worker processes; all cores by default, 0 for none beside this one.
    out_dir : Path, optional
        Where the extended model's Modelica file is written.
    cache : Path, optional
        Where FMUs are kept between runs; ``out_dir/fmu`` by default.
    progress : callable, optional
        Told what happens and how far it is (0 to 1).

    Raises
    ------
    InputError
        If the recordings and the model do not belong together.
    CannotFinishError
        If the model cannot be simulated.
    """
    if not train:
        raise InputError("the closed loop needs at least one training recording")
    settings = settings or LoopSettings()
    unknown = [id_ for id_ in settings.effects or () if id_ not in CATALOGUE]
    if unknown:
        raise InputError(f"unknown effect {unknown[0]!r}; expected some of {', '.join(CATALOGUE)}")
    with tempfile.TemporaryDirectory(prefix="aero-bayes-") as scratch, WorkerPool(workers) as pool:
        folder = out_dir or Path(scratch)
        family = ModelFamily(model, cache or folder / "fmu", compiler)
        return _Loop(
            family, tuple(train), tuple(test), settings, pool, folder, progress or (lambda what, share: None)
        ).run()


class _Loop:
    """One pass through the stages; holds what they share."""

    def __init__(
        self,
        family: ModelFamily,
        train: tuple[Recording, ...],
        test: tuple[Recording, ...],
        settings: LoopSettings,
        pool: WorkerPool,
        folder: Path,
        progress: Progress,
    ) -> None:
        self.family, self.train, self.test = family, train, test
        self.settings, self.pool, self.folder, self.progress = settings, pool, folder, progress
        self.outputs = tuple(o for o in ("i_m", "omega_m", "theta") if any(o in r.outputs for r in train))
        if not self.outputs:
            raise InputError("none of the outputs i_m, omega_m, theta was recorded")
        self.names = tuple(r.name for r in train)
        if len(set(self.names)) < len(self.names):
            raise InputError("two training recordings have the same name")
        self.held_from: dict[str, float] = {}
        self.fitted_part = train
        if not test:
            parts = []
            for recording in train:
                cut = float(recording.time[0] + (1.0 - settings.held_out) * recording.duration)
                self.held_from[recording.name] = cut
                parts.append(replace(recording.without(after=cut), name=recording.name))
            self.fitted_part = tuple(parts)
        self.seconds: dict[str, float] = {}
        self.simulations = self.failures = 0
        self.clock = time.perf_counter()

    def run(self) -> LoopResult:
        screening = self._timed("models", self.family.screening)
        self.progress("fitting the model as it stands", 0.05)
        prepared = prepare(self.fitted_part, self.outputs, self.settings.most_readings)
        base_set = self._base_parameters(screening, prepared)
        extra, candidates = candidates_of(
            self.settings.effects or tuple(CATALOGUE), len(base_set), self.outputs, self.train
        )
        everything = base_set.extended(extra)
        fit = replace(self.settings.refit, floors=prepared.floors)
        study, base, prepared = self._fit_base(screening, everything, len(base_set), prepared, fit)
        self._lap("base fit")
        floors = floors_of([*self.train, *self.test], self.outputs)
        by_index = {
            (e, output): floors[name, output]
            for e, name in enumerate(self.names)
            for output in self.outputs
            if (name, output) in floors
        }
        before_reports = inspect(study, base, by_index, self.names)
        self.progress("trying every effect", 0.2)
        selection = select(
            study, base, candidates, self.settings.attribute, fit,
            lambda what, share: self.progress(what, 0.2 + 0.5 * share),
        )  # fmt: skip
        self._lap("attribution")
        before = self._predict(screening, everything, base)
        self.progress("writing the extended model", 0.75)
        if selection.effects:
            result = self._extended(study, selection, prepared, base_set, everything, before_reports, before, floors)
        else:
            result = self._nothing_found(study, selection, before_reports, before, floors, everything)
        study.close()
        self.progress("done", 1.0)
        return result

    # ---- stages

    def _fit_base(
        self, model: Model, parameters: ParameterSet, count: int, prepared: Prepared, fit: RefitSettings
    ) -> tuple[Study, Refit, Prepared]:
        study = self._study(model, parameters, prepared)
        base = fit_base(study, range(count), fit)
        cleaned = without_ripple(prepared, study, base)
        if cleaned.ripples:
            self._count(study)
            study.close()
            study = self._study(model, parameters, cleaned)
            base = refit(study, base.coordinates, base.free, noise=base.noise, settings=fit)
        return study, base, cleaned

    def _extended(
        self,
        study: Study,
        selection: Selection,
        prepared: Prepared,
        base_set: ParameterSet,
        everything: ParameterSet,
        before_reports: tuple[ResidualReport, ...],
        before: Prediction,
        floors: Mapping[tuple[str, str], float],
    ) -> LoopResult:
        values = dict(zip(everything.names, everything.from_search(selection.refit.coordinates), strict=True))
        uses = [
            EffectUse(c.id, {p.name: _significant(values[p.name]) for p in CATALOGUE[c.id].parameters})
            for c in selection.effects
        ]
        written, model = self.family.with_effects(uses, self.folder)
        self._lap("extension")
        self.progress("refitting the extended model", 0.85)
        final_set, final_study, final = self._final_fit(model, selection, prepared, base_set, everything)
        by_index = {(e, o): floors[n, o] for e, n in enumerate(self.names) for o in self.outputs if (n, o) in floors}
        after_reports = inspect(final_study, final, by_index, self.names)
        after = self._predict(model, final_set, final)
        effects = tuple(self._found(c, selection, final_set, final) for c in selection.effects)
        structured = [r for r in after_reports if r.verdict == "structured"]
        names = " and ".join(e.id for e in effects)
        sentence = f"The model lacks {names}: " + _gain_text(before, after)
        if structured:
            left = ", ".join(sorted({r.output for r in structured}))
            sentence += f" Some structure is left in {left}."
        self._count(final_study)
        final_study.close()
        self._lap("judgement")
        return self._result(
            "extended", sentence, written.name, effects, selection, before, after, floors, before_reports,
            after_reports, study, final_set, final, everything, written,
        )  # fmt: skip

    def _final_fit(
        self,
        model: Model,
        selection: Selection,
        prepared: Prepared,
        base_set: ParameterSet,
        everything: ParameterSet,
    ) -> tuple[ParameterSet, Study, Refit]:
        """Refit on the exported model itself, from where the search ended."""
        shared = [p for p in base_set if p.recording is None]
        own = list(nuisance_parameters(prepared, model))
        new = [effect_parameter(p) for c in selection.effects for p in CATALOGUE[c.id].parameters]
        final_set = ParameterSet((*shared, *own, *new))
        values = dict(zip(everything.names, everything.from_search(selection.refit.coordinates), strict=True))
        start = final_set.to_search(np.array([values[name] for name in final_set.names]))
        study = self._study(model, final_set, prepared)
        fit = replace(self.settings.refit, floors=prepared.floors)
        final = refit(study, start, range(len(final_set)), noise=selection.refit.noise, settings=fit)
        return final_set, study, final

    def _nothing_found(
        self,
        study: Study,
        selection: Selection,
        before_reports: tuple[ResidualReport, ...],
        before: Prediction,
        floors: Mapping[tuple[str, str], float],
        everything: ParameterSet,
    ) -> LoopResult:
        structured = [r for r in before_reports if r.verdict == "structured"]
        last = selection.rounds[-1] if selection.rounds else None
        outcome: LoopOutcome
        if structured:
            outcome = "unexplained"
            worst = max(structured, key=lambda r: r.ratio)
            sentence = (
                f"The residual of {worst.output} is structured ({worst.ratio:.2g} times the noise floor), but no "
                f"effect of the catalogue explains it: {last.why if last else 'none was tried'}."
            )
        else:
            outcome = "adequate"
            sentence = f"The model is adequate for these recordings: {last.why if last else 'the residual is noise'}."
        return self._result(
            outcome, sentence, self.family.base, (), selection, before, before, floors, before_reports, before_reports,
            study, everything, selection.refit, everything, None,
        )  # fmt: skip

    def _result(
        self,
        outcome: LoopOutcome,
        sentence: str,
        model: str,
        effects: tuple[FoundEffect, ...],
        selection: Selection,
        before: Prediction,
        after: Prediction,
        floors: Mapping[tuple[str, str], float],
        before_reports: tuple[ResidualReport, ...],
        after_reports: tuple[ResidualReport, ...],
        study: Study,
        final_set: ParameterSet,
        final: Refit,
        everything: ParameterSet,
        written: ExtendedModel | None,
    ) -> LoopResult:
        self._count(study)
        return LoopResult(
            outcome=outcome,
            sentence=sentence,
            base=self.family.base,
            model=model,
            effects=effects,
            equivalent=selection.equivalent,
            before=before,
            after=after,
            floors=floors,
            residual_before=before_reports,
            residual_after=after_reports,
            rounds=selection.rounds,
            signals={},
            ports=(),
            tied_ports=(),
            states={},
            moment=None,
            shifts=shifts(everything, selection.base, final_set, final) if effects else (),
            parameters=_parameters(final_set, final),
            noise=final.noise,
            modelica=written.text if written is not None else "",
            modelica_path=written.path.name if written is not None else "",
            diff=_diff(self.family.base, written),
            separate=(),
            story=self._story(selection, before_reports, effects, sentence),
            simulations=self.simulations,
            failures=self.failures,
            seconds=dict(self.seconds),
        )

    # ---- small parts

    def _base_parameters(self, model: Model, prepared: Prepared) -> ParameterSet:
        overrides = {**aero_overrides(model), **self.settings.overrides}
        motor = {"R_a", "c_m", "J_r", "k_d"}
        seen = set(self.outputs)
        free = self.settings.free or tuple(name for name in overrides if name != "L_a")
        if "theta" not in seen:
            free = tuple(name for name in free if name in motor)
        shared = parameters_from_model(model, free=free, overrides=overrides)
        return shared.extended(nuisance_parameters(prepared, model))

    def _study(self, model: Model, parameters: ParameterSet, prepared: Prepared) -> Study:
        problem = problem_of(model, prepared.experiments, parameters, self.settings.fixed, self.settings.solver)
        return Study(open_simulator(problem, pool=self.pool), parameters)

    def _predict(self, model: Model, parameters: ParameterSet, fit: Refit) -> Prediction:
        return predict(
            model, parameters, fit, self.train, self.test, self.outputs, self.settings.fixed, self.settings.solver,
            self.pool, self.held_from,
        )  # fmt: skip

    def _found(self, candidate: Candidate, selection: Selection, final_set: ParameterSet, final: Refit) -> FoundEffect:
        effect = CATALOGUE[candidate.id]
        named = _parameters(final_set, final)
        found = next((r for r in selection.rounds if r.chosen is not None and r.chosen.candidate is candidate), None)
        gain = found.chosen.gain if found is not None and found.chosen is not None else math.nan
        return FoundEffect(
            effect.id, effect.port, "catalogue", tuple(named[p.name] for p in effect.parameters), gain,
            found.threshold if found is not None else math.nan, effect.summary, dict(effect.widths),
        )  # fmt: skip

    def _story(
        self, selection: Selection, reports: Sequence[ResidualReport], effects: Sequence[FoundEffect], sentence: str
    ) -> tuple[str, ...]:
        worst = max(reports, key=lambda r: r.ratio)
        lines = [
            f"Fitted as it stands, {self.family.title} leaves {worst.ratio:.2g} times the noise floor in {worst.output}"
            f" ({worst.recording}); its residual is {worst.verdict}."
        ]
        lines += [f"Round {r.number}: {r.why}." for r in selection.rounds]
        for effect in effects:
            values = {p.name: p.value for p in effect.parameters}
            lines.append(
                f"Added at the {effect.port} port: {describe(Candidate(effect.id, effect.port, (), ()), values)}."
            )
        return (*lines, sentence)

    def _timed(self, name: str, build: Callable[[], Model]) -> Model:
        self.progress("building models", 0.0)
        model = build()
        self._lap(name)
        return model

    def _lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self.clock
        self.clock = now

    def _count(self, study: Study) -> None:
        self.simulations += study.simulations
        self.failures += study.failures


def _parameters(parameters: ParameterSet, fit: Refit) -> dict[str, NewParameter]:
    """Values with Laplace's intervals, which are symmetric on a parameter's own search axis."""
    values = parameters.from_search(fit.coordinates)
    low, high = parameters.box
    found = {}
    for j in fit.free:
        item = parameters.items[j]
        sd = fit.sd(j)
        ends = np.repeat(fit.coordinates[np.newaxis, :], 2, axis=0)
        ends[:, j] = np.clip(fit.coordinates[j] + np.array([-1.645, 1.645]) * sd, low[j], high[j])
        q05, q95 = parameters.from_search(ends)[:, j]
        slope = float(parameters.jacobian(values)[j])
        found[item.name] = NewParameter(
            item.name, float(values[j]), sd * slope, float(q05), float(q95), item.unit, item.description
        )
    return found


def _gain_text(before: Prediction, after: Prediction) -> str:
    role = "test" if before.test else "train"
    first, second = before.pooled(role), after.pooled(role)
    worst = max(first, key=lambda o: first[o] / max(second[o], 1e-300))
    unit = {"i_m": "A", "omega_m": "rad/s", "theta": "rad"}.get(worst, "")
    where = "data that was not fitted" if role == "test" else "the fitted data"
    return f"on {where} the error of {worst} falls from {first[worst]:.3g} to {second[worst]:.3g} {unit}."


def _significant(value: float) -> float:
    return float(f"{value:.4g}")


def _diff(base: str, written: ExtendedModel | None) -> str:
    """The extended model's file as a diff against one that adds nothing."""
    if written is None:
        return ""
    title = base.rpartition(".")[2]
    empty = ["within ;", f'model {written.name} "{title}"', f"  extends {base};", f"end {written.name};"]
    lines = difflib.unified_diff(
        empty, written.text.splitlines(), fromfile=f"{title}.mo", tofile=written.path.name, lineterm="", n=2
    )
    return "\n".join(lines)
