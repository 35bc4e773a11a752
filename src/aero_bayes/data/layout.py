"""The columns of a recording: names, roles, units, and plausible magnitudes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.arrays import FloatArray
from aero_bayes.data.wrapped import unwrapped
from aero_bayes.declared import ColumnSpec, PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.language.units import TEMPERATURES, base_units, conversion, to_modelica_unit


@dataclass(frozen=True)
class ColumnMap:
    """Where a signal is found in a file, and how it is converted to SI units.

    The value in ``unit`` is ``(raw + offset) * scale``. It is then converted to the unit of the model."""

    source: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    counts_per_revolution: float | None = None
    unwrap: bool = False

    def convert(self, values: FloatArray, column: str, expected: str) -> FloatArray:
        """Convert raw values to the unit ``expected``, or to SI if empty. InputError for another dimension."""
        converted = self._converted(values, column, expected)
        return unwrapped(converted, expected) if self.unwrap else converted

    def _converted(self, values: FloatArray, column: str, expected: str) -> FloatArray:
        values = (values + self.offset) * self.scale
        if self.unit is None:
            return values
        unit, turns = self.unit, 1.0
        if unit in ("count", "count/s"):
            if not self.counts_per_revolution or self.counts_per_revolution <= 0.0:
                raise InputError(f"column {column}: unit {unit} needs counts_per_revolution, e.g. 2048")
            unit, turns = "rev" + unit[5:], 1.0 / self.counts_per_revolution
        known = base_units(to_modelica_unit(unit))
        found = conversion(unit, expected) if expected or known is None else (known[0], 0.0)
        if found is None:
            if known is None and to_modelica_unit(unit) not in TEMPERATURES:
                raise InputError(f"column {column}: unknown unit {unit!r}, expected one like {expected or 'rad/s'}")
            raise InputError(f"column {column}: unit {self.unit} cannot become {expected or 'SI'}")
        return values * (turns * found[0]) + found[1]


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

    Examples
    --------
    >>> Layout.of(["F"], ["position"], {"F": "N", "position": "m"}).units
    {'time': 's', 'F': 'N', 'position': 'm'}
    """

    inputs: tuple[ColumnSpec, ...]
    outputs: tuple[ColumnSpec, ...]
    rates: tuple[float, float] = (0.0, math.inf)
    constants: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, inputs: Sequence[str], outputs: Sequence[str], units: Mapping[str, str] | None = None) -> Layout:
        """Return a layout of names and units, without bounds on magnitudes.

        Parameters
        ----------
        inputs, outputs : sequence of str
            Names.
        units : mapping of str to str, optional
            By name.

        Returns
        -------
        Layout
        """
        known = units or {}
        return cls(
            tuple(ColumnSpec(name, known.get(name, "")) for name in inputs),
            tuple(ColumnSpec(name, known.get(name, "")) for name in outputs),
        )

    @classmethod
    def declared(cls, declaration: PackageDeclaration) -> Layout:
        """Return the columns that a package declares for its rigs."""
        known = declaration.recording
        return cls(tuple(known.inputs.values()), tuple(known.outputs.values()), known.rates)

    @property
    def units(self) -> dict[str, str]:
        """SI unit of every column, time included."""
        return {"time": "s"} | {quantity.name: quantity.unit for quantity in (*self.inputs, *self.outputs)}
