"""What might explain the residual better than the catalogue: a learned curve, or a disturbance of a moment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.check.structure import ResidualReport, those_structured
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.loop.base_fit import BaseFit
from aero_bayes.loop.rounds import Selection
from aero_bayes.loop.workbench import Workbench
from aero_bayes.physics.beyond import (
    CurveFit,
    CurveSearch,
    MomentFit,
    Probing,
    Visited,
    fit_curves,
    fit_moment,
    probe,
)
from aero_bayes.physics.family import ModelFamily


@dataclass(frozen=True, eq=False)
class Rival:
    """What was found beyond the catalogue.

    ``curve`` and ``moment`` only where they beat the catalogue and each other; ``best_curve`` even where it does not.
    """

    probing: Probing | None = None
    curve: CurveFit | None = None
    moment: MomentFit | None = None
    best_curve: CurveFit | None = None


def find_rival(bench: Workbench, base: BaseFit, selection: Selection, left: Sequence[ResidualReport]) -> Rival:
    """Look beyond the catalogue where it leaves structure, or needs several effects to explain one residual.

    ``left`` is what the selected effects leave.
    """
    structured = bool(those_structured(left))
    if not structured and not (selection.effects and bench.settings.locate):
        return Rival()
    family = bench.family
    if not isinstance(family, ModelFamily):
        return Rival()
    bench.progress("locating the port", 0.65)
    outputs = bench.recordings.outputs
    calibration, fit = base.held.stand.study.calibration, base.held.optimum
    visited = Visited.of(base.held.stand.study, base.held.optimum, family.declared)
    probing = probe(
        calibration, fit, visited, bench.open_objective, _fullest(calibration),
    )  # fmt: skip
    if not structured and len(selection.effects) < 2:
        return Rival(probing)
    bench.progress("looking beyond the catalogue", 0.7)
    margin = bench.settings.attribute.margin
    named = selection.held.log_evidence - len(selection.effects) * math.log(len(base.ids))
    start = base.held.values
    search = CurveSearch(family, base.plain, base.shared, start, fit, visited, bench.open_objective, base.settings)
    curves = tuple(c for c in fit_curves(search, outputs) if bench.settings.allows(c.port))
    moment = fit_moment(calibration, fit, probing, visited, bench.open_objective, base.settings)
    best_curve = curves[0].refit.log_evidence - math.log(len(curves)) if curves else -math.inf
    best_moment = moment.log_evidence if moment is not None else -math.inf
    if moment is not None and best_moment > max(named, best_curve) + margin:
        return Rival(probing, None, moment, curves[0] if curves else None)
    if curves and best_curve > max(named, best_moment) + margin:
        return Rival(probing, curves[0], None, curves[0])
    return Rival(probing, None, None, curves[0] if curves else None)


def _fullest(calibration: Calibration) -> int:
    """The recording with most readings, whose port signals are drawn."""
    readings = [int(np.isfinite(y).sum()) for y in calibration.measured]
    return int(np.argmax(readings))
