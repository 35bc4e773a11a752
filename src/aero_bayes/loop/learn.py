"""What no listed law explains: a curve at a port, learned, and the laws that then pay beside it."""

from __future__ import annotations

from dataclasses import replace

from aero_bayes.loop.attribute import Search, Selection
from aero_bayes.loop.search import Found, leaves_structure
from aero_bayes.loop.workbench import Workbench


def learn(bench: Workbench, found: Found) -> Selection | None:
    """The best curve beside the model as it stands, with what earns a place beside it; None where no curve pays.

    A curve bends to anything, and pays for each of its heights: it is asked for only where listed laws failed.
    """
    base, family, learned, finer = found.base, bench.family, bench.family.learned(), bench.family.finer()
    curves = [id_ for id_ in base.ids if id_ in learned]
    if not curves or not leaves_structure(base, base.held):
        return None
    bench.progress("learning a curve", 0.7)
    search = Search(base.stands, family.groups(), finer, bench.settings.attribute, base.settings)
    first = search.round(base.held, curves)
    if first.chosen is None or first.chosen.held is None:
        return None
    listed = [id_ for id_ in base.ids if id_ not in finer and id_ not in learned]
    selection = search.select(
        first.chosen.held, listed, lambda held: leaves_structure(base, held), lambda what, _: bench.progress(what, 0.72)
    )
    bench.tally.lap("beyond the catalogue")
    rounds = (*found.selection.rounds, first, *selection.rounds)
    return replace(selection, base=base.held, rounds=tuple(replace(r, number=k + 1) for k, r in enumerate(rounds)))
