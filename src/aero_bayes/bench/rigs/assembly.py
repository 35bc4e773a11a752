"""A rig put together: its equations, its laws, its actuators and sensors; and what it then does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.bench.rigs.integrate import Integrator
from aero_bayes.bench.rigs.plant import Law, Plant, Term, Values
from aero_bayes.bench.rigs.signals import Signal, hold

FloatArray = NDArray[np.float64]
Family = Literal["motion", "storage", "electrical", "rate"]
Actuator = Callable[[FloatArray, FloatArray], Signal]


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
    """Equations of one rig, to which laws install themselves.

    Parameters
    ----------
    plant : Plant
    inputs, states, outputs : tuple of str
    balances : mapping of str to Balance
        Per state.
    parameters : mapping of str to float
    couplings : mapping of str to Coupling
        Per state that is a stretch.
    terms, holds : list of Law
        Laws that add to balances, and those that hold a state; these come after all others.
    actuators : dict
        What an input makes of its command; by default it holds it.
    shares : dict
        Per output the index of a state that stands in for a share of it (1 where a sensor lags).
    delays : dict
        Per output its delay in s.
    readings : list of callable
        What else sensors do to the outputs, in place: (time, outputs).
    extra : list of callable
        Initial values of the states that laws bring, from the rig's states and outputs.
    """

    plant: Plant
    inputs: tuple[str, ...]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    balances: Mapping[str, Balance]
    parameters: Mapping[str, float]
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    terms: list[Law] = field(default_factory=list)
    holds: list[Law] = field(default_factory=list)
    actuators: dict[str, Actuator] = field(default_factory=dict)
    readings: list[Callable[[FloatArray, FloatArray], None]] = field(default_factory=list)
    shares: dict[str, tuple[int, float]] = field(default_factory=dict)
    delays: dict[str, float] = field(default_factory=dict)
    extra: list[Callable[[Values, Values], float]] = field(default_factory=list)

    def state(self, name: str) -> int:
        """Index of a state."""
        return self.states.index(name)

    def add_state(self, start: Callable[[Values, Values], float] = lambda x, y: 0.0) -> int:
        """Index of a new state whose initial value follows from the first states and outputs."""
        self.extra.append(start)
        return len(self.states) + len(self.extra) - 1

    def term(self, add: Callable[[float, Values, Values, list[float]], None]) -> None:
        """Add a smooth term."""
        self.terms.append(Term(add))

    def run(
        self, time: FloatArray, commands: FloatArray, start: Sequence[float], longest: float
    ) -> tuple[FloatArray, FloatArray]:
        """Outputs, shape (n, outputs), and the rig's own states, shape (n, states), at ``time`` s.

        ``commands`` has shape (n, inputs); each value holds to the next sample. No step is longer than ``longest`` s.
        """
        signals = [self.actuators.get(name, hold)(time, commands[:, k]) for k, name in enumerate(self.inputs)]
        late = {delay: np.maximum(time - delay, time[0]) for delay in {0.0, *self.delays.values()}}
        grid = _union([*late.values(), *(signal.breaks for signal in signals)], time[0], time[-1])
        first = self.plant.read(start, commands[0].tolist())
        begin = [*start, *(value(start, first) for value in self.extra)]
        integrator = Integrator(self.plant, [*self.terms, *self.holds], len(self.extra), signals, longest)
        states = integrator.run(grid, begin)
        pieces = [signal.pieces(grid) for signal in signals]

        def read(at: FloatArray) -> tuple[FloatArray, FloatArray]:
            index = np.searchsorted(grid, at - 1e-9 * (time[1] - time[0]))
            u = [[piece.at(k, float(grid[k])) for piece in pieces] for k in index.tolist()]
            rows = [self.plant.read(x, v) for x, v in zip(states[index].tolist(), u, strict=True)]
            return np.array(rows), states[index]

        shown, at_samples = read(time)
        for name, delay in self.delays.items():
            column = self.outputs.index(name)
            shown[:, column] = read(late[delay])[0][:, column]
        for name, (index, share) in self.shares.items():
            column = self.outputs.index(name)
            shown[:, column] += share * (at_samples[:, index] - shown[:, column])
        for reading in self.readings:
            reading(time, shown)
        return shown, at_samples[:, : len(self.states)]


def _union(parts: Sequence[FloatArray], first: float, last: float) -> FloatArray:
    """Times of all parts within [first, last], sorted, those that differ by rounding only taken as one."""
    grid = np.sort(np.concatenate(parts))
    grid = grid[(grid >= first) & (grid <= last)]
    apart = 1e-9 * float(np.median(np.diff(parts[0])))
    distinct: FloatArray = grid[np.concatenate(([True], np.diff(grid) > apart))]
    return distinct
