"""A rig put together: its equations, its laws, its actuators and sensors; and what it then does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulated_rigs.integrate import RigIntegrator
from simulated_rigs.plant import HybridTerm, Plant, SmoothTerm, Values
from simulated_rigs.signals import PiecewiseSignal, held_command

FloatArray = NDArray[np.float64]
Family = Literal["motion", "storage", "electrical", "rate"]
Actuator = Callable[[FloatArray, FloatArray], PiecewiseSignal]


@dataclass(frozen=True)
class Balance:
    """A state as laws see it.

    Parameters
    ----------
    family : {"motion", "storage", "electrical", "rate"}
        What is balanced: forces, flows (of a liquid or heat), voltages; a rate only follows another state.
    position : str, optional
        The state whose derivative this one is.
    reference : float
        Level at which losses vanish: zero, or the temperature of the surroundings.
    neighbour : str, optional
        The storage that takes what spills, or exchanges with this one.
    """

    family: Family
    position: str | None = None
    reference: float = 0.0
    neighbour: str | None = None


@dataclass(frozen=True)
class Coupling:
    """The elastic element whose stretch is a state: its force on ``first`` (and against it on ``second``)."""

    first: str
    second: str
    stiffness: str
    damping: str | None = None


@dataclass
class Assembly:
    """Equations of one rig, to which laws add themselves.

    Parameters
    ----------
    plant : Plant
    inputs, states, outputs : tuple of str
    balances : mapping of str to Balance
        Per state.
    parameters : mapping of str to float
    couplings : mapping of str to Coupling
        Per state that is a stretch.
    terms, holds : list of HybridTerm
        Laws that add to balances, and those that hold a state; these come after all others.
    actuators : dict
        What an input makes of its command; by default it holds it.
    lags, delays : dict
        Per output its time constant or delay in s.
    readings : list of callable
        What else sensors do to the outputs, in place: (time, outputs, all states).
    extra : list of int or None
        For each state that laws bring the state whose initial value it shares; None starts at zero.
    longest : float
        Longest integration step in s that the laws allow.
    """

    plant: Plant
    inputs: tuple[str, ...]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    balances: Mapping[str, Balance]
    parameters: Mapping[str, float]
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    terms: list[HybridTerm] = field(default_factory=list)
    holds: list[HybridTerm] = field(default_factory=list)
    actuators: dict[str, Actuator] = field(default_factory=dict)
    readings: list[Callable[[FloatArray, FloatArray, FloatArray], object]] = field(default_factory=list)
    lags: dict[str, float] = field(default_factory=dict)
    delays: dict[str, float] = field(default_factory=dict)
    extra: list[int | None] = field(default_factory=list)
    longest: float = inf

    def state(self, name: str) -> int:
        """Return the index of a state."""
        return self.states.index(name)

    def add_state(self, like: int | None = None) -> int:
        """Add a state that starts at zero, or where the state ``like`` starts, and return its index."""
        self.extra.append(like)
        return len(self.states) + len(self.extra) - 1

    def term(self, add: Callable[[float, Values, Values, list[float]], None]) -> None:
        """Add a smooth term."""
        self.terms.append(SmoothTerm(add))

    def run(
        self, time: FloatArray, commands: FloatArray, start: Sequence[float], longest: float
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate outputs, shape (n, outputs), and the rig's own states, shape (n, states), at ``time`` s.

        ``commands`` has shape (n, inputs); each value holds to the next sample. No step is longer than ``longest`` s.
        """
        signals = [self.actuators.get(name, held_command)(time, commands[:, k]) for k, name in enumerate(self.inputs)]
        late = {name: np.maximum(time - delay, time[0]) for name, delay in self.delays.items()}
        grid = _union([time, *late.values(), *(signal.breaks for signal in signals)], time[0], time[-1])
        begin = [*start, *(0.0 if like is None else start[like] for like in self.extra)]
        laws = [*self.terms, *self.holds]
        integrator = RigIntegrator(self.plant, laws, len(self.extra), signals, min(longest, self.longest))
        slopes = np.empty((grid.size - 1, 2, len(begin))) if self.lags else None
        found = integrator.run(grid, begin, slopes)
        apart = 1e-9 * (time[1] - time[0])
        at = np.searchsorted(grid, time - apart)
        outputs = found[np.ix_(at, self.plant.shown)]
        for name, times in late.items():
            column = self.outputs.index(name)
            outputs[:, column] = found[np.searchsorted(grid, times - apart), self.plant.shown[column]]
        for name, constant in self.lags.items():
            assert slopes is not None
            column = self.outputs.index(name)
            of = self.plant.shown[column]
            outputs[:, column] = _lagged(grid, found[:, of], slopes[:, :, of], constant)[at]
        for reading in self.readings:
            reading(time, outputs, found[at])
        return outputs, found[at, : len(self.states)]


def _lagged(grid: FloatArray, values: FloatArray, slopes: FloatArray, constant: float) -> FloatArray:
    """Return a first-order lag of a signal with known slopes, shape (n,), settled at the first value.

    Exact for the cubic p through values and slopes of an interval, to which the lag T answers by the polynomial
    p - T Dp + T^2 DDp - T^3 DDDp and a decaying exponential.
    """
    h, jump = np.diff(grid), np.diff(values)
    first, last = slopes[:, 0], slopes[:, 1]
    # Of p(s) = v + first s + c2 s^2 + c3 s^3:
    c3 = (first + last - 2.0 * jump / h) / h**2
    c2 = (jump / h - first) / h - c3 * h
    begin = values[:-1] - constant * (first - constant * (2.0 * c2 - constant * 6.0 * c3))
    end = values[1:] - constant * (last - constant * (2.0 * c2 + 6.0 * c3 * h - constant * 6.0 * c3))
    keep = np.exp(-h / constant)
    shown = float(values[0])
    out = [shown]
    for a, b, factor in zip(begin.tolist(), end.tolist(), keep.tolist(), strict=True):
        shown = b + (shown - a) * factor
        out.append(shown)
    return np.array(out)


def _union(parts: Sequence[FloatArray], first: float, last: float) -> FloatArray:
    """Join the times of all parts within [first, last], sorted, those that differ by rounding only taken as one."""
    grid = np.sort(np.concatenate(parts))
    grid = grid[(grid >= first) & (grid <= last)]
    apart = 1e-9 * float(np.median(np.diff(parts[0])))
    distinct: FloatArray = grid[np.concatenate(([True], np.diff(grid) > apart))]
    return distinct
