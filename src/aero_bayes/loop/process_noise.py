"""Process noise of what came out of the loop: whether a random force explains what the laws leave."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from aero_bayes.check.residual_tests import structured_residuals
from aero_bayes.errors import CannotFinishError
from aero_bayes.judge.disturbance import find_disturbance
from aero_bayes.loop.conclude import Conclusion
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.extend import fitted_parameters
from aero_bayes.loop.found_process_noise import FoundProcessNoise
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.search.explored import SearchControl
from aero_bayes.search.informative_part import tells_enough
from aero_bayes.search.models import CandidateModel
from aero_bayes.search.process_noise import (
    EQUIVALENT,
    MAX_FILTER_READINGS,
    MAX_FILTERED_CHANGES,
    ProcessNoiseFit,
    fit_process_noise,
)
from aero_bayes.search.structure import Structure
from aero_bayes.simulation import Model


def states_of(model: Model, settings: LoopSettings) -> tuple[str, ...]:
    """States that process noise may drive: those of the settings, else all of the first model."""
    noise = settings.fitting.noise
    for name in noise.initial_sd:
        model.state_index(name)
    wanted = noise.process or [s.name for s in model.states]
    return tuple(dict.fromkeys(model.states[model.state_index(name)].name for name in wanted))


def find_process_noise(context: LoopContext, conclusion: Conclusion, states: Sequence[str]) -> FoundProcessNoise | None:
    """Process noise of some states of the model that came out; None where there is none to find.

    That is where the model leaves no structure or a single disturbance, and where process noise gains nothing."""
    edits = context.settings.search_parts.last_edits
    if not edits or not structured_residuals(conclusion.reports) or find_disturbance(conclusion.reports) is not None:
        return None
    made: dict[Structure, CandidateModel] = {}
    share = _filtered_share(context, conclusion)

    def model_of(structure: Structure) -> CandidateModel:
        if structure not in made:
            made[structure] = _model(context, conclusion, structure.process_noise, share)
        return made[structure]

    parameters = conclusion.calibration.parameters
    at = parameters.from_search(conclusion.refit.coordinates)
    control = SearchControl(
        context.statistics.time_is_up, context.map, lambda what, share: context.progress(what, 0.92 + 0.04 * share)
    )
    found: tuple[ProcessNoiseFit, ...] = ()
    with suppress(CannotFinishError):
        found = fit_process_noise(
            model_of, dict(zip(parameters.names, at.tolist(), strict=True)), conclusion.base.floors, states, edits,
            control,
        )  # fmt: skip
    result = _result(context, found) if found and found[0].score > 0.0 else None
    for model in made.values():
        context.statistics.add_simulations(model.objective)
        model.objective.simulator.close()
    context.statistics.end_stage("process noise")
    return result


def _filtered_share(context: LoopContext, conclusion: Conclusion) -> float:
    """Return the share of each recording, from its beginning, that is filtered.

    A filter stops wherever an input changes, however few readings it has. So of long recordings whose inputs move it
    has a beginning, if that tells as much per reading as the whole."""
    calibration, fit = conclusion.calibration, conclusion.refit
    changes = max((s.time.size for e in calibration.data.experiments for s in e.inputs), default=0)
    if changes <= 2 * MAX_FILTERED_CHANGES:
        return 1.0
    share = MAX_FILTERED_CHANGES / changes
    with context.open(calibration.problem()) as simulator:
        objective = context.objective(calibration, simulator)
        while share < 1.0 and not tells_enough(
            objective, fit.evaluation, fit.noise, [share] * len(calibration.data.experiments)
        ):
            share *= 2.0
    return min(share, 1.0)


def _model(context: LoopContext, conclusion: Conclusion, states: Sequence[str], share: float) -> CandidateModel:
    """Return the model that came out, on few readings and with process noise of some states."""
    plain, written, last = conclusion.base.plain, conclusion.written, conclusion.calibration
    data = plain.data.beginning(share) if share < 1.0 else plain.data
    plain = replace(plain, data=data.thinned(MAX_FILTER_READINGS))
    if states:
        plain = plain.with_process_noise(plain.noise.with_process(states))
    calibration = plain
    if written is not None:
        calibration = replace(conclusion.base, plain=plain).with_terms(context, written.model, written.parameters)
    free, known = {last.parameters.names[j] for j in conclusion.refit.free}, set(last.parameters.names)
    own = tuple(j for j, name in enumerate(calibration.parameters.names) if name in free or name not in known)
    return CandidateModel(context.open_objective(calibration), {}, own, context.open)


def _result(context: LoopContext, found: tuple[ProcessNoiseFit, ...]) -> FoundProcessNoise:
    best, within = found[0], EQUIVALENT
    objective, fit = best.fitted.model.objective, best.fitted.optimum
    calibration, parameters = objective.calibration, objective.parameters
    rivals = [f for f in found[1:] if f.score > best.score - within and f.explains == best.explains]
    smoothed = objective.smoothed_states(parameters.from_search(fit.coordinates))
    by_recording = zip(context.recordings.train, calibration.data.experiments, smoothed, strict=True)
    return FoundProcessNoise(
        states=best.states,
        explains=best.explains,
        gain=best.gain,
        needed=best.needed,
        equivalent=tuple(f.states for f in rivals),
        parameters=fitted_parameters(parameters, fit),
        innovations=best.reports,
        smoothed={r.name: states.at(r.time, e.time) for r, e, states in by_recording},
        state_names=tuple(state.name for state in calibration.model.states),
    )
