"""A loop that goes on from a fit: its recordings, its model, and what it says of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.parameters import Override
from aero_bayes.estimate.recording_parameters import templates
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.simulation.interface import ParameterTarget


def recordings_of(fit: Fit) -> Sequence[Recording]:
    """Return the recordings of a fit; InputError for one that was made without them."""
    if not fit.calibration.recordings:
        raise InputError("the fit holds no recordings: give them, and the model, in place of the fit")
    return fit.calibration.recordings


def settings_of(fit: Fit, settings: LoopSettings) -> LoopSettings:
    """Return the settings of a loop that begins at a fit: free parameters, their bounds and priors, and fixed values.

    Free ones keep their declared values, from which the search fits structures too. What the settings say themselves
    of free and fixed parameters and of overrides counts. Inputs are read as the fit read them, unless the settings
    leave that to the data.
    """
    calibration = fit.calibration
    free = {calibration.parameters.items[j].name for j in fit.free}
    shared = [p for p in templates(calibration.parameters) if isinstance(p.target, ParameterTarget)]
    searched = [p for p in shared if p.name in free or p.per_recording]
    overrides = {
        p.name: Override(p.start, p.lower, p.upper, p.prior, p.scale, per_recording=p.per_recording) for p in searched
    }
    later = settings.free_later
    held = {p.name: float(fit[p.name]) for p in shared if p not in searched and p.name not in later}
    own = settings.calibration.interpolation
    return replace(
        settings,
        free=settings.free or tuple(overrides),
        overrides={**overrides, **settings.overrides},
        fixed={**calibration.fixed, **held, **settings.fixed},
        calibration=replace(
            settings.calibration, interpolation=own if own == "auto" else calibration.interpolation or "hold"
        ),
        global_search=replace(settings.global_search, swarm=None, staged=False),
    )
