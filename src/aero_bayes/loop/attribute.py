"""Which effect does the model lack: every candidate is refitted with all parameters free and weighed by evidence.

The comparison is between log-evidences in Laplace's approximation, each model with its own most likely noise. A
candidate must gain more than the logarithm of the number of candidates and a margin; those within a stated difference
of the best are equivalent on this data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.loop.settings import AttributeSettings
from aero_bayes.loop.stand import Held, Stand, Stands
from aero_bayes.physics.kin import Candidate
from aero_bayes.sensors.noise import OutputNoise

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate beside those already chosen: its refit and its gain in log-evidence over the model without it.

    ``promise`` is the gain in log-likelihood that one simulation foretold; where it is tiny there is no refit. ``odds``
    is its probability among all that the round tried, nothing, and what was not tried.
    """

    candidate: Candidate
    held: Held | None
    gain: float
    promise: float = 0.0
    odds: float = 0.0


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the candidates, best first, and what was made of them.

    ``nothing`` and ``untried`` are the odds of no effect and of one that no candidate is.
    """

    number: int
    base: Held
    scores: tuple[Scored, ...]
    threshold: float
    chosen: Scored | None
    equivalent: tuple[str, ...]
    why: str
    nothing: float = 0.0
    untried: float = 0.0


@dataclass(frozen=True, eq=False)
class Selection:
    """The effects that earned their place, in the order in which they were found, and how they were."""

    held: Held
    base: Held
    rounds: tuple[Round, ...]
    equivalent: tuple[tuple[str, ...], ...]

    @property
    def effects(self) -> tuple[str, ...]:
        return self.held.effects


#: Prior odds that what is missing is something that no candidate is, and the share of a gain in log-evidence that a
#: candidate's odds are built on (the evidence of correlated residuals is surer of itself than it should be).
UNTRIED, TEMPER = 0.02, 0.5
#: How many times its noise a residual must be to be looked at by least squares too, and how many independent pieces it
#: then counts for.
FAR, PIECES = 1.5, 50.0


def threshold(candidates: int, settings: AttributeSettings) -> float:
    """Least gain in log-evidence that counts as a discovery among so many candidates."""
    return math.log(max(candidates, 1)) + settings.margin


def with_odds(scores: Sequence[Scored]) -> tuple[tuple[Scored, ...], float, float]:
    """Scores with their odds, then the odds of nothing and of what was not tried; they add up to one."""
    if not scores:
        return (), 1.0 - UNTRIED, UNTRIED
    prior = math.log(0.5 / len(scores))
    logs = np.array([math.log(0.5), *(prior + TEMPER * s.gain if math.isfinite(s.gain) else -np.inf for s in scores)])
    logs -= logs.max()
    shares = np.exp(logs) / np.exp(logs).sum() * (1.0 - UNTRIED)
    return tuple(replace(s, odds=float(p)) for s, p in zip(scores, shares[1:], strict=True)), float(shares[0]), UNTRIED


@dataclass(frozen=True, eq=False)
class Start:
    """Where a refit may start: coordinates, the gain in log-likelihood that they promise, and if by least squares."""

    promise: float
    point: FloatArray
    squares: bool = False


def starting_points(stand: Stand, base: Optimum, candidate: Candidate) -> list[Start]:
    """Starting coordinates of a candidate, best first.

    One plain simulation a start. What it changes in the outputs, after the other parameters have readjusted along
    their own sensitivities, is a direction in the space of residuals; how far to go along it and what that gains
    follow in closed form: under the present noise, and, where a misfit is far larger than that noise, by least squares,
    which sees the misfit as a whole.
    """
    study = stand.study
    parameters = study.parameters
    columns = list(candidate.columns)
    values = parameters.from_search(base.coordinates)
    rows = np.repeat(base.coordinates[np.newaxis, :], len(candidate.starts), axis=0)
    for k, start in enumerate(candidate.starts):
        at = values.copy()
        at[columns] = start
        rows[k, columns] = parameters.to_search(at)[columns]
    tried = [(row, residual) for row, residual in zip(rows, study.residuals(rows), strict=True) if residual is not None]
    points = _along(stand, base, candidate, tried)
    noise = _misfit(stand, base)
    if noise is not None:
        assert base.evaluation.slopes is not None
        plain = study.whiten(base.evaluation.residual, base.evaluation.slopes, noise)
        squares = _along(stand, replace(base, noise=noise, whitened=plain), candidate, tried)
        total = float(plain.residual @ plain.residual)
        points += [
            Start(-0.5 * PIECES * math.log(max(1.0 - 2.0 * s.promise / total, 1e-12)), s.point, True) for s in squares
        ]
    return sorted(points, key=lambda s: -s.promise)


def _misfit(stand: Stand, base: Optimum) -> dict[str, OutputNoise] | None:
    """Each output's residual as white noise of its size, where one is far larger than the noise allows."""
    squares: dict[str, list[FloatArray]] = {}
    for series, residual in zip(stand.study.series, base.evaluation.residual, strict=True):
        squares.setdefault(series.output, []).append(residual**2)
    rms = {output: math.sqrt(float(np.mean(np.concatenate(parts)))) for output, parts in squares.items()}
    if all(size < FAR * base.noise[output].sd for output, size in rms.items()):
        return None
    return {output: OutputNoise(max(size, 1e-300)) for output, size in rms.items()}


def _along(
    stand: Stand, base: Optimum, candidate: Candidate, tried: Sequence[tuple[FloatArray, Sequence[FloatArray]]]
) -> list[Start]:
    """How far to go from the base towards each tried point, and what that promises."""
    parameters = stand.study.parameters
    columns, free = list(candidate.columns), list(base.free)
    low, high = parameters.box
    slopes = base.whitened.slopes
    _, second = parameters.prior_derivatives(base.coordinates)
    curvature = slopes @ slopes.T + np.diag(np.maximum(-second[free], 1e-9))
    points = []
    for row, residual in tried:
        change = base.whitened.residual - stand.study.whiten(residual, None, base.noise).residual
        back = np.linalg.solve(curvature, slopes @ change)
        direction = change - back @ slopes
        power = float(direction @ direction)
        if power <= 0.0:
            continue
        along = float(direction @ base.whitened.residual) / power
        start = row.copy()
        # The first column of an effect is its magnitude, zero where the effect is off.
        reach = float(np.clip(along, 0.05, 3.0))
        start[columns[0]] = np.clip(reach * row[columns[0]], low[columns[0]], high[columns[0]])
        start[free] = np.clip(base.coordinates[free] - reach * back, low[free], high[free])
        points.append(Start(0.5 * max(along, 0.0) ** 2 * power, start))
    return points


def score(base: Held, candidate: Candidate, settings: AttributeSettings, fit: ClimbSettings) -> Scored:
    """Refit the model with one more effect, from the most promising of its starts.

    A candidate that promises almost nothing at any start is not refitted.
    """
    points = starting_points(base.stand, base.optimum, candidate)
    first = points[0].promise if points else -math.inf
    if first < settings.promise:
        return Scored(candidate, None, min(first, 0.0), max(first, 0.0))
    effects = (*base.effects, candidate.id)
    best: Held | None = None
    for by_squares in (False, True):
        own = [p for p in points if p.squares == by_squares]
        for start in own[: 1 if by_squares else settings.starts]:
            if start.promise < settings.promise or (best is not None and start.promise < 0.3 * own[0].promise):
                break
            found = _refit(base, effects, start, fit)
            if found is not None and (best is None or found.log_evidence > best.log_evidence):
                best = found
    gain = best.log_evidence - base.log_evidence if best is not None else -math.inf
    return Scored(candidate, best, float(gain), first)


def _refit(base: Held, effects: tuple[str, ...], start: Start, fit: ClimbSettings) -> Held | None:
    """A climb from a start; one by least squares goes a while that way first."""
    study, free = base.stand.study, base.stand.free(effects)
    point, noise = start.point, base.optimum.noise
    try:
        if start.squares:
            plain = replace(fit.rough(12, 0.5), kinds=dict.fromkeys(study.outputs, "white"))
            point = climb(study, point, free, settings=plain).coordinates
            return Held(base.stand, effects, climb(study, point, free, settings=fit))
        return Held(base.stand, effects, climb(study, point, free, noise=noise, settings=fit))
    except CannotFinishError:
        return None


class Search:
    """Forward selection, pairs where nothing alone pays, then drop and swap."""

    def __init__(
        self, stands: Stands, groups: Sequence[Sequence[str]], settings: AttributeSettings, fit: ClimbSettings
    ) -> None:
        self.stands, self.groups, self.settings, self.fit = stands, groups, settings, fit
        self.rounds: list[Round] = []

    def moved(self, held: Held, extra: Collection[str]) -> Held:
        """The same fit on a stand that has further candidates."""
        stand = self.stands.of((*held.effects, *extra))
        if stand is held.stand:
            return held
        return stand.fit(held.values, held.effects, held.optimum.noise, self.fit)

    def scored(self, base: Held, ids: Collection[str]) -> list[Scored]:
        """Candidates beside what the model has, each group on its own stand; best first."""
        scores: list[Scored] = []
        for group in self.groups:
            own = [id_ for id_ in group if id_ in ids and id_ not in base.effects]
            if own:
                try:
                    here = self.moved(base, group)
                except CannotFinishError:
                    # A law that is off can still be too stiff for this recording: it is not tried.
                    continue
                scores += [score(here, here.stand.candidates[id_], self.settings, self.fit) for id_ in own]
        return sorted(scores, key=lambda s: -s.gain)

    def round(self, base: Held, ids: Collection[str], *, pairs: bool) -> Round:
        """Score candidates; the best is chosen if it has earned its place."""
        scores, nothing, untried = with_odds(self.scored(base, ids))
        bar = threshold(len(scores), self.settings)
        number = len(self.rounds) + 1
        best = scores[0] if scores else None
        if best is None or best.held is None or best.gain < bar:
            name = f"the best, {best.candidate.id}, gains {best.gain:.1f}" if best is not None else "there is none"
            why = f"no candidate gains {bar:.1f} in log-evidence: {name}"
            found = Round(number, base, scores, bar, None, (), why, nothing, untried)
            return self._pair(base, found) if pairs else found
        equal = tuple(
            s.candidate.id for s in scores if s.gain >= best.gain - self.settings.equivalence and s.gain >= bar
        )
        why = f"{best.candidate.id} gains {best.gain:.1f} in log-evidence (needed {bar:.1f})"
        if len(equal) > 1:
            why += f"; {', '.join(equal[1:])} within {self.settings.equivalence:g} of it"
        return Round(number, base, scores, bar, best, equal, why, nothing, untried)

    def _pair(self, base: Held, alone: Round) -> Round:
        """Nothing alone pays: the most promising two by two, at the price of so many pairs."""
        count = len(alone.scores)
        likely = sorted((s for s in alone.scores if s.held is not None), key=lambda s: -s.gain)[: self.settings.pairs]
        bar = math.log(max(count * (count - 1) / 2.0, 1.0)) + self.settings.margin
        best: Scored | None = None
        for k, first in enumerate(likely):
            for second in likely[k + 1 :]:
                if first.candidate.id == second.candidate.id or first.held is None:
                    continue
                here = self.moved(first.held, [second.candidate.id])
                both = score(here, here.stand.candidates[second.candidate.id], self.settings, self.fit)
                if both.held is not None:
                    gain = both.held.log_evidence - base.log_evidence
                    if best is None or gain > best.gain:
                        best = replace(both, gain=gain)
        if best is None or best.held is None or best.gain < bar:
            return alone
        names = " and ".join(best.held.effects[len(base.effects) :])
        why = f"{alone.why}; together {names} gain {best.gain:.1f} (needed {bar:.1f})"
        return replace(alone, threshold=bar, chosen=best, equivalent=(), why=why)

    def select(
        self, base: Held, ids: Sequence[str], structured: Callable[[Held], bool], told: Callable[[str, float], None]
    ) -> Selection:
        """One effect a round; at the end drop and swap over the whole list.

        A first effect may explain only half of what is missing, so that a wrong one can win the first round.
        ``structured`` says whether a fit leaves structure, in which case pairs are tried.
        """
        current = self._required(base)
        while len(current.effects) < self.settings.max_effects:
            told(f"round {len(self.rounds) + 1}", len(self.rounds) / (self.settings.max_effects + 1))
            room = self.settings.max_effects - len(current.effects) > 1
            found = self.round(current, ids, pairs=room and structured(current))
            self.rounds.append(found)
            if found.chosen is None or found.chosen.held is None:
                break
            current = found.chosen.held
        equivalent = [found.equivalent for found in self.rounds if found.chosen is not None]
        if len(current.effects) > 1:
            told("drop and swap", self.settings.max_effects / (self.settings.max_effects + 1))
            current, equivalent = self._swapped(base, current, ids)
        return Selection(current, base, tuple(self.rounds), tuple(e for e in equivalent if len(e) > 1))

    def _required(self, base: Held) -> Held:
        """The fit with what the engineer requires, each a round of its own.

        Raises
        ------
        CannotFinishError
            If the model cannot be simulated with one of them.
        """
        any_start = replace(self.settings, promise=-math.inf)
        for id_ in self.settings.require:
            here = self.moved(base, [id_])
            found = score(here, here.stand.candidates[id_], any_start, self.fit)
            if found.held is None:
                raise CannotFinishError(f"the model cannot be simulated with {id_}, which [loop] require names")
            scores, nothing, untried = with_odds([found])
            why = f"{id_} is required, and gains {found.gain:.1f} in log-evidence"
            self.rounds.append(Round(len(self.rounds) + 1, base, scores, 0.0, scores[0], (id_,), why, nothing, untried))
            base = found.held
        return base

    def _swapped(self, base: Held, current: Held, ids: Sequence[str]) -> tuple[Held, list[tuple[str, ...]]]:
        """Each effect in turn is dropped if it has not earned its place, or swapped for what explains more.

        What would be missed most stands first in the end.
        """
        equivalent: list[tuple[str, ...]] = []
        missed: dict[str, float] = {}
        for _ in range(2):
            changed, equivalent = False, []
            for effect in current.effects:
                if effect not in current.effects or effect in self.settings.require:
                    continue
                without = self.without(base, current, effect)
                bar = threshold(len(ids), self.settings)
                if current.log_evidence - without.log_evidence < bar:
                    current, changed = without, True
                    continue
                missed[effect] = current.log_evidence - without.log_evidence
                near = self._worth(without, current, ids)
                found = self.round(without, near, pairs=False)
                best = found.scores[0] if found.scores else None
                if best is not None and best.held is not None and best.held.log_evidence > current.log_evidence + 0.1:
                    changed = changed or best.candidate.id != effect
                    current = best.held
                    missed[best.candidate.id] = best.gain
                    self.rounds.append(found)
                equivalent.append(
                    tuple(
                        s.candidate.id for s in found.scores
                        if s.held is not None
                        and s.held.log_evidence > current.log_evidence - self.settings.equivalence
                    )
                )  # fmt: skip
            if not changed:
                break
        order = sorted(current.effects, key=lambda e: -missed.get(e, 0.0))
        return replace(current, effects=tuple(order)), equivalent

    def _worth(self, without: Held, current: Held, ids: Sequence[str]) -> list[str]:
        """Candidates that any round gave some chance; what never promised anything does not come back."""
        seen: Mapping[str, float] = {
            s.candidate.id: max(s.gain, s.promise) for r in self.rounds for s in r.scores if s.held is not None
        }
        return [id_ for id_ in ids if id_ not in without.effects and (id_ in seen or id_ in current.effects)]

    def without(self, base: Held, held: Held, effect: str) -> Held:
        """The model with one effect switched off, refitted: from where it is, and from the round before it came in.

        From one start only it may end in a wrong valley, and its rivals look better or worse than they are.
        """
        rest = tuple(e for e in held.effects if e != effect)
        start = held.values
        off = {held.stand.study.parameters.names[j] for j in held.stand.candidates[effect].columns}
        first = {name: value for name, value in start.items() if name not in off}
        tries = [held.stand.fit(first, rest, held.optimum.noise, self.fit)]
        before = next((r.base for r in self.rounds if r.chosen is not None and r.chosen.candidate.id == effect), base)
        again = {**first, **before.values}
        tries.append(held.stand.fit(again, rest, before.optimum.noise, self.fit))
        return max(tries, key=lambda h: h.log_evidence)
