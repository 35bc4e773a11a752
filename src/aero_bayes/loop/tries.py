"""Candidates beside a fit: refitted alone and two by two, each on a stand that has it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

from aero_bayes.ahead import Task, waves
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import ClimbSettings
from aero_bayes.estimate.growing import over_floor
from aero_bayes.loop.kept import promised
from aero_bayes.loop.pairs import Pair, likely_pairs
from aero_bayes.loop.prospect import Prospect, Scored, led_up, prospect, refit, score
from aero_bayes.loop.rounds import threshold
from aero_bayes.loop.settings import AttributeSettings
from aero_bayes.loop.stand import FAR, Held, Stands
from aero_bayes.loop.starting import Around, Start
from aero_bayes.physics.kin import Candidate

#: Does tasks of which some are asked for next, and says how far it is.
DoAhead = Callable[[Sequence[Task], Callable[[float], None]], None]


def never() -> bool:
    """No end of time."""
    return False


def alone(tasks: Sequence[Task], told: Callable[[float], None]) -> None:
    """No helpers."""


@dataclass(eq=False)
class Tries:
    """What a candidate is worth beside those that the model has.

    Once the time is ``up`` nothing further is tried. What is asked next is given to ``helpers``, who may find the
    answers before; no result depends on them.
    """

    stands: Stands
    groups: Sequence[Sequence[str]]
    finer: Mapping[str, str]
    settings: AttributeSettings
    fit: ClimbSettings
    up: Callable[[], bool] = never
    helpers: DoAhead = alone
    skipped: dict[str, None] = field(init=False, default_factory=dict)
    doing: str = field(init=False, default="the first round")
    ended: str = field(init=False, default="")
    tell: Callable[[float], None] = field(init=False, default_factory=lambda: lambda done: None)

    def late(self) -> bool:
        """Whether the time is up; where the search was then is kept."""
        if self.up() and not self.ended:
            self.ended = self.doing
        return bool(self.ended)

    def ahead(self, tasks: Sequence[Task], begin: float = 0.0, end: float = 1.0) -> None:
        """Tasks that are about to be done, as this share of what is being done."""
        self.helpers(tasks, lambda done: self.tell(begin + done * (end - begin)))

    def moved(self, held: Held, extra: Collection[str]) -> Held:
        """The same fit on a stand that has further candidates."""
        stand = self.stands.of((*held.effects, *extra))
        if stand is held.stand:
            return held
        return stand.fit(held.values, held.effects, held.optimum.noise, self.fit)

    def scored(
        self,
        base: Held,
        ids: Collection[str],
        instead: Held | None = None,
        seen: Collection[str] | None = None,
        least: float = -math.inf,
    ) -> list[Scored]:
        """Candidates beside what the model has, each group on its own stand; best first.

        ``instead`` is a fit with one effect more, in whose place each candidate is tried where it stands too. Of those
        that were not ``seen``, if given, only the few most promising are looked at closely. What cannot reach ``least``
        in log-evidence is given up.
        """
        prospects = self._prospects(base, ids, instead, seen, self._aim((), instead, least))
        scores: list[Scored] = []
        for wave in waves(prospects, len(prospects) if instead is not None else self.settings.near):
            tries = [partial(score, found, self.fit, self._aim(scores, instead, least)) for found in wave]
            done = len(scores)
            self.ahead(tries, 0.5 + 0.5 * done / len(prospects), 0.5 + 0.5 * (done + len(wave)) / len(prospects))
            for found, attempt in zip(wave, tries, strict=True):
                if scores and self.late():
                    break
                scored = attempt()
                # Where the same fit did not come as far on this stand, coming as far is no gain.
                behind = max(base.log_evidence - found.base.log_evidence, 0.0)
                scores.append(replace(scored, gain=scored.gain - behind))
                self.tell(0.5 + 0.5 * len(scores) / len(prospects))
        scores.sort(key=lambda s: -s.gain)
        return scores if instead is not None else self._led_up(base, scores)

    def _prospects(
        self, base: Held, ids: Collection[str], instead: Held | None, seen: Collection[str] | None, aim: float
    ) -> list[Prospect]:
        """What one look promises of candidates; most promising first."""
        beside: list[tuple[Held, Candidate, Around | None]] = []
        for group, own in self._tried_in(base, ids):
            try:
                here = self.moved(base, group)
            except CannotFinishError:
                # A law that is off can still be too stiff for this recording.
                self.skipped |= dict.fromkeys(own)
                continue
            place = here.at(instead.values, instead.optimum.noise) if instead is not None else None
            beside += [(here, here.stand.candidates[id_], place) for id_ in own]
        if seen is not None:
            new = [(here.around, candidate) for here, candidate, _ in beside if candidate.id not in seen]
            self.ahead([partial(promised, *one) for one in new], 0.0, 0.0)
            most = {candidate.id: promised(around, candidate) for around, candidate in new}
            likely = sorted(most, key=lambda id_: -most[id_])[: self.settings.near]
            beside = [one for one in beside if one[1].id in seen or one[1].id in likely]
        looks = [partial(prospect, here, one, self.settings, self.fit, other, aim) for here, one, other in beside]
        self.ahead(looks, 0.0, 0.5)
        prospects: list[Prospect] = []
        for look in looks:
            if self.late():
                break
            prospects.append(look())
            self.tell(0.5 * len(prospects) / len(beside))
        return sorted(prospects, key=lambda p: -p.promise)

    def _tried_in(self, base: Held, ids: Collection[str]) -> list[tuple[Sequence[str], list[str]]]:
        """Groups with those of some candidates in them that a fit does not have, if any."""
        found = [(group, [id_ for id_ in group if id_ in ids and id_ not in base.effects]) for group in self.groups]
        found = [(group, own) for group, own in found if own]
        self.ahead([partial(self.moved, base, group) for group, _ in found], 0.0, 0.0)
        return found

    def _led_up(self, base: Held, scores: list[Scored]) -> list[Scored]:
        """The few best refitted from the beginning on, where even the best is far off; best first."""
        best = scores[0].held if scores else None
        if best is None or over_floor(best.stand.study, best.optimum.evaluation.residual) < FAR:
            return scores
        likely = [(k, s, s.held) for k, s in enumerate(scores[: self.settings.near]) if s.held is not None]
        tries = [partial(led_up, base, held, self.fit) for _, _, held in likely]
        self.ahead(tries)
        for (k, found, held), attempt in zip(likely, tries, strict=True):
            if self.late():
                break
            if (further := attempt()) is not None:
                scores[k] = replace(found, held=further, gain=found.gain + further.log_evidence - held.log_evidence)
        return sorted(scores, key=lambda s: -s.gain)

    def _aim(self, scores: Sequence[Scored], instead: Held | None, least: float) -> float:
        """Log-evidence that a candidate must reach to matter: that of what it would replace, or of the few best."""
        if instead is not None:
            return instead.log_evidence - self.settings.equivalence
        best = sorted((s.held.log_evidence for s in scores if s.held is not None), reverse=True)
        return max(best[self.settings.near - 1] if len(best) >= self.settings.near else -math.inf, least)

    def tried_finer(self, base: Held, scores: Sequence[Scored]) -> list[Scored]:
        """Finer laws that are the best of all and explain far more than what they refine, which shows little by itself.

        Where the simple law explains most of it, whether a finer one is worth its parameters is asked at the end.
        """
        coarse = {s.candidate.id for s in scores}
        ids = [id_ for id_, of in self.finer.items() if of in coarse]
        bar = threshold(len(scores) + len(ids), self.settings)
        least = max(bar, max((s.gain for s in scores), default=bar) - self.settings.equivalence)
        found = self.scored(base, ids, least=base.log_evidence + least)
        found = [s for s in found if s.gain >= least and s.held is not None and s.held.shows_shape(s.candidate.id)]
        # what was given up as none of the few best may be worth more than it came to
        of = {self.finer[s.candidate.id] for s in found}
        gains = {s.candidate.id: s.gain for s in self.scored(base, of)} if of else {}
        return [s for s in found if s.gain > 2.0 * max(gains[self.finer[s.candidate.id]], 0.0) + bar]

    def best_in_pairs(self, scores: Sequence[Scored], aim: float) -> Iterator[Held]:
        """Refits with each two of the best of a round, as far as log-evidence ``aim`` is within reach."""
        likely = sorted((s for s in scores if s.held is not None), key=lambda s: -s.gain)[: self.settings.pairs]
        for wave in waves(list(combinations(likely, 2)), 2):
            tries = [partial(self._both, first, second.candidate.id, aim) for first, second in wave]
            self.ahead(tries)
            for attempt in tries:
                if (held := attempt()) is not None:
                    aim = max(aim, held.log_evidence)
                    yield held

    def _both(self, first: Scored, second: str, aim: float) -> Held | None:
        assert first.held is not None
        with suppress(CannotFinishError):
            here = self.moved(first.held, [second])
            return score(prospect(here, here.stand.candidates[second], self.settings, self.fit), self.fit, aim).held
        return None

    def likely_pairs(self, base: Held, scores: Sequence[Scored]) -> Iterator[Held]:
        """Refits with each two of a round's candidates that promise much together and little alone."""
        around = self._surroundings(base, {s.candidate.id for s in scores})
        tries = [partial(self._pair_of, base, pair) for pair in likely_pairs(around, self.settings.pairs)]
        self.ahead(tries)
        for attempt in tries:
            if (held := attempt()) is not None:
                yield held

    def _pair_of(self, base: Held, pair: Pair) -> Held | None:
        with suppress(CannotFinishError):
            here = self.moved(base, pair.ids)
            around = here.around.by_squares or here.around
            start = Start(pair.promise, pair.start(here.stand, around), squares=around is not here.around)
            return refit(here, (*base.effects, *pair.ids), start, self.fit)
        return None

    def _surroundings(self, base: Held, ids: Collection[str]) -> list[tuple[Around, list[Candidate]]]:
        """Candidates by stand, with how the base's parameters readjust there."""
        found: list[tuple[Around, list[Candidate]]] = []
        for group, own in self._tried_in(base, ids):
            with suppress(CannotFinishError):
                here = self.moved(base, group)
                found.append((here.around.by_squares or here.around, [here.stand.candidates[id_] for id_ in own]))
        return found
