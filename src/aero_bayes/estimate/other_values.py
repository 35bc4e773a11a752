"""Other values of parameters that may be what a fit lacks: one in each recording, or one in place of a held one.

One Newton step from the fit says which of them to try.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.display import join_names
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration, for_recordings
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import ParameterTarget

#: Most held parameters that are looked at, and most changes of each kind that are tried by a fit.
MOST_HELD, MAX_TRIED = 20, 3


@dataclass(frozen=True)
class OtherValues:
    """Parameters that are given other values: ``held`` ones so far, or free ones, each ``by_recording`` or for all."""

    parameters: tuple[Parameter, ...]
    held: bool
    by_recording: bool

    @property
    def names(self) -> str:
        """Their names in a sentence."""
        return join_names([p.name for p in self.parameters])

    @property
    def what(self) -> str:
        """What is told of them, up to what the residual does."""
        if self.by_recording:
            return f"{self.names} seems to differ from recording to recording: with a value of its own in each"
        if len(self.parameters) > 1:
            return f"{self.names} are held at values that may be wrong: with these fitted, too"
        return f"{self.names} is held at a value that may be wrong: with it fitted, too"

    @property
    def done(self) -> str:
        """What the user may do."""
        free = f"[parameters] {self.parameters[0].name} = {{free = true"
        if not self.by_recording:
            return f"Fit {'it by' if len(self.parameters) == 1 else 'them, as by'} {free}}}."
        fitted = f"by {free}, per_recording = true}}"
        return (
            f"If it is known, give value = {{NAME = ...}}; else fit it {fitted}." if self.held else f"Fit it {fitted}."
        )

    def applied(self, calibration: Calibration) -> Calibration:
        """Return the calibration with these parameters searched."""
        new = tuple(replace(p, per_recording=self.by_recording) for p in self.parameters)
        own = for_recordings(ParameterSet(new), calibration.model, calibration.data.recordings)
        return _searched(calibration, own.items, new)


def _searched(calibration: Calibration, new: Sequence[Parameter], replaced: Sequence[Parameter]) -> Calibration:
    """Return the calibration with new parameters in the place of some, fixed or free."""
    names = {p.name for p in replaced}
    kept = tuple(p for p in calibration.parameters if p.name not in names)
    fixed = {n: v for n, v in calibration.simulated.fixed.items() if n not in names}
    simulated = replace(calibration.simulated, fixed=fixed)
    return replace(calibration, parameters=ParameterSet((*kept, *new)), simulated=simulated)


def other_values(fit: Fit, open_simulator: OpenSimulator) -> list[OtherValues]:
    """List changes of values that leave least of the squares, the best of each kind first."""
    calibration, count = fit.calibration, len(fit.calibration.parameters)
    items, held = calibration.parameters.items, _held(fit.calibration)
    shared = [k for k, j in enumerate(fit.free) if _is_shared(items[j])]
    whole = _searched(calibration, held, held)
    with open_simulator(whole.problem()) as simulator:
        at = whole.parameters.to_search(np.concatenate([fit.values, [p.start for p in held]]))
        run = Objective(whole, simulator).evaluate(at, [*fit.free, *range(count, count + len(held))])
    if run is None or run.slopes is None:
        return []
    sd = [fit.noise[s.output].sd for s in fit.series]
    residual = np.concatenate([r / size for r, size in zip(run.residual, sd, strict=True)])
    slopes = np.concatenate([rows / size for rows, size in zip(run.slopes, sd, strict=True)], axis=1)
    whose = [_run(calibration.data.recordings[s.experiment]) for s in fit.series]
    runs = np.repeat([sorted(set(whose)).index(one) for one in whose], [s.sampling.size for s in fit.series])

    def left(extra: FloatArray) -> float:
        design = np.vstack([slopes[: len(fit.free)], extra])
        rest = residual - np.linalg.lstsq(design.T, residual, rcond=1e-8)[0] @ design
        return float(rest @ rest)

    columns = {OtherValues((p,), True, False): len(fit.free) + k for k, p in enumerate(held)}
    tried = [(left(slopes[k : k + 1]), one) for one, k in columns.items()]
    given = [k for one, k in columns.items() if one.parameters[0].name in calibration.simulated.fixed]
    if len(given) > 1:
        tried.append((left(slopes[given]), OtherValues(tuple(held[k - len(fit.free)] for k in given), True, False)))
    own = []
    if len(set(whose)) > 1:
        splits = {replace(one, by_recording=True): k for one, k in columns.items()}
        splits |= {OtherValues((items[fit.free[k]],), False, True): k for k in shared}
        own = [(left((runs == np.unique(runs)[:, None]) * slopes[k]), one) for one, k in splits.items()]
    return [one for kind in (tried, own) for _, one in sorted(kind, key=lambda pair: pair[0])[:MAX_TRIED]]


def _run(recording: Recording) -> str:
    """Return the name of a recording, or of the one that it is a part of."""
    return recording.part_of or recording.name


def _is_shared(p: Parameter) -> bool:
    return p.recording is None and isinstance(p.target, ParameterTarget)


def _held(calibration: Calibration) -> list[Parameter]:
    """Return parameters of the model that are held at a value, those first that the user gave one."""
    fixed, model = calibration.simulated.fixed, calibration.model
    searched = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    found: list[Parameter] = []
    for name in dict.fromkeys([*fixed, *(v.name for v in model.parameters)]):
        value = fixed.get(name, model.parameter(name).start)
        if name not in searched and value and len(found) < MOST_HELD:
            with suppress(InputError):
                (one,) = parameters_from_model(model, [name])
                found += [replace(one, start=value)] if one.lower <= value <= one.upper else []
    return found
