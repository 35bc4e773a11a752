"""A constant at a reading or an input (a gauge for absolute pressure, an encoder's zero) that explains a residual.

To first order about the fit, the constant and all parameters are free. Where that promises half of the residual, the
model is fitted to the data with it, and the constant is improved from there: the parameters have taken up part of it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.other_reading import (
    Reading,
    Refits,
    after_step,
    change_of,
    changed_outputs,
    converted,
    explains_all,
    fitted_rows,
    with_finding,
)
from aero_bayes.estimate.result import Fit

#: Share of a residual's squares that may be left to first order for a refit to try the constant: half of the residual.
MOST_LEFT = 0.25
#: Refits that improve a constant, and the change, in its standard deviations, from which on it is not improved.
MAX_REFITS, SETTLED = 4, 1.0
#: Most channels that are tried, and how much more a constant at one may leave to be as good as that at another.
MAX_TRIED, ALIKE = 3, 1.02
#: Share of a constant's effect that the parameters must leave: else it cannot be told from them.
MIN_SEEN = 1e-3
#: Step of an input, as a share of its range or size, with which its effect is found.
INPUT_STEP = 1e-3


@dataclass(frozen=True)
class _Constant:
    """A value that is to be added to a channel, its standard deviation, and the share of the squares it leaves."""

    value: float
    sd: float
    left: float


def without_constant(fit: Fit, refits: Refits) -> Fit | None:
    """Return the fit with the finding of a constant that explains what it leaves; None where none does."""
    data, units = fit.calibration.data, fit.calibration.model.units
    channels = [*data.outputs, *dict.fromkeys(s.name for e in data.experiments for s in e.inputs)]
    found = [(constant, name) for name in channels if (constant := _constant(fit, name, refits.open)) is not None]
    promising = [pair for pair in sorted(found, key=lambda pair: pair[0].left) if pair[0].left <= MOST_LEFT]
    explaining: dict[str, tuple[float, Fit]] = {}
    for constant, channel in promising[:MAX_TRIED]:
        with suppress(InputError, CannotFinishError):
            value, again = constant.value, fit
            for _ in range(MAX_REFITS):
                again = refits.fitted(refits.calibrated([converted(channel, 1.0, value, r) for r in data.recordings]))
                more = _constant(again, channel, refits.open)
                if more is None or abs(more.value) < SETTLED * more.sd:
                    break
                value += more.value
            if explains_all(fit, again):
                explaining[channel] = value, again
    if not explaining:
        return None
    worse = {channel: sum(a for _, a in change_of(fit, again).values()) for channel, (_, again) in explaining.items()}
    # A constant at one channel may do just what one at another does: then readings come first, and all are told.
    alike = [c for c in channels if c in worse and worse[c] <= ALIKE * min(worse.values())]
    texts = {c: with_unit(f"{explaining[c][0]:.5g}", units.get(c, "")) for c in alike}
    first, others = alike[0], [f"{texts[c]} added to {c}" for c in alike[1:]]
    done = f"Add it by [data.columns.{first}] offset, which counts in the unit of the file."
    done += f" As good: {join_names(others)}." if others else ""
    what = f"{first} looks off by a constant: with {texts[first]} added to it"
    return with_finding(fit, Reading("offset", first, what, done), explaining[first][1])


def _constant(fit: Fit, channel: str, open_simulator: OpenSimulator) -> _Constant | None:
    """Return the constant that leaves least of the squares to first order, the parameters free.

    None where they do all that it does."""
    effect = _effect(fit, channel, open_simulator)
    if effect is None:
        return None
    residual, slopes = fitted_rows(fit)
    alone = after_step(slopes, effect)
    size = float(alone @ alone)
    if size <= MIN_SEEN**2 * float(effect @ effect):
        return None
    value = float(alone @ residual) / size
    rest = after_step(slopes, residual) - value * alone
    return _Constant(value, size**-0.5, float(rest @ rest) / max(float(residual @ residual), 1e-300))


def _effect(fit: Fit, channel: str, open_simulator: OpenSimulator) -> FloatArray | None:
    """Return by how much each residual rises with a constant that is added to a channel, in deviations of the noise."""
    data, sds = fit.calibration.data, [fit.noise[s.output].sd for s in fit.series]
    if channel in data.outputs:
        parts = [np.full(s.sampling.size, (s.output == channel) / sd) for s, sd in zip(fit.series, sds, strict=True)]
        return -np.concatenate(parts)
    values = np.concatenate([s.values for e in data.experiments for s in e.inputs if s.name == channel])
    step = INPUT_STEP * (float(np.ptp(values)) or float(np.max(np.abs(values))) or 1.0)
    changes = changed_outputs(fit, channel, lambda v: v + step, open_simulator)
    return None if changes is None else np.concatenate([c / (step * sd) for c, sd in zip(changes, sds, strict=True)])
