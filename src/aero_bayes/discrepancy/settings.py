"""How the closed loop works: one object for all that a user may choose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from aero_bayes.discrepancy.attribute import AttributeSettings
from aero_bayes.discrepancy.refit import RefitSettings
from aero_bayes.inference.parameters import Override
from aero_bayes.simulation.interface import SolverSettings


@dataclass(frozen=True)
class LoopSettings:
    """How the loop works.

    Parameters
    ----------
    attribute, refit : settings of the search and of each refit
    effects : tuple of str, optional
        Ids of the catalogue to consider; all by default.
    held_out : float
        Share of each recording, at its end, that is kept from the fit where no test recording is given.
    fixed : mapping of str to float
        Model parameters held at other values than the model's own.
    overrides : mapping of str to Override
        Priors and bounds in place of the defaults.
    free : tuple of str, optional
        Parameters of the base model to fit; by default those of the AERO but for the inductance.
    solver : SolverSettings
    locate : bool
        Whether the port signals are inferred also where an effect explains all; the page draws them.
    left_over : float
        What may be left beside named effects, of the error above the noise floor and of the evidence they gained;
        beyond it they are not named.
    astray : float
        How many times what the fit leaves the error on data that was not fitted may be; beyond it effects are not
        named.
    most_readings : int
        Readings an output and recording that the search uses; more are thinned.
    """

    attribute: AttributeSettings = field(default_factory=AttributeSettings)
    refit: RefitSettings = field(default_factory=RefitSettings)
    effects: tuple[str, ...] | None = None
    held_out: float = 0.3
    fixed: Mapping[str, float] = field(default_factory=dict)
    overrides: Mapping[str, Override] = field(default_factory=dict)
    free: tuple[str, ...] | None = None
    solver: SolverSettings = field(default_factory=lambda: SolverSettings(1e-5, 1e-5))
    locate: bool = True
    left_over: float = 0.3
    astray: float = 3.0
    most_readings: int = 8000
