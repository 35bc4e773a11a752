"""The search: which effects explain what the model as it stands leaves, and what explains it better."""

from __future__ import annotations

from dataclasses import dataclass

from aero_bayes.discrepancy.attribute import Selection, select
from aero_bayes.discrepancy.base_fit import BaseFit
from aero_bayes.discrepancy.judge import Prediction
from aero_bayes.discrepancy.refine import refine
from aero_bayes.discrepancy.residual import ResidualReport, inspect
from aero_bayes.discrepancy.rival import Rival, find_rival
from aero_bayes.discrepancy.workbench import Workbench


@dataclass(frozen=True, eq=False)
class Found:
    """All evidence that there is to decide on.

    ``left`` is what the selected effects leave; ``before`` what the model as it stands predicts.
    """

    base: BaseFit
    selection: Selection
    left: tuple[ResidualReport, ...]
    rival: Rival
    before: Prediction


def search(bench: Workbench, base: BaseFit) -> Found:
    """Try every effect of the catalogue, then look beyond it."""
    bench.progress("trying every effect", 0.2)
    selection = select(
        base.study, base.refit, [c for c in base.candidates if not c.refines], bench.settings.attribute, base.settings,
        lambda what, share: bench.progress(what, 0.2 + 0.4 * share),
    )  # fmt: skip
    selection = refine(base.study, selection, base.candidates, bench.settings.attribute, base.settings)
    bench.tally.lap("attribution")
    left = inspect(base.study, selection.refit, base.floors_by_index, bench.recordings.names)
    rival = find_rival(bench, base, selection, left)
    bench.tally.lap("beyond the catalogue")
    bench.tally.count(base.study)
    before = bench.predict(base.model, base.everything, base.refit)
    return Found(base, selection, left, rival, before)
