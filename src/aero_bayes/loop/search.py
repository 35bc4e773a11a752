"""The search: which effects explain what the model as it stands leaves, and what explains it better."""

from __future__ import annotations

from dataclasses import dataclass, replace

from aero_bayes.check.structure import ResidualReport, those_structured
from aero_bayes.errors import InputError
from aero_bayes.loop.attribute import Search
from aero_bayes.loop.base_fit import BaseFit, fit_from_there
from aero_bayes.loop.held_values import doubts, held_in
from aero_bayes.loop.judge import Prediction
from aero_bayes.loop.refine import refine
from aero_bayes.loop.rounds import Selection
from aero_bayes.loop.stand import Held
from aero_bayes.loop.workbench import Workbench


@dataclass(frozen=True, eq=False)
class Found:
    """All evidence that there is to decide on.

    ``left`` is what the selected effects leave; ``before`` what the model as it stands predicts.
    """

    base: BaseFit
    selection: Selection
    left: tuple[ResidualReport, ...]
    before: Prediction


def leaves_structure(base: BaseFit, held: Held) -> bool:
    """Whether a fit leaves what sensors do not explain."""
    return bool(those_structured(base.report(held)))


def listed_alone(bench: Workbench, base: BaseFit) -> list[str]:
    """Candidates that are tried on their own: no finer law of another, no learned curve."""
    others = {*bench.family.finer(), *bench.family.learned()}
    return [id_ for id_ in base.ids if id_ not in others]


def search(bench: Workbench, base: BaseFit) -> Found:
    """Try every candidate."""
    bench.progress("trying every effect", 0.2)
    bench.tally.allow(60.0 * bench.settings.max_minutes)
    ids, curves = listed_alone(bench, base), bench.family.learned()
    finer = {id_: coarse for id_, coarse in bench.family.finer().items() if id_ not in curves}
    for id_ in bench.settings.attribute.require:
        if id_ not in base.ids:
            raise InputError(f"[loop] require: no recorded output can show {id_}")
    groups, settings = bench.family.groups(), bench.settings.attribute
    effort = Search(base.stands, groups, finer, settings, base.settings, bench.tally.late, bench.ahead)
    selection = effort.select(
        base.held, ids, lambda held: leaves_structure(base, held),
        lambda what, share: bench.progress(what, 0.2 + 0.4 * share),
    )  # fmt: skip
    if not effort.late():
        selection = refine(effort, selection, finer, len(ids))
        held = held_in(bench.family.plain(), base.plain.parameters)
        selection = replace(selection, doubts=doubts(effort, selection, held))
    if selection.base is not base.held:
        base = fit_from_there(bench, base, selection.base, effort.stands)
    bench.tally.lap("attribution")
    left = base.report(selection.held)
    base, before = base.at_its_best(bench)
    return Found(base, selection, left, before)
