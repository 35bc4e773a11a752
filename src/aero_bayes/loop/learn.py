"""What no listed law explains: a curve at a port, learned, and the laws that then pay beside it."""

from __future__ import annotations

from dataclasses import replace

from aero_bayes.loop.attribute import Search
from aero_bayes.loop.rounds import Selection
from aero_bayes.loop.search import Found, leaves_structure, listed_alone
from aero_bayes.loop.workbench import Workbench


def learn(bench: Workbench, found: Found) -> Selection | None:
    """The best curve beside the model as it stands, with what earns a place beside it; None where there are none.

    A curve bends to anything, and pays for each of its heights: it is asked for only where listed laws failed, and one
    of more heights only where fewer leave structure.
    """
    base, family = found.base, bench.family
    learned, finer = family.learned(), family.finer()
    curves = [id_ for id_ in base.ids if id_ in learned and id_ not in finer]
    if not curves or bench.tally.late() or not leaves_structure(base, base.held):
        return None
    bench.progress("learning a curve", 0.7)
    settings = bench.settings.attribute
    search = Search(base.stands, family.groups(), {}, settings, base.settings, bench.tally.late, bench.ahead)
    search.doing = "learning a curve"
    listed = listed_alone(bench, base)
    rounds = [search.round(base.held, curves)]
    current = rounds[0].held or base.held
    fine = [id_ for id_ in base.ids if id_ in learned and finer.get(id_) in (current.effects or curves)]
    if fine and not search.late() and leaves_structure(base, current):
        rounds.append(search.round(base.held, fine))
        current = max(current, rounds[-1].held or current, key=lambda held: held.log_evidence)
    while current.effects and len(current.effects) < search.settings.max_effects and leaves_structure(base, current):
        bench.progress(f"what pays beside {current.effects[0]}", 0.72)
        if search.late():
            break
        rounds.append(search.round(current, listed))
        if rounds[-1].held is None:
            break
        current = rounds[-1].held
    bench.tally.lap("beyond the catalogue")
    every = tuple(replace(r, number=k + 1) for k, r in enumerate((*found.selection.rounds, *rounds)))
    same = tuple(r.equivalent for r in rounds if len(r.equivalent) > 1)
    skipped = tuple(dict.fromkeys((*found.selection.skipped, *search.skipped)))
    return Selection(current, base.held, every, same, skipped, search.ended)
