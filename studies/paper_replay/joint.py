"""The problem as one would pose it: all outputs at once, scaled axes, exact slopes, unpublished constants free."""

from __future__ import annotations

from typing import Literal

from aero_bayes.data import Recording
from aero_bayes.estimate import Fit, FitSettings, fit
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.parameters import Override, ParameterSet, parameters_from_model
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation.model import Model
from paper_replay.published import UNOPTIMISED

AeroLaw = Literal["linear", "quadratic"]

#: How far from the data sheet the thrust and drag of the linear law may be, as a factor; bounds are its square.
SPREAD = 10.0


def parameters_for(model: Model, law: AeroLaw) -> ParameterSet:
    """Return the AERO's usual free parameters; under the linear law about the paper's own thrust and drag."""
    overrides = declared_overrides(model)
    if law == "linear":
        for name in ("k_d", "k_t"):
            centre = UNOPTIMISED.model_values[name]
            prior = LogNormal.factor(centre, SPREAD)
            overrides[name] = Override(centre, centre / SPREAD**2, centre * SPREAD**2, prior, "log")
    return parameters_from_model(model, overrides=overrides)


def fit_jointly(
    recording: Recording,
    model: Model,
    law: AeroLaw,
    *,
    seed: int,
    engine: Literal["native", "fmpy"],
    workers: int | None,
) -> Fit:
    """Fit all outputs at once: particle swarm, then bounded local search, each output weighed by its own residual.

    White residuals are assumed: the table compares sums of squares, and a fit that may call a misfit correlated noise
    does not lower them.
    """
    settings = FitSettings(noise=NoiseModel("white"), engine=engine)
    return fit(
        [recording], model, parameters=parameters_for(model, law), settings=settings, seed=seed, workers=workers,
    )  # fmt: skip
