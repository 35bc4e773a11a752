"""A loop that goes on from a fit: its recordings, its model, and what it says of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.parameters import Override, ParameterSet, chosen_parameters
from aero_bayes.estimate.recording_parameters import templates
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.simulation.interface import ParameterTarget


def recordings_of(fit: Fit) -> Sequence[Recording]:
    """Return the recordings of a fit; InputError for one that was made without them."""
    if not fit.calibration.data.recordings:
        raise InputError("the fit holds no recordings: give them, and the model, in place of the fit")
    return fit.calibration.data.recordings


def settings_of(fit: Fit, settings: LoopSettings) -> LoopSettings:
    """Return the settings of a loop that begins at a fit: how it was fitted, its free parameters and its fixed values.

    Free ones keep their declared values, from which the search fits structures too. What the settings say themselves
    counts. Inputs are read as the fit read them, unless that is left to the data."""
    calibration, own = fit.calibration, settings.fit or fit.settings
    shared = [p for p in templates(calibration.parameters) if isinstance(p.target, ParameterTarget)]
    free = {calibration.parameters.items[j].name for j in fit.free}
    chosen = ParameterSet(
        tuple(replace(p, free_if_identified=False) for p in shared if p.name in free or p.per_recording)
    )
    if settings.parameters is not None:
        known = {
            p.name: Override(p.start, p.lower, p.upper, p.prior, p.scale, per_recording=p.per_recording, joint=p.joint)
            for p in chosen
        }
        chosen = chosen_parameters(calibration.model, settings.parameters, known)
    fixed = {p.name: float(fit[p.name]) for p in shared if p.name not in chosen}
    between = own.calibration.interpolation
    read = replace(
        own.calibration, interpolation=between if between == "auto" else calibration.data.interpolation or "hold"
    )
    fixed = {**calibration.simulated.fixed, **fixed, **own.fixed}
    first = replace(own, method="local", cost="posterior", staged=False, calibration=read, fixed=fixed)
    return replace(settings, fit=first, parameters=chosen)
