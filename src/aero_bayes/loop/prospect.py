"""A candidate beside a fit: where a refit may start, and what the best refit gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.growing import grown
from aero_bayes.estimate.search import Stop
from aero_bayes.loop.kept import starting_points
from aero_bayes.loop.settings import AttributeSettings
from aero_bayes.loop.stand import Held
from aero_bayes.loop.starting import Around, Start
from aero_bayes.physics.kin import Candidate

#: How far below what it has to reach a fit is still worth a climb, in log-evidence.
SLACK = 20.0
#: Share of what a law has to gain that a look must promise for it to be worth more looks, and a climb.
FORLORN = 0.005


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate beside those already chosen: its refit and its gain in log-evidence over the model without it.

    ``promise`` is the gain in log-likelihood that one simulation foretold; where it is tiny there is no refit. A refit
    that would not matter was given up, with a ``gain`` less than it could have. ``odds`` is its probability among all
    that the round tried, nothing, and what was not tried.
    """

    candidate: Candidate
    held: Held | None
    gain: float
    promise: float = 0.0
    odds: float = 0.0


@dataclass(frozen=True, eq=False)
class Prospect:
    """A candidate beside a fit, before any refit: the ``starts`` worth a climb and the most that one promises."""

    base: Held
    candidate: Candidate
    starts: tuple[Start, ...]
    promise: float


def prospect(
    base: Held,
    candidate: Candidate,
    settings: AttributeSettings,
    fit: ClimbSettings,
    beside: Around | None = None,
    aim: float = -math.inf,
) -> Prospect:
    """The most promising starts of a candidate; none where all promise almost nothing.

    ``beside`` is another place on the same stand that a start is looked for from as well; ``aim`` the log-evidence that
    the candidate has to reach.
    """
    few = fit.rough(6, 0.5)
    points = starting_points(base.around, candidate, few, _worth(base, aim))
    first = max((max(s.promise, s.gain) for s in points), default=-math.inf)
    likely = [s for s in points if max(s.promise, s.gain) >= settings.promise]
    own = [s for s in likely if not s.squares and not s.held][: settings.starts]
    starts = [s for s in own if s is own[0] or s.gain >= 0.3 * own[0].gain]
    # Ways of another kind are no reason to leave one of these out: they may lead to another valley.
    starts += [s for s in likely if s.squares][:1] + [s for s in likely if s.held][:1]
    elsewhere = base.untouched if beside is None and not starts else beside
    if elsewhere is not None:
        ahead = elsewhere.base.whitened.log_likelihood - base.optimum.whitened.log_likelihood
        for other in starting_points(elsewhere, candidate, few)[:1]:
            promise = max(other.promise, other.gain) + ahead
            first = max(first, promise)
            starts += [other] if beside is not None or promise >= settings.promise else []
    return Prospect(base, candidate, tuple(starts), first)


def score(found: Prospect, fit: ClimbSettings, aim: float = -math.inf) -> Scored:
    """Refit the model with one more effect from each of its starts, as far as log-evidence ``aim`` is within reach."""
    base, candidate = found.base, found.candidate
    if not found.starts or _worth(base, aim) > max(found.promise, 0.0):
        return Scored(candidate, None, min(found.promise, 0.0), max(found.promise, 0.0))
    ends: list[Held] = []
    for start in found.starts:
        aim = max((aim, *(end.log_evidence for end in ends)))
        aiming = fit.aiming(cost_of(base, aim) + SLACK)
        held = refit(base, (*base.effects, candidate.id), start, aiming, [end.optimum for end in ends])
        ends += [held] if held is not None else []
    best = max(ends, key=lambda end: end.log_evidence, default=None)
    gain = best.log_evidence - base.log_evidence if best is not None else -math.inf
    return Scored(candidate, best, float(gain), found.promise)


def _worth(base: Held, aim: float) -> float:
    """What a look must promise for a climb to a log-evidence."""
    return FORLORN * max(aim - base.log_evidence, 0.0)


def cost_of(like: Held, log_evidence: float) -> float:
    """The cost at which a fit as sharp as another has a log-evidence."""
    sharpness = like.log_evidence - like.optimum.log_likelihood - like.optimum.log_prior
    return sharpness - log_evidence


def refit(
    base: Held, effects: tuple[str, ...], start: Start, fit: ClimbSettings, known: Sequence[Optimum] = ()
) -> Held | None:
    """A climb from a start; one by least squares goes a while that way first.

    None where it leads to what is known.
    """
    study, free = base.stand.study, base.stand.free(effects)
    point, noise = start.point, base.optimum.noise
    try:
        if start.squares:
            point = climb(study, point, free, settings=fit.rough(12, 0.5).by_squares(study.outputs)).coordinates
            end = climb(study, point, free, settings=fit, known=known)
        else:
            end = climb(study, point, free, noise=noise, settings=fit, known=known)
    except CannotFinishError:
        return None
    return Held(base.stand, effects, end) if end.reason is not Stop.MET else None


def led_up(base: Held, found: Held, fit: ClimbSettings) -> Held | None:
    """A refit of the beginning first, then of ever more; None where that leads no further than what was found.

    From the base's values, those on a bound back at their start, with the effect as large as it was found.
    """
    stand, known = found.stand, found.optimum.coordinates
    free = stand.free(found.effects)
    start = stand.study.parameters.revived(stand.at(base.values, base.effects), stand.own)
    new = [j for id_ in found.effects if id_ not in base.effects for j in stand.candidates[id_].columns]
    start[new] = known[new]
    try:
        point, _ = grown(stand.study, start, free, fit.rough(25, 0.01), stand.open, known)
        end = climb(stand.study, point, free, settings=fit, known=[found.optimum])
    except CannotFinishError:
        return None
    held = Held(stand, found.effects, end)
    return held if end.reason is not Stop.MET and held.log_evidence > found.log_evidence else None
