"""The closed loop: fit, look at what is left, find the effect that is missing, write it into the model, judge.

Everything happens on one FMU that carries every effect switched off; the chosen ones are then written as a model of
their own, exported, refitted and judged.
"""

from __future__ import annotations

import difflib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording
from aero_bayes.discrepancy.attribute import AttributeSettings, Candidate, Selection, select
from aero_bayes.discrepancy.baseline import Prepared, fit_base, nuisance_parameters, prepare, without_ripple
from aero_bayes.discrepancy.beyond import (
    CurveFit,
    CurveSearch,
    MomentFit,
    Probing,
    Visited,
    fit_curves,
    fit_moment,
    probe,
)
from aero_bayes.discrepancy.catalogue import candidates_of, describe, effect_parameter
from aero_bayes.discrepancy.family import ModelFamily
from aero_bayes.discrepancy.judge import Prediction, floors_of, predict, shifts
from aero_bayes.discrepancy.locate import rank_ports
from aero_bayes.discrepancy.refine import refine
from aero_bayes.discrepancy.refit import Refit, RefitSettings, SmoothPrior, refit
from aero_bayes.discrepancy.residual import ResidualReport, inspect
from aero_bayes.discrepancy.result import FoundEffect, LoopOutcome, LoopResult, NewParameter
from aero_bayes.discrepancy.separate import propose
from aero_bayes.discrepancy.study import Study, problem_of
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.export import CATALOGUE, Compiler, EffectUse, ExtendedModel, FreeForm
from aero_bayes.inference.aero import aero_overrides
from aero_bayes.inference.parameters import Override, Parameter, ParameterSet, parameters_from_model
from aero_bayes.scratch import ScratchFolder
from aero_bayes.simulation import Model, WorkerPool, open_simulator
from aero_bayes.simulation.interface import InputSignal, SolverSettings

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: A model that leaves less than this share of the error on data that was not fitted carries over to it.
CARRIES_OVER = 0.1


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
    locate : bool
        Whether the port signals are inferred also where an effect explains all; the page draws them.
    left_over : float
        What may be left beside named effects, of the error above the noise floor and of the evidence they gained;
        beyond it they are not named.
    astray : float
        How many times what the fit leaves the error on data that was not fitted may be; beyond it effects are not
        named.
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
    locate: bool = True
    left_over: float = 0.3
    astray: float = 3.0
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
    with ScratchFolder() as scratch, WorkerPool(workers) as pool:
        folder = out_dir or scratch
        family = ModelFamily(model, cache or folder / "fmu", compiler)
        return _Loop(
            family, tuple(train), tuple(test), settings, pool, folder, progress or (lambda what, share: None)
        ).run()


@dataclass(frozen=True, eq=False)
class _Rival:
    """What was found beyond the catalogue; ``curve`` and ``moment`` only where they beat it."""

    probing: Probing | None
    visited: Visited | None
    curve: CurveFit | None
    moment: MomentFit | None
    best_curve: CurveFit | None = None


@dataclass(frozen=True, eq=False)
class _Found:
    """What the stages up to the decision have made, for those after it."""

    study: Study
    selection: Selection
    prepared: Prepared
    base_set: ParameterSet
    everything: ParameterSet
    before_reports: tuple[ResidualReport, ...]
    before: Prediction
    floors: Mapping[tuple[str, str], float]
    floors_by_index: Mapping[tuple[int, str], float]
    rival: _Rival


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
            study, base, [c for c in candidates if not c.refines], self.settings.attribute, fit,
            lambda what, share: self.progress(what, 0.2 + 0.4 * share),
        )  # fmt: skip
        selection = refine(study, selection, candidates, self.settings.attribute, fit)
        self._lap("attribution")
        after_reports = inspect(study, selection.refit, by_index, self.names)
        rival = self._rival(screening, study, selection, prepared, base_set, everything, after_reports, fit)
        self._lap("beyond the catalogue")
        before = self._predict(screening, everything, base)
        found = _Found(
            study, selection, prepared, base_set, everything, before_reports, before, floors, by_index, rival
        )
        result = self._decide(found, after_reports)
        study.close()
        self.progress("done", 1.0)
        return result

    # ---- stages

    def _decide(self, found: _Found, after_reports: tuple[ResidualReport, ...]) -> LoopResult:
        """What to make of the evidence: a model that does not carry over to data it has not seen is no explanation."""
        selection, rival = found.selection, found.rival
        if rival.curve is not None:
            return self._free_form(found, rival.curve)
        refused = ""
        if (
            selection.effects
            and rival.moment is None
            and not self._incomplete(selection, found.before_reports, after_reports)
        ):
            named = self._extended(found)
            refused = self._astray(named)
            if not refused:
                return named
            best = rival.best_curve
            if best is not None and best.refit.log_evidence > selection.base.log_evidence + named.rounds[0].threshold:
                learned = self._free_form(found, best)
                if not self._astray(learned):
                    return learned
        return self._unexplained_or_adequate(found, after_reports, refused)

    def _astray(self, result: LoopResult) -> str:
        """Where the extended model is far off on data that was not fitted; empty where it is not."""
        settled = {(r.recording, r.output): r.rms for r in result.residual_after if r.verdict == "adequate"}
        found: dict[str, float] = {}
        for (name, output), error in result.after.test.items():
            own = [rms for (_, other), rms in settled.items() if other == output]
            expected = max([result.noise[output].sd, result.floors.get((name, output), 0.0), *own])
            carries_over = error.rms < CARRIES_OVER * result.before.test[name, output].rms
            if error.rms > self.settings.astray * expected and not carries_over:
                found[output] = max(error.rms / expected, found.get(output, 0.0))
        return ", ".join(f"{output} ({ratio:.2g} times what the fit leaves)" for output, ratio in found.items())

    def _fit_base(
        self, model: Model, parameters: ParameterSet, count: int, prepared: Prepared, fit: RefitSettings
    ) -> tuple[Study, Refit, Prepared]:
        study = self._open_study(model, parameters, prepared, {})
        base = fit_base(study, range(count), fit)
        cleaned = without_ripple(prepared, study, base)
        if cleaned.ripples:
            self._count(study)
            study.close()
            study = self._open_study(model, parameters, cleaned, {})
            base = refit(study, base.coordinates, base.free, noise=base.noise, settings=fit)
        return study, base, cleaned

    def _rival(
        self,
        screening: Model,
        study: Study,
        selection: Selection,
        prepared: Prepared,
        base_set: ParameterSet,
        everything: ParameterSet,
        after_reports: Sequence[ResidualReport],
        fit: RefitSettings,
    ) -> _Rival:
        """Look beyond the catalogue where it leaves structure, or needs several effects to explain one residual."""
        structured = any(report.verdict == "structured" for report in after_reports)
        if not structured and not (selection.effects and self.settings.locate):
            return _Rival(None, None, None, None)
        self.progress("locating the port", 0.65)
        base = selection.base
        visited = Visited.of(study, base)
        probing = probe(
            screening, prepared, everything, base, visited, self._open_study, self.outputs, self._fullest(prepared)
        )
        if not structured and len(selection.effects) < 2:
            return _Rival(probing, visited, None, None)
        self.progress("looking beyond the catalogue", 0.7)
        attribute = self.settings.attribute
        named = selection.refit.log_evidence - len(selection.effects) * math.log(len(CATALOGUE))
        shared = [p for p in base_set if p.recording is None]
        start = dict(zip(everything.names, everything.from_search(base.coordinates), strict=True))
        search = CurveSearch(self.family, prepared, shared, start, base, visited, self._open_study, fit)
        curves = fit_curves(search, self.outputs)
        moment = fit_moment(screening, prepared, everything, base, probing, visited, self._open_study, fit)
        best_curve = curves[0].refit.log_evidence - math.log(len(curves)) if curves else -math.inf
        best_moment = moment.log_evidence if moment is not None else -math.inf
        if moment is not None and best_moment > max(named, best_curve) + attribute.margin:
            return _Rival(probing, visited, None, moment, curves[0] if curves else None)
        if curves and best_curve > max(named, best_moment) + attribute.margin:
            return _Rival(probing, visited, curves[0], None, curves[0])
        return _Rival(probing, visited, None, None, curves[0] if curves else None)

    def _fullest(self, prepared: Prepared) -> int:
        """The recording with most readings, whose port signals are drawn."""
        readings = [int(np.isfinite(e.measured).sum()) if e.measured is not None else 0 for e in prepared.experiments]
        return int(np.argmax(readings))

    def _incomplete(
        self, selection: Selection, before: Sequence[ResidualReport], after: Sequence[ResidualReport]
    ) -> bool:
        """Whether so much is left beside the named effects that they are not the explanation.

        That is so if structure is left, and either most of what exceeded the noise floor is still there, or the
        structure would gain a good part of what the effects have gained.
        """
        structured = [report for report in after if report.verdict == "structured"]
        if not structured:
            return False
        gained = selection.refit.log_evidence - selection.base.log_evidence
        left = sum(
            max((t.statistic - t.freedom) / 2.0 for t in report.tests if t.name != "autocorrelation")
            for report in structured
        )
        return _excess(after) > self.settings.left_over * _excess(before) or left > self.settings.left_over * gained

    def _extended(self, found: _Found) -> LoopResult:
        selection, everything = found.selection, found.everything
        self.progress("writing the extended model", 0.75)
        values = dict(zip(everything.names, everything.from_search(selection.refit.coordinates), strict=True))
        uses = [
            EffectUse(c.id, {p.name: _significant(values[p.name]) for p in CATALOGUE[c.id].parameters})
            for c in selection.effects
        ]
        written, model = self.family.with_effects(uses, self.folder)
        self._lap("extension")
        self.progress("refitting the extended model", 0.85)
        new = [effect_parameter(p) for c in selection.effects for p in CATALOGUE[c.id].parameters]
        final_set, study, final = self._final_fit(model, found, new, values, selection.refit)
        reports = inspect(study, final, found.floors_by_index, self.names)
        after = self._predict(model, final_set, final)
        self._count(study)
        study.close()
        effects = tuple(self._found(c, selection, final_set, final) for c in selection.effects)
        effects = tuple(
            replace(e, width_influence=self._width_influence(model, found, e, final_set, final)) for e in effects
        )
        structured = [r for r in reports if r.verdict == "structured"]
        sentence = f"The model lacks {' and '.join(e.id for e in effects)}: " + _gain_text(found.before, after)
        if structured:
            sentence += f" Some structure is left in {', '.join(sorted({r.output for r in structured}))}."
        self._lap("judgement")
        return self._result(found, "extended", sentence, written, effects, after, reports, final_set, final)

    def _free_form(self, found: _Found, curve: CurveFit) -> LoopResult:
        """The port is clear and nothing listed fits: the learned curve goes into the model as a table."""
        self.progress("writing the learned curve into the model", 0.75)
        values = tuple(_significant(float(v)) for v in curve.values)
        use = FreeForm(curve.port, curve.over, curve.x_min, curve.x_max, values)
        written, model = self.family.with_effects([use], self.folder)
        self._lap("extension")
        start = dict(zip(curve.parameters.names, curve.parameters.from_search(curve.refit.coordinates), strict=True))
        new = [curve.parameters.items[j] for j in curve.columns]
        final_set, study, final = self._final_fit(model, found, new, start, curve.refit, curve.smooth)
        reports = inspect(study, final, found.floors_by_index, self.names)
        after = self._predict(model, final_set, final)
        self._count(study)
        study.close()
        named = _parameters(final_set, final)
        bar = found.selection.rounds[0].threshold if found.selection.rounds else math.nan
        effect = FoundEffect(
            "free_form", curve.port, "free_form", tuple(named[p.name] for p in new),
            curve.refit.log_evidence - found.selection.base.log_evidence, bar,
            f"a learned curve over {curve.over} from {curve.x_min:.3g} to {curve.x_max:.3g}, straight beyond",
            over=curve.over,
        )  # fmt: skip
        rival = [s.candidate.id for s in found.selection.rounds[0].scores[:1]] if found.selection.rounds else []
        sentence = (
            f"Something acts at the {curve.port} port as a function of {curve.over}; no effect of the catalogue fits "
            f"as well{f' (the best is {rival[0]})' if rival else ''}: {_gain_text(found.before, after)}"
        )
        self._lap("judgement")
        return self._result(found, "extended", sentence, written, (effect,), after, reports, final_set, final)

    def _final_fit(
        self,
        model: Model,
        found: _Found,
        new: Sequence[Parameter],
        start: Mapping[str, float],
        warm: Refit,
        smooth: SmoothPrior | None = None,
    ) -> tuple[ParameterSet, Study, Refit]:
        """Refit on the exported model itself, from where the search ended."""
        shared = [p for p in found.base_set if p.recording is None]
        final_set = ParameterSet((*shared, *nuisance_parameters(found.prepared, model), *new))
        at = final_set.to_search(np.array([start[name] for name in final_set.names]))
        study = self._open_study(model, final_set, found.prepared, {})
        fit = replace(self.settings.refit, floors=found.prepared.floors, smooth=smooth)
        return final_set, study, refit(study, at, range(len(final_set)), noise=warm.noise, settings=fit)

    def _unexplained_or_adequate(
        self, found: _Found, after_reports: Sequence[ResidualReport], refused: str
    ) -> LoopResult:
        selection, moment = found.selection, found.rival.moment
        structured = [r for r in found.before_reports if r.verdict == "structured"]
        last = selection.rounds[-1] if selection.rounds else None
        outcome: LoopOutcome = "unexplained"
        after, after_set, after_fit = found.before, found.everything, selection.base
        reports = found.before_reports
        if moment is not None:
            m = moment.moment
            after = self._predict(
                self.family.screening(), moment.parameters, moment.refit, {moment.recording: moment.signal}
            )
            sentence = (
                f"A disturbance of a moment at the {m.port} port, from {m.start:.3g} s to {m.stop:.3g} s, explains the "
                "residual better than any effect; it belongs to that moment and is not made into physics."
            )
        elif refused:
            best = " and ".join(c.id for c in selection.effects)
            sentence = (
                f"The residual is structured; {best} explains it where it was fitted but is far off on data that was "
                f"not: {refused}. The missing physics is something else."
            )
        elif selection.effects:
            best = " and ".join(c.id for c in selection.effects)
            left = ", ".join(sorted({r.output for r in after_reports if r.verdict == "structured"}))
            sentence = (
                f"The residual is structured; {best} explains part of it, but what is left in {left} says that the "
                "missing physics is something else."
            )
        elif structured:
            worst = max(structured, key=lambda r: r.ratio)
            sentence = (
                f"The residual of {worst.output} is structured ({worst.ratio:.2g} times the noise floor), but no "
                f"effect of the catalogue explains it: {last.why if last else 'none was tried'}."
            )
        else:
            outcome = "adequate"
            sentence = f"The model is adequate for these recordings: {last.why if last else 'the residual is noise'}."
        return self._result(found, outcome, sentence, None, (), after, reports, after_set, after_fit)

    def _result(
        self,
        found: _Found,
        outcome: LoopOutcome,
        sentence: str,
        written: ExtendedModel | None,
        effects: tuple[FoundEffect, ...],
        after: Prediction,
        after_reports: tuple[ResidualReport, ...],
        final_set: ParameterSet,
        final: Refit,
    ) -> LoopResult:
        selection, probing = found.selection, found.rival.probing
        self._count(found.study)
        signals = probing.signals if probing is not None else {}
        ports, tied = rank_ports(signals)
        moment = found.rival.moment.moment if found.rival.moment is not None else None
        named = any(effect.kind == "catalogue" for effect in effects)
        return LoopResult(
            outcome=outcome,
            sentence=sentence,
            base=self.family.base,
            model=written.name if written is not None else self.family.base,
            effects=effects,
            equivalent=selection.equivalent if named else (),
            before=found.before,
            after=after,
            floors=found.floors,
            residual_before=found.before_reports,
            residual_after=after_reports,
            rounds=selection.rounds,
            signals=signals,
            ports=ports,
            tied_ports=tied,
            states=_states_at(found.study, selection.base, probing),
            moment=moment,
            shifts=shifts(found.everything, selection.base, final_set, final) if effects else (),
            parameters=_parameters(final_set, final),
            noise=final.noise,
            modelica=written.text if written is not None else "",
            modelica_path=written.path.name if written is not None else "",
            diff=_diff(self.family.base, written),
            separate=self._separate(found) if named else (),
            story=self._story(selection, found.before_reports, effects, ports, tied, sentence),
            simulations=self.simulations,
            failures=self.failures,
            seconds=dict(self.seconds),
            drawn=self.names[probing.recording] if probing is not None else self.names[0],
        )

    def _separate(self, found: _Found) -> tuple[str, ...]:
        """For the first class of equivalent effects: the experiments that would separate them."""
        if not found.selection.equivalent:
            return ()
        same = found.selection.equivalent[0]
        scored = {
            s.candidate.id: (s.candidate, s.refit)
            for r in reversed(found.selection.rounds)
            for s in r.scores
            if s.refit is not None and s.candidate.id in same
        }
        known = [scored[id_] for id_ in same if id_ in scored]
        if len(known) < 2:
            return ()
        height = max((float(np.abs(s.values).max()) for e in found.prepared.experiments for s in e.inputs), default=1.0)
        model = self.family.screening()
        return tuple(
            propose(model, found.prepared, found.everything, known[0], other, height, self._open_study).sentence()
            for other in known[1:3]
        )

    def _width_influence(
        self, model: Model, found: _Found, effect: FoundEffect, final_set: ParameterSet, final: Refit
    ) -> float | None:
        """By how many standard deviations an effect's parameters move when its smoothing widths are doubled."""
        doubled = {
            variable.name: 2.0 * width
            for name, width in effect.widths.items()
            for variable in model.parameters
            if variable.name.rpartition(".")[2] == name
        }
        if not doubled:
            return None
        study = self._open_study(model, final_set, found.prepared, doubled)
        try:
            fit = replace(self.settings.refit, floors=found.prepared.floors, iterations=4)
            again = refit(study, final.coordinates, final.free, noise=final.noise, settings=fit)
        except CannotFinishError:
            return None
        finally:
            study.close()
        columns = [final_set.index(p.name) for p in effect.parameters]
        moved = [abs(again.coordinates[j] - final.coordinates[j]) / max(final.sd(j), 1e-300) for j in columns]
        return float(max(moved))

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

    def _open_study(
        self, model: Model, parameters: ParameterSet, prepared: Prepared, fixed: Mapping[str, float]
    ) -> Study:
        held = {**self.settings.fixed, **fixed}
        problem = problem_of(model, prepared.experiments, parameters, held, self.settings.solver)
        return Study(open_simulator(problem, pool=self.pool), parameters)

    def _predict(
        self, model: Model, parameters: ParameterSet, fit: Refit, extra: Mapping[int, InputSignal] | None = None
    ) -> Prediction:
        return predict(
            model, parameters, fit, self.train, self.test, self.outputs, self.settings.fixed, self.settings.solver,
            self.pool, self.held_from, extra,
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
        self,
        selection: Selection,
        reports: Sequence[ResidualReport],
        effects: Sequence[FoundEffect],
        ports: Sequence[str],
        tied: Sequence[str],
        sentence: str,
    ) -> tuple[str, ...]:
        worst = max(reports, key=lambda r: r.ratio)
        lines = [
            f"Fitted as it stands, {self.family.title} leaves {worst.ratio:.2g} times the noise floor in {worst.output}"
            f" ({worst.recording}); its residual is {worst.verdict}."
        ]
        if ports:
            lines.append(f"An unknown signal explains most at the {ports[0]} port.")
        if len(tied) > 1:
            lines.append(f"As signals over time alone, the data cannot tell {' and '.join(tied)} apart.")
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


def _states_at(study: Study, fit: Refit, probing: Probing | None) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Fitted states on the times of the port signals, for drawing one against the other."""
    if probing is None or not probing.signals:
        return {}
    time = next(iter(probing.signals.values())).time
    states = {}
    for k, series in enumerate(study.series):
        if series.experiment != probing.recording:
            continue
        at = series.sampling.time
        predicted = fit.evaluation.predicted[k]
        states[series.output] = (time, np.interp(time, at, predicted))
        if series.output == "theta" and predicted.size > 2:
            states["theta_dot"] = (time, np.interp(time, at, np.gradient(predicted, at)))
    return states


def _excess(reports: Sequence[ResidualReport]) -> float:
    """Squared error above the noise floors, in squared floors, summed over outputs and recordings."""
    return sum(max(report.ratio**2 - 1.0, 0.0) for report in reports)


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
