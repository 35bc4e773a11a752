"""What columns a recording has: names, roles, units, and what sizes are believable."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.declared import Declaration, Quantity
from aero_bayes.errors import InputError

TURN = 2.0 * math.pi

#: Factor from a unit to the SI unit that recordings use.
TO_SI: Mapping[str, tuple[float, str]] = {
    "s": (1.0, "s"),
    "ms": (1e-3, "s"),
    "us": (1e-6, "s"),
    "V": (1.0, "V"),
    "mV": (1e-3, "V"),
    "A": (1.0, "A"),
    "mA": (1e-3, "A"),
    "rad": (1.0, "rad"),
    "mrad": (1e-3, "rad"),
    "deg": (TURN / 360.0, "rad"),
    "rev": (TURN, "rad"),
    "rad/s": (1.0, "rad/s"),
    "deg/s": (TURN / 360.0, "rad/s"),
    "rev/s": (TURN, "rad/s"),
    "rpm": (TURN / 60.0, "rad/s"),
}


@dataclass(frozen=True)
class ColumnMap:
    """Where a column of the contract is found in a file, and how it becomes SI.

    The value is ``(raw + offset) * scale`` in ``unit``, then converted to SI.

    Parameters
    ----------
    source : str
        Name of the file's column or variable. In a MATLAB file ``log(2)`` is the second row (or column) of the matrix
        ``log``, ``run.signals(1)`` the first signal of a structure with time.
    unit : str, optional
        Unit in the file: one of s, ms, us, V, mV, A, mA, rad, mrad, deg, rev, rad/s, deg/s, rev/s, rpm, or ``count``
        (with ``counts_per_revolution``). Left out, the file is in SI.
    scale, offset : float
        For anything else.
    counts_per_revolution : float, optional
        Of the encoder, for ``count`` and ``count/s``.
    """

    source: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    counts_per_revolution: float | None = None

    def factor(self, column: str, expected: str) -> float:
        """Total factor to the SI unit ``expected``. Raises InputError for a unit of another kind."""
        if self.unit is None:
            return self.scale
        if self.unit in ("count", "count/s"):
            if not self.counts_per_revolution or self.counts_per_revolution <= 0.0:
                raise InputError(f"column {column}: unit {self.unit} needs counts_per_revolution, e.g. 2048")
            factor, si = TURN / self.counts_per_revolution, "rad" + self.unit[5:]
        elif self.unit in TO_SI:
            factor, si = TO_SI[self.unit]
        else:
            known = ", ".join([*TO_SI, "count", "count/s"])
            raise InputError(f"column {column}: unknown unit {self.unit!r}, expected one of {known}")
        if expected and si != expected:
            raise InputError(f"column {column}: unit {self.unit} cannot become {expected}")
        return factor * self.scale


@dataclass(frozen=True)
class Layout:
    """The columns that a recording of one kind of rig has.

    Parameters
    ----------
    inputs : tuple of Quantity
        All must be in the file.
    outputs : tuple of Quantity
        Any of them may be; at least one must.
    rates : (float, float)
        Believable sample rates in Hz.

    Examples
    --------
    >>> Layout.of(["F"], ["position"], {"F": "N", "position": "m"}).units
    {'time': 's', 'F': 'N', 'position': 'm'}
    """

    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    rates: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def of(cls, inputs: Sequence[str], outputs: Sequence[str], units: Mapping[str, str] | None = None) -> Layout:
        """A layout of names and units, without bounds on sizes."""
        known = units or {}
        return cls(
            tuple(Quantity(name, known.get(name, "")) for name in inputs),
            tuple(Quantity(name, known.get(name, "")) for name in outputs),
        )

    @classmethod
    def declared(cls, declaration: Declaration) -> Layout:
        """The columns that a package declares for its rigs."""
        known = declaration.recording
        return cls(tuple(known.inputs.values()), tuple(known.outputs.values()), known.rates)

    @property
    def units(self) -> dict[str, str]:
        """SI unit of every column, time included."""
        return {"time": "s"} | {quantity.name: quantity.unit for quantity in (*self.inputs, *self.outputs)}
