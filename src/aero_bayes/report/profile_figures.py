"""Profile likelihoods: decrease of the log-posterior with one parameter fixed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.report.drawing import Dots, Layer, Line, Panel, Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_estimate import ProfileJson
from aero_bayes.report.svg import ACCENT, INK, MEASURED
from aero_bayes.report.text import NO_VALUE, greek_name, rounded_value, symbol

#: How far up a profile is drawn; the threshold of a 90 % interval is at 1.35.
_TOP = 5.0


def profile_plates(run: RunDirectory) -> list[Plate]:
    """Return a small figure for every profile of the run."""
    found = run.result.identifiability
    plates = [_plate(name, entry, found.profile_drop_90) for name, entry in found.profiles.items()]
    return [drawn for drawn in plates if drawn is not None]


def _plate(name: str, entry: ProfileJson, level: float | None) -> Plate | None:
    values, drop, prior = _floats(entry.values), _floats(entry.drop), _floats(entry.prior_drop)
    if len(values) != len(drop) or np.isfinite(drop).sum() < 3:
        return None
    near = np.flatnonzero(np.nan_to_num(drop, nan=np.inf) < _TOP)
    view = slice(max(int(near.min()) - 1, 0), int(near.max()) + 2)
    values, drop, prior = values[view], drop[view], prior[view]
    low, high = float(values.min()), float(values.max())
    shown = rounded_value(float(values[int(np.nanargmin(drop))]), low, high, entry.unit, digits=2)
    power = _power(values)
    fine = np.isfinite(drop)
    layers: list[Layer] = []
    if len(prior) == len(values):
        layers.append(Line(values / power, prior, MEASURED, 1.4, label="prior alone"))
    layers += [
        Line(values[fine] / power, drop[fine], ACCENT, 1.6, label="decrease of the log-posterior"),
        Dots(values[fine] / power, drop[fine], INK, 3.0, 0.8),
    ]
    title = f"{greek_name(name)} ({shown.unit})" if shown.unit else greek_name(name)
    panel = Panel(
        title, tuple(layers), 110, y_limits=(-0.15, _TOP), x_limits=(low / power, high / power),
        levels=() if level is None else (level,), ticks=3,
    )  # fmt: skip
    words = _interval_words(entry)
    alt = f"Profile of {name}: {words}."
    return plate([panel], alt, "fixed value", Markup("{}: {}.").format(symbol(name), words), width=300)


def _interval_words(entry: ProfileJson) -> str:
    """Return the interval at the threshold; a side on which the profile stays below it has no end."""
    first, last = [*entry.interval, None, None][:2]
    unit = entry.unit
    if first is None and last is None:
        return "flat over the whole range, no 90 % interval"
    shown = rounded_value(first if first is not None else last, first, last, unit, digits=3)
    if first is None or last is None:
        side, end = ("above", shown.value) if last is None else ("below", shown.value)
        return f"90 % {side} {end} {shown.unit}, open on the other side".replace("  ", " ")
    return f"90 % between {shown.low} and {shown.high} {shown.unit}".rstrip() if shown.low != NO_VALUE else ""


def _floats(given: Sequence[float | None]) -> FloatArray:
    return np.array([np.nan if x is None else x for x in given], dtype=np.float64)


def _power(values: FloatArray) -> float:
    largest = float(np.max(np.abs(values)))
    return 1.0 if largest == 0 or 1e-3 <= largest < 1e5 else 10.0 ** (3 * np.floor(np.log10(largest) / 3))
