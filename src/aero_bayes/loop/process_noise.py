"""Process noise of what came out of the loop: whether a random force explains what the laws leave."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from aero_bayes.check.residual_tests import structured_residuals
from aero_bayes.errors import CannotFinishError
from aero_bayes.judge.checks import find_disturbance
from aero_bayes.loop.conclude import Conclusion
from aero_bayes.loop.context import LoopContext
from aero_bayes.loop.extend import fitted_parameters
from aero_bayes.loop.found_process_noise import FoundProcessNoise
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.search.explored import SearchControl
from aero_bayes.search.models import ModelCache
from aero_bayes.search.process_noise import MAX_READINGS, ProcessNoiseFit, fit_process_noise
from aero_bayes.simulation import Model


def states_of(model: Model, settings: LoopSettings) -> tuple[str, ...]:
    """States that process noise may drive: those of the settings, else all of the first model.

    Raises
    ------
    InputError
        For a state that the model does not have.
    """
    wanted = [s.name for s in model.states] if settings.process_noise is None else settings.process_noise
    for name in settings.initial_sd:
        model.state_index(name)
    return tuple(dict.fromkeys(model.states[model.state_index(name)].name for name in wanted))


def find_process_noise(
    context: LoopContext, cache: ModelCache, conclusion: Conclusion, states: Sequence[str]
) -> FoundProcessNoise | None:
    """Process noise of some states beside the model that came out; None where there is none to find.

    That is where the model leaves no structure or a single disturbance, and where process noise gains nothing.
    """
    edits = context.settings.search_parts.last_edits
    left = structured_residuals(conclusion.reports)
    if not left or not edits or find_disturbance(conclusion.reports) is not None:
        return None
    explored, structure = conclusion.explored, conclusion.chosen.structure
    structure = structure if conclusion.effects else structure.minus(*structure.terms)
    fitted = explored.fits.get(structure)
    if fitted is None:
        return None
    few = cache.thinned(MAX_READINGS)
    control = SearchControl(
        context.statistics.time_is_up, context.ahead, lambda what, share: context.progress(what, 0.92 + 0.04 * share)
    )
    settings, margin = replace(context.settings.local_fit, hold_noise=True), context.settings.structures.beam_margin
    found: tuple[ProcessNoiseFit, ...] = ()
    with suppress(CannotFinishError):
        found = fit_process_noise(few, fitted, explored, states, edits, settings, control, margin)
    result = _result(context, conclusion, found) if found and found[0].score > 0.0 else None
    few.close(context.statistics.add_simulations)
    context.statistics.end_stage("process noise")
    return result


def _result(context: LoopContext, conclusion: Conclusion, found: tuple[ProcessNoiseFit, ...]) -> FoundProcessNoise:
    best, within = found[0], context.settings.structures.equivalence
    objective, fit = best.fitted.model.objective, best.fitted.optimum
    calibration, parameters = objective.calibration, objective.parameters
    rivals = [f for f in found[1:] if f.score > best.score - within and f.explains == best.explains]
    written = conclusion.written.names.values() if conclusion.written is not None else ()
    names = {old: new for pairs in written for old, new in pairs}
    fitted = [replace(p, name=names.get(name, name)) for name, p in fitted_parameters(parameters, fit).items()]
    smoothed = objective.smoothed_states(parameters.from_search(fit.coordinates))
    by_recording = zip(context.recordings.train, calibration.experiments, smoothed, strict=True)
    return FoundProcessNoise(
        states=best.states,
        explains=best.explains,
        gain=best.gain,
        needed=best.needed,
        equivalent=tuple(f.states for f in rivals if len(f.states) == len(best.states)),
        parameters={p.name: p for p in fitted},
        innovations=best.reports,
        smoothed={r.name: states.at(r.time, e.time) for r, e, states in by_recording},
        state_names=tuple(state.name for state in calibration.model.states),
    )
