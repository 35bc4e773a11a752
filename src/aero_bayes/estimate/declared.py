"""What is known of parameters before any recording is seen, from what a model's package declares."""

from __future__ import annotations

from aero_bayes.declared import DeclaredParameter
from aero_bayes.errors import InputError
from aero_bayes.estimate.parameters import Override
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.simulation.model import Model


def declared_overrides(model: Model) -> dict[str, Override]:
    """Return priors, starts and bounds of the declared parameters that a model has; nothing for a model without any."""
    own = {v.name: v.start for v in model.parameters}
    declared = model.declared.parameters
    return {name: _override(name, start, declared[name]) for name in declared if (start := own.get(name)) is not None}


def _override(name: str, start: float, known: DeclaredParameter) -> Override:
    """Set bounds a factor below the smaller and above the larger of start and prior median."""
    if start <= 0.0:
        raise InputError(
            f"{name}: its declared prior is log-normal, and the model's own value {start:g} is not positive"
        )
    median = start if known.median is None else known.median
    if known.relative_sd is not None:
        prior = LogNormal.tolerance(median, known.relative_sd)
    else:
        prior = LogNormal.factor(median, known.factor)
    low, high = min(start, prior.median), max(start, prior.median)
    return Override(start, low / known.reach, high * known.reach, prior, "log", known.auto)
