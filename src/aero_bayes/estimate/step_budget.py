"""How many steps of the solver a run of a candidate may take, so that none takes all the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.simulation.interface import Simulator

#: Steps of a candidate over those of the first model on the same recording. Dry friction needs about ten times as many.
MOST_STEPS_RATIO = 20
#: Steps of the first model that count at least: a run without any may lack just what moves it.
LEAST_STEPS = 100


def steps_taken(calibration: Calibration, simulator: Simulator, coordinates: FloatArray) -> tuple[int, ...]:
    """Return the steps that one run of each recording takes; none where the simulator does not count them."""
    steps = simulator.simulate(calibration.parameters.from_search(coordinates)[None]).steps
    return () if steps is None else tuple(int(n) for n in steps[0])


def with_step_budget(calibration: Calibration, steps: Sequence[int]) -> Calibration:
    """Return a calibration whose runs end as too slow beyond a multiple of the first model's ``steps``."""
    if not steps:
        return calibration
    pairs = zip(calibration.data.experiments, steps, strict=True)
    limited = (replace(e, most_steps=MOST_STEPS_RATIO * max(n, LEAST_STEPS)) for e, n in pairs)
    return replace(calibration, data=calibration.data.with_experiments(limited))
