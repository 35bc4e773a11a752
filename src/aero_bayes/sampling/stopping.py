"""The rule by which sampling stops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.sampling.diagnostics import Convergence, check_convergence
from aero_bayes.sampling.settings import SampleSettings

#: Smallest number of steps that are judged, and of autocorrelation times of a chain whose walkers depend on each other.
MIN_STEPS, MIN_AUTOCORRELATION_TIMES = 50, 50.0


@dataclass(frozen=True)
class StoppingDecision:
    """Whether a chain may stop, which criteria it misses, and at how many steps to decide again."""

    enough: bool
    reason: str
    diagnoses: tuple[Convergence, ...]
    next_check: int

    @property
    def line(self) -> str:
        tau, ess = max(d.tau for d in self.diagnoses), min(d.ess_bulk for d in self.diagnoses)
        return f"R-hat {max(d.r_hat for d in self.diagnoses):.4f}, tau {tau:.1f}, ESS {ess:.0f}"


def decide(points: FloatArray, settings: SampleSettings, *, coupled: bool) -> StoppingDecision:
    """Apply the stopping rule to kept points, shape (ensembles, steps, walkers, d).

    ``coupled`` says whether a walker moves by where others of its ensemble are."""
    # Walkers that depend on each other count as one series: that of their mean. It must be longer to be judged.
    length, dimension = max(settings.lengths, MIN_AUTOCORRELATION_TIMES if coupled else 0.0), points.shape[-1]
    if points.shape[1] < 8:
        nothing = Convergence(np.inf, np.inf, 0.0, 0.0)
        return StoppingDecision(False, "fewer than 8 steps were kept", (nothing,) * dimension, MIN_STEPS)
    steps = points.shape[1]
    diagnoses = tuple(check_convergence(points[..., j], coupled=coupled) for j in range(dimension))
    tau, worst = max(d.tau for d in diagnoses), max(d.r_hat for d in diagnoses)
    low = min(min(d.ess_bulk, d.ess_tail) for d in diagnoses)
    missed, wanted = [], float(steps)
    if worst > settings.r_hat:
        missed.append(f"R-hat {worst:.4f} is above {settings.r_hat:g}")
        wanted = 1.2 * steps
    if steps < length * tau:
        missed.append(f"the chain has {steps / tau:.0f} autocorrelation times, {length:g} are needed")
        wanted = max(wanted, length * tau)
    if low < settings.ess:
        missed.append(f"{low:.0f} effective samples, {settings.ess:g} are wanted")
        wanted = max(wanted, steps * settings.ess / max(low, 1.0))
    next_check = int(np.clip(np.ceil(wanted), steps + 4, 1.5 * steps + 4))
    return StoppingDecision(not missed, "; ".join(missed) or "every criterion was met", diagnoses, next_check)
