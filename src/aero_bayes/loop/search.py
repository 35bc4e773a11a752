"""The search: which effects explain what the model as it stands leaves, and what explains it better."""

from __future__ import annotations

from dataclasses import dataclass

from aero_bayes.check.structure import ResidualReport, inspect
from aero_bayes.loop.attribute import Selection, select
from aero_bayes.loop.base_fit import BaseFit
from aero_bayes.loop.judge import Prediction
from aero_bayes.loop.refine import refine
from aero_bayes.loop.rival import Rival, find_rival
from aero_bayes.loop.workbench import Workbench


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
        base.study, base.fit, [c for c in base.candidates if not c.refines], bench.settings.attribute, base.settings,
        lambda what, share: bench.progress(what, 0.2 + 0.4 * share),
    )  # fmt: skip
    selection = refine(base.study, selection, base.candidates, bench.settings.attribute, base.settings)
    bench.tally.lap("attribution")
    left = inspect(base.calibration, base.study.series, selection.refit, base.floors)
    rival = find_rival(bench, base, selection, left)
    bench.tally.lap("beyond the catalogue")
    bench.tally.count(base.study)
    before = bench.predict(base.calibration, base.fit)
    return Found(base, selection, left, rival, before)
