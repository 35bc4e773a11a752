"""Columns of a file: names, roles, units and gaps; parts of one run, angles that wrap, and counters."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arguments import Positive
from aero_bayes.arrays import FloatArray
from aero_bayes.declared import ColumnSpec, PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.modelica.units import base_units, conversion, is_unit, to_modelica_unit, unit_written_out

if TYPE_CHECKING:
    from aero_bayes.simulation.model import Model

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]
#: Where in its interval the time of a mean stands.
Stamp = Literal["beginning", "end"]

#: A median absolute deviation times this is the standard deviation of a normal distribution.
MAD_TO_SD = 1.4826
#: Share of samples with a change above which an input moves all the time, and what is then a large step of it, in
#: typical ones.
MAX_CHANGE_SHARE, LARGE_STEP = 0.2, 6.0


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Find the first and one past the last row of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def typical_step(values: FloatArray) -> float:
    """Compute a typical change from one reading to the next: a robust one or, if that is zero, the mean."""
    steps = np.abs(np.diff(values))
    if steps.size == 0:
        return 0.0
    robust = MAD_TO_SD * float(np.median(steps))
    return robust if robust > 0.0 else float(np.mean(steps))


def noise_size(values: FloatArray) -> float:
    """Estimate robustly what changes between readings, straight lines left out: noise, or little for a signal."""
    if values.size < 3:
        return 0.0
    return MAD_TO_SD * float(np.median(np.abs(np.diff(values, 2)))) / math.sqrt(6.0)


def after_changes(inputs: Mapping[str, FloatArray], reach: int = 2) -> Mask:
    """Mark rows from one before to ``reach`` rows after a change of an input."""
    size = len(next(iter(inputs.values()))) if inputs else 0
    near = np.zeros(size, dtype=bool)
    for values in inputs.values():
        steps = np.abs(np.diff(values))
        # Of an input that moves all the time, only its large steps are changes.
        often = np.count_nonzero(steps) > MAX_CHANGE_SHARE * size
        changes = np.flatnonzero(steps > (LARGE_STEP * typical_step(values) if often else 0.0)) + 1
        for offset in range(-1, reach + 1):
            near[np.clip(changes + offset, 0, size - 1)] = True
    return near


#: Length of a gap in usual intervals. An input that holds over fewer is hardly wrong for long.
MIN_GAP_INTERVALS = 10.0
#: A sampling is even where this share of its intervals is within a factor of two of the usual one.
EVEN_SHARE = 0.95
#: Fewest samples of a part, and most parts: each has its own initial state.
MIN_PART_ROWS, MAX_PARTS = 20, 10


def gap_rows(time: FloatArray, inputs: Mapping[str, FloatArray]) -> Rows:
    """Find the first rows after a gap, of the longest gaps if there are many.

    A logger that writes changes only has long intervals by right, and inputs that were constant for as long before and
    after a gap were most likely constant in it: neither counts."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    if usual <= 0.0 or np.mean((steps > 0.5 * usual) & (steps < 2.0 * usual)) < EVEN_SHARE:
        return np.empty(0, dtype=np.intp)
    rows = np.flatnonzero(steps >= MIN_GAP_INTERVALS * usual) + 1
    rows = np.array([r for r in rows if not _held(time, inputs, int(r))], dtype=np.intp)
    longest = rows[np.argsort(-steps[rows - 1], kind="stable")][: MAX_PARTS - 1]
    return np.sort(longest)


def _held(time: FloatArray, inputs: Mapping[str, FloatArray], row: int) -> bool:
    """Return whether every input was the same for the length of a gap before it and after it."""
    length = time[row] - time[row - 1]
    beside = (time >= time[row - 1] - length) & (time <= time[row] + length)
    return all(np.ptp(values[beside]) == 0.0 for values in inputs.values())


#: A whole turn by unit of an angle.
TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "rev": 1.0}
#: A step of more than this share of a turn is a jump; all others must be shorter than the second share.
MIN_JUMP, MAX_STEP = 0.6, 0.4
#: Largest range of an angle that is counted modulo a turn, in turns.
MAX_RANGE = 1.05


def wrapped_rows(values: FloatArray, unit: str) -> Rows:
    """Find rows at which an angle jumps by a whole turn; none for another quantity or an angle that does not wrap."""
    turn = TURNS.get(unit)
    at = np.flatnonzero(np.isfinite(values))
    if turn is None or at.size < 3 or np.ptp(values[at]) > MAX_RANGE * turn:
        return np.empty(0, dtype=np.intp)
    steps = np.abs(np.diff(values[at]))
    jumps = steps > MIN_JUMP * turn
    if not jumps.any() or np.quantile(steps[~jumps], 0.99, method="higher") > MAX_STEP * turn:
        return np.empty(0, dtype=np.intp)
    # A single outlier jumps there and back; a turn is not taken back at the next reading.
    return np.asarray(at[1:][jumps], dtype=np.intp)


def unwrapped(values: FloatArray, period: float) -> FloatArray:
    """Return an angle or a counter without its jumps of a whole period, gaps left out."""
    found = values.copy()
    seen = np.isfinite(values)
    found[seen] = np.unwrap(values[seen], period=period)
    return found


#: What a counter reads after a reset, over its usual rise, from which it had been reset right after the reading before.
MIN_COUNTED = 0.75


def without_resets(values: FloatArray) -> FloatArray:
    """Return a counter that goes on where it was reset, gaps left out: from what it had counted.

    Where it counts little until the next reading it was reset just before that: it rose as it does around it."""
    found, there = values.copy(), np.isfinite(values)
    seen = values[there]
    rises = np.diff(seen)
    rows = np.flatnonzero(rises < -0.5 * np.abs(seen[:-1]))
    if rows.size in (0, rises.size):
        return found
    usual = np.interp(np.arange(rises.size), np.flatnonzero(rises >= 0.0), rises[rises >= 0.0])[rows]
    lost = np.median(seen[rows + 1]) < MIN_COUNTED * np.median(usual)
    rises[rows] = usual if lost else seen[rows + 1]
    found[there] = seen[0] + np.concatenate(([0.0], np.cumsum(rises)))
    return found


#: Values at which counters roll over.
MODULI = (*(2.0**n for n in (8, 10, 12, 14, 15, 16, 20, 24, 31, 32)), *(10.0**n for n in range(2, 10)))
#: Fewest rises, and falls over rises at most, that show a counter; what it falls by, in largest rises.
MIN_RISES, MAX_FALLS, MIN_FALL = 20, 0.1, 4.0
#: A counter comes as close to its end, and begins as low again, as this many of its largest rises.
CLOSE = 1.5


def counter_falls(values: FloatArray) -> tuple[Mask, float | None] | None:
    """Return where a counter falls, and the value at which it rolls over, None for one that is reset.

    None where the values do not only rise but for falls to about zero."""
    there = np.flatnonzero(np.isfinite(values))
    seen = values[there]
    steps = np.diff(seen)
    rises, down = steps[steps > 0.0], np.flatnonzero(steps < 0.0)
    if rises.size < MIN_RISES or not 0 < down.size <= MAX_FALLS * rises.size or seen.min() < 0.0:
        return None
    close = CLOSE * float(rises.max())
    before, after = seen[down], seen[down + 1]
    if after.max() > close or np.min(before - after) < MIN_FALL * close / CLOSE:
        return None
    rows = np.isin(np.arange(values.size), there[down + 1])
    known = [m for m in MODULI if before.max() < m <= before.min() + close]
    # At an end of its own a counter falls by the same amount each time, but for one rise.
    own = float(np.round(np.median(before - after + rises.mean()), 6)) if down.size > 1 else None
    return rows, known[0] if known else own if np.ptp(before) <= close else None


@dataclass(frozen=True)
class ColumnMap:
    """Where a signal is found in a file, and how it is converted to SI units.

    Parameters
    ----------
    source : str
        What the file calls it.
    unit : str, optional
        Its unit there, from which it is converted to that of the model.
    scale, offset : float
        The value in ``unit`` is ``(raw + offset) * scale``.
    counts_per_revolution : float, optional
        Of an encoder, whose unit is ``count`` or ``count/s``.
    unwrap : bool or float
        Whether an angle that jumps by a whole turn goes on; a number: the raw value at which a counter rolls over.
    reset : bool
        Whether a counter that is reset goes on.
    missing : tuple of float, optional
        Raw values that stand for none; where it is not given, a constant before the first message is found by itself.
    kind : {"instant", "mean"}
        Whether a reading is the value at its time, or the mean over an interval.
    stamp : {"beginning", "end"}
        Where in its interval the time of a mean stands.

    Examples
    --------
    >>> aero_bayes.ColumnMap("x", unit="mm").convert(np.array([3.0]), "position", "m").tolist()
    [0.003]
    """

    source: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    counts_per_revolution: Positive | None = None
    unwrap: bool | Positive = False
    reset: bool = False
    missing: tuple[float, ...] | None = None
    kind: Literal["instant", "mean"] = "instant"
    stamp: Stamp = "end"

    def convert(self, values: FloatArray, column: str, expected: str) -> FloatArray:
        """Convert raw values of a ``column`` to the unit ``expected``, or to SI if empty.

        Raises InputError for another dimension."""
        values = without_resets(values) if self.reset else values
        values = unwrapped(values, self.unwrap) if self.unwrap and self.unwrap is not True else values
        values = (values + self.offset) * self.scale
        if self.unit is not None:
            factor, offset = self._to_unit(self.unit, column, expected)
            values = values * factor + offset
        return unwrapped(values, TURNS.get(expected, TURNS["rad"])) if self.unwrap is True else values

    def _to_unit(self, unit: str, column: str, expected: str) -> tuple[float, float]:
        """Return factor and offset of the conversion from a unit."""
        turns = 1.0
        if unit in ("count", "count/s"):
            if not self.counts_per_revolution or self.counts_per_revolution <= 0.0:
                raise InputError(f"column {column}: unit {unit} needs counts_per_revolution, e.g. 2048")
            unit, turns = "rev" + unit[5:], 1.0 / self.counts_per_revolution
        known = base_units(to_modelica_unit(unit))
        found = conversion(unit, expected) if expected or known is None else (known[0], 0.0)
        if found is None:
            if not is_unit(to_modelica_unit(unit)):
                meant = unit_written_out(unit)
                hint = f"; did you mean {meant}?" if meant else f", expected one like {expected or 'rad/s'}"
                raise InputError(f"column {column}: unknown unit {unit!r}{hint}")
            raise InputError(f"column {column}: unit {self.unit} cannot become {expected or 'SI'}")
        return turns * found[0], found[1]


@dataclass(frozen=True)
class Layout:
    """The columns that a recording of one kind of rig has.

    Parameters
    ----------
    inputs : tuple of ColumnSpec
        All must be in the file.
    outputs : tuple of ColumnSpec
        Any of them may be; at least one must.
    rates : (float, float)
        Plausible sample rates in Hz.
    constants : mapping of str to float
        Inputs without a column, and their constant values in SI units.
    maps : mapping of str to ColumnMap
        Where a column is found if not under its own name and in the model's unit.

    Examples
    --------
    >>> layout = Layout.of(["F"], ["position"], {"F": "N", "position": "m"})
    >>> layout.units
    {'time': 's', 'F': 'N', 'position': 'm'}
    >>> layout.held, layout.measured, layout.called["F"]
    (['F'], ['position'], 'F')
    """

    inputs: tuple[ColumnSpec, ...]
    outputs: tuple[ColumnSpec, ...]
    rates: tuple[float, float] = (0.0, math.inf)
    constants: Mapping[str, float] = field(default_factory=dict)
    maps: Mapping[str, ColumnMap] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for column in self.maps:
            if column not in self.units:
                known = ", ".join(self.units)
                raise InputError(f"columns: {column} is not a column of the model, expected one of {known}")

    @classmethod
    def of(
        cls,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        *,
        model: Model | None = None,
        declared: PackageDeclaration | None = None,
        constants: Mapping[str, float] | None = None,
    ) -> Layout:
        """Return a layout of names and units.

        Parameters
        ----------
        inputs, outputs : sequence of str, optional
            Names; by default those that the model's package declares, else the model's own.
        units : mapping of str to str, optional
            SI units by name; by default the model's.
        model : Model, optional
        declared : PackageDeclaration, optional
            By default that of the model.
        constants : mapping of str to float, optional
            Inputs without a column, and their constant values in SI units.

        Returns
        -------
        Layout
        """
        recording = (declared or (model.declared if model is not None else PackageDeclaration())).recording
        roles = (recording.inputs, model.inputs if model else ()), (recording.outputs, model.outputs if model else ())
        variables = {v.name: v for _, own in roles for v in own}
        known = {name: v.unit for name, v in variables.items()} | dict(units or {})

        def column(name: str) -> ColumnSpec:
            if (declared := {**recording.inputs, **recording.outputs}.get(name)) is not None:
                return declared
            variable = variables.get(name)
            kind = variable.kind if variable is not None else "real"
            words = dict(variable.items) if variable is not None and variable.items else {}
            if kind == "boolean":
                words = words or {"false": 0.0, "true": 1.0, "off": 0.0, "on": 1.0}
            return ColumnSpec(name, known.get(name, ""), words=words, whole=kind != "real")

        def columns(names: Sequence[str] | None, role: int) -> tuple[ColumnSpec, ...]:
            usual = list(roles[role][0]) or [v.name for v in roles[role][1]]
            chosen = [name for name in usual if name not in (constants or {})] if names is None else names
            return tuple(map(column, chosen))

        return cls(columns(inputs, 0), columns(outputs, 1), recording.rates, dict(constants or {}))

    @property
    def units(self) -> dict[str, str]:
        """SI unit of every column, time included."""
        return {"time": "s"} | {quantity.name: quantity.unit for quantity in (*self.inputs, *self.outputs)}

    @property
    def held(self) -> list[str]:
        """Names of inputs."""
        return [quantity.name for quantity in self.inputs]

    @property
    def measured(self) -> list[str]:
        """Names of outputs."""
        return [quantity.name for quantity in self.outputs]

    @property
    def words(self) -> dict[str, Mapping[str, float]]:
        """Words for values of each signal."""
        return {quantity.name: quantity.words for quantity in (*self.inputs, *self.outputs)}

    @property
    def called(self) -> dict[str, str]:
        """What a file calls each column."""
        return {name: self.maps[name].source if name in self.maps else name for name in self.units}


def split_unit(column: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit: ``U [mV]``, ``phi (deg)``, ``time/s``, ``t_ms``.

    HOBO's ``P, W (LGR S/N: 100)`` is P in W, and ``Date Time, GMT+01:00`` has no unit."""
    if (hobo := re.fullmatch(r"([^,]*), ([^(,]*?)( \(.*\))?", column)) is not None:
        unit = to_modelica_unit(hobo[2])
        if hobo[2].startswith(("GMT", "UTC")) or is_unit(unit):
            return hobo[1], "" if hobo[2].startswith(("GMT", "UTC")) else unit
    if (brackets := re.fullmatch(r"(.*?)[\s_]*[\[(](.*)[\])]\s*", column)) is not None:
        return brackets[1], to_modelica_unit(brackets[2])
    for mark in ("/", "_", " "):
        name, _, unit = column.partition(mark) if mark == "/" else column.rpartition(mark)
        plain = to_modelica_unit(unit)
        if name and is_unit(plain) and plain != "1":
            return name, plain
    return column, ""
