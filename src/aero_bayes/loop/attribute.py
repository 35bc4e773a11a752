"""Which effect does the model lack: every candidate is refitted with all parameters free and weighed by evidence.

The comparison is between log-evidences in Laplace's approximation, each model with its own most likely noise. A
candidate must gain more than the logarithm of the number of candidates and a margin; those within a stated difference
of the best are equivalent on this data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.interpolation import LEAST_GAIN
from aero_bayes.loop.prospect import Scored, prospect, score
from aero_bayes.loop.rounds import Round, Selection, threshold, with_odds
from aero_bayes.loop.stand import Held, Stands
from aero_bayes.loop.starting import Start
from aero_bayes.loop.tries import Tries
from aero_bayes.show import listed

#: Least gain in log-evidence for which one effect takes the place of another.
SWAP = 1.0
#: Gain in log-evidence from which the model as it stands was in a wrong valley.
BETTER = 4.0


@dataclass(eq=False)
class Search(Tries):
    """Forward selection, pairs where nothing alone pays, then drop and swap.

    Once ``late`` says so nothing further is tried: what has been found by then is what there is.
    """

    rounds: list[Round] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self._first = self.stands
        self._read_again = False

    def round(
        self,
        base: Held,
        ids: Collection[str],
        *,
        wide: bool = False,
        pairs: bool = False,
        instead: Held | None = None,
        seen: Collection[str] | None = None,
    ) -> Round:
        """Score candidates; the best is chosen if it has earned its place.

        ``wide`` is to try finer laws as well, ``pairs`` to try pairs where nothing alone pays; ``instead`` and ``seen``
        are those of :meth:`scored`.
        """
        tried = self.scored(base, ids, instead, seen)
        if wide:
            tried = sorted([*tried, *self.tried_finer(base, tried)], key=lambda s: -s.gain)
        scores, nothing, untried = with_odds(tried)
        bar = threshold(len(scores), self.settings)
        number = len(self.rounds) + 1
        best = self._plainest(scores)
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

    def _plainest(self, scores: Sequence[Scored]) -> Scored | None:
        """The best, or another that is as good where a shape of the best is on its bound: it is none of its kind."""
        best = scores[0] if scores else None
        if best is None or best.held is None:
            return best
        equal = [s for s in scores if s.held is not None and s.gain >= best.gain - self.settings.equivalence]
        return next((s for s in equal if s.held is not None and s.held.shows_shape(s.candidate.id)), best)

    def _pair(self, base: Held, alone: Round, least: float = 0.0, best_of_round: bool = True) -> Round:
        """Nothing alone pays, or only ``least``: the most promising two by two, at the price of so many pairs.

        Beside the best of the round, if they are asked for, those that promise much together only.
        """
        count = len(alone.scores)
        bar = least + math.log(max(count * (count - 1) / 2.0, 1.0)) + self.settings.margin
        best: Held | None = None
        tries = [self.likely_pairs(base, alone.scores)]
        if best_of_round:
            others = [s for s in alone.scores if s is not alone.chosen]
            tries.append(self.best_in_pairs(others, base.log_evidence + bar))
        for both in chain(*tries):
            if self.late():
                break
            if best is None or both.log_evidence > best.log_evidence:
                best = both
        if best is None or best.log_evidence - base.log_evidence < bar:
            return alone
        second = best.stand.candidates[best.effects[-1]]
        chosen = Scored(second, best, best.log_evidence - base.log_evidence)
        names = " and ".join(best.effects[len(base.effects) :])
        why = f"{alone.why}; together {names} gain {chosen.gain:.1f} (needed {bar:.1f})"
        return replace(alone, threshold=bar, chosen=chosen, equivalent=(), why=why)

    def select(
        self, base: Held, ids: Sequence[str], structured: Callable[[Held], bool], told: Callable[[str, float], None]
    ) -> Selection:
        """One effect a round; at the end drop and swap over the whole list.

        A first effect may explain only half of what is missing, so that a wrong one can win the first round.
        ``structured`` says whether a fit leaves structure, in which case pairs are tried.
        """
        current = self._required(base)
        while len(current.effects) < self.settings.max_effects and not self.late():
            beside = f" beside {listed(current.effects)}" if current.effects else ""
            self._begin(told, f"round {len(self.rounds) + 1}{beside}", len(self.rounds))
            room = self.settings.max_effects - len(current.effects) > 1
            unexplained = structured(current)
            found = self.round(current, ids, wide=unexplained, pairs=room and unexplained)
            self.rounds.append(found)
            if found.held is None:
                break
            current = found.held
            if self.late():
                continue
            if len(current.effects) > 1:
                better = self._reread(current)
            else:
                better = self._settled(current) or self._from_there(base, current)
            if better is not None:
                base = current = better
                self.rounds.clear()
        if current.effects and self.settings.max_effects > 1 and not self.settings.require and not self.late():
            current = self._instead(base, current, structured, told)
        equivalent = [found.equivalent for found in self.rounds if found.chosen is not None]
        if len(current.effects) > 1 and not self.late():
            self._begin(told, "drop and swap", self.settings.max_effects)
            current, equivalent = self._swapped(base, current, ids)
            if (better := self._reread(current)) is not None:
                self.rounds.clear()
                return self.select(better, ids, structured, told)
        return Selection(
            current,
            base,
            tuple(self.rounds),
            tuple(e for e in equivalent if len(e) > 1),
            tuple(self.skipped),
            self.ended,
        )

    def _instead(
        self, base: Held, current: Held, structured: Callable[[Held], bool], told: Callable[[str, float], None]
    ) -> Held:
        """Two others in place of effects that leave structure.

        Where two things are missing, a third that does a little of both may gain more than either; where it has found
        no second the best of the first round are tried in pairs, too.
        """
        if not structured(current):
            return current
        self._begin(told, f"pairs in place of {listed(current.effects)}", len(self.rounds))
        first = self.rounds[0]
        gain = current.log_evidence - base.log_evidence
        found = self._pair(base, first, gain, best_of_round=len(current.effects) == 1)
        if found is first or found.held is None:
            return current
        self.rounds.append(replace(found, number=len(self.rounds) + 1))
        return found.held

    def _settled(self, current: Held) -> Held | None:
        """The model as it stands, solved more finely, with its inputs read the other way or with more parameters free;
        None if none is called for.

        A fit without the first effect may be too far off to show any.
        """
        if self.stands is not self._first:
            return None
        if (finer := self.stands.finer(current)) is not None:
            current = self._turned(finer, current, lambda found, last: True)
        if (other := self.stands.read_otherwise()) is not None:
            current = self._turned(other, current, _likelier)
        undecided = self.stands.undecided
        bar = threshold(len(undecided), self.settings)
        for name in undecided:
            freed = self.stands.freed(name)
            current = self._turned(freed, current, lambda found, last: found.log_evidence > last.log_evidence + bar)
        if self.stands is self._first:
            return None
        return current.stand.fit(current.values, (), current.optimum.noise, self.fit)

    def _reread(self, current: Held) -> Held | None:
        """The model as it stands with its inputs read the other way between the samples, if that does what the last
        effect does; None if not.

        Half a sample too early looks like a lag or a delay, and beside a first effect that is not quite the one that
        is missing the reading may have been taken wrongly.
        """
        if self._read_again or self.settings.require or (other := self.stands.read_otherwise()) is None:
            return None
        found = self._turned(other, current, lambda f, last: f.log_evidence > last.log_evidence, current.effects[:-1])
        if found is current:
            return None
        self._read_again = True
        return found.stand.fit(found.values, (), found.optimum.noise, self.fit)

    def _turned(
        self,
        other: Stands,
        current: Held,
        better: Callable[[Held, Held], bool],
        effects: tuple[str, ...] | None = None,
    ) -> Held:
        """The same effects, or those given, on other stands, which take the place of these if the fit there is
        better than here."""
        effects = current.effects if effects is None else effects
        try:
            found = other.of(current.stand.candidates).fit(current.values, effects, current.optimum.noise, self.fit)
        except CannotFinishError:
            found = current
        if found is current or not better(found, current):
            other.forget()
            return current
        self.stands.forget()
        self.stands = other
        return found

    def _from_there(self, base: Held, current: Held) -> Held | None:
        """The model as it stands, fitted anew from where its first effect led it; None if that is no better.

        A fit that stopped in a wrong valley is led out of it by whatever it is given, which must not pass for physics.
        """
        (effect,) = current.effects
        without = self.without(base, current, effect)
        return without if without is not None and without.log_evidence > base.log_evidence + BETTER else None

    def _begin(self, told: Callable[[str, float], None], what: str, step: int) -> None:
        """Say what is done from now on, and say how far it is with each candidate."""

        furthest = 0.0

        def tell(done: float) -> None:
            nonlocal furthest
            furthest = max(furthest, min(done, 1.0))
            told(what, (step + furthest) / (self.settings.max_effects + 1))

        self.tell, self.doing = tell, what
        tell(0.0)

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
            likely = prospect(here, here.stand.candidates[id_], any_start, self.fit)
            # From where it is off, too: where no line promises anything nobody looked whether it can be simulated.
            off = Start(0.0, here.optimum.coordinates)
            found = score(replace(likely, starts=(*likely.starts, off)), self.fit)
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
            if self.late():
                break
            changed, equivalent = False, []
            for effect in current.effects:
                if effect not in current.effects or effect in self.settings.require or self.late():
                    continue
                without = self.without(base, current, effect)
                if without is None:
                    continue
                bar = threshold(len(ids), self.settings)
                if current.log_evidence - without.log_evidence < bar:
                    current, changed = without, True
                    continue
                missed[effect] = current.log_evidence - without.log_evidence
                every = dict.fromkeys((*ids, *current.effects))
                found = self.round(without, every, instead=current, seen={*self._rivals(effect), *current.effects})
                best = self._plainest(found.scores)
                if best is not None and best.held is not None and best.held.log_evidence > current.log_evidence + SWAP:
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

    def _rivals(self, effect: str) -> set[str]:
        """The best of the rounds in which an effect was among them; of every round where it was in none."""
        best = [{s.candidate.id for s in r.scores[: self.settings.near] if s.held is not None} for r in self.rounds]
        return set().union(*([ids for ids in best if effect in ids] or best))

    def without(self, base: Held, held: Held, effect: str) -> Held | None:
        """The model with one effect switched off, refitted: from where it is, and from the round before it came in.

        From one start only it may end in a wrong valley, and its rivals look better or worse than they are. None where
        it cannot be simulated without.
        """
        rest = tuple(e for e in held.effects if e != effect)
        start = held.values
        off = {held.stand.study.parameters.names[j] for j in held.stand.candidates[effect].columns}
        first = {name: value for name, value in start.items() if name not in off}
        before = next((r.base for r in self.rounds if r.chosen is not None and r.chosen.candidate.id == effect), base)
        starts = ((first, held.optimum.noise), ({**first, **before.values}, before.optimum.noise))
        fits = [partial(held.stand.fit, values, rest, noise, self.fit) for values, noise in starts]
        self.ahead(fits, 0.0, 0.0)
        tries: list[Held] = []
        for fit in fits:
            with suppress(CannotFinishError):
                tries.append(fit())
        return max(tries, key=lambda h: h.log_evidence, default=None)


def _likelier(found: Held, last: Held) -> bool:
    return found.optimum.log_likelihood > last.optimum.log_likelihood + LEAST_GAIN
