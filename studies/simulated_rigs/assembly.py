"""A rig put together: its equations, its laws, its actuators and sensors; and what it then does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulated_rigs.integrate import RigIntegrator, SolverChoice
from simulated_rigs.plant import HoldingLaw, Plant, Term
from simulated_rigs.signals import PiecewiseSignal, held_command

FloatArray = NDArray[np.float64]
Family = Literal["motion", "storage", "electrical", "rate"]
Actuator = Callable[[FloatArray, FloatArray], PiecewiseSignal]
#: Longest step in samples, with laws that hold a state (a short visit to the other side is no event) and without.
LONGEST_WITH_EVENTS, LONGEST = 1.0, 10.0


@dataclass(frozen=True)
class Balance:
    """A state as laws see it: what is balanced (forces, flows, voltages; a rate only follows another state).

    ``position`` is the state whose derivative this one is, ``reference`` the level at which losses vanish, and
    ``neighbour`` the storage that takes what spills, or exchanges with this one.
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

    Laws that hold a state come after all terms. ``actuators`` make of a command what is applied, ``delays``
    (s) are those of outputs, ``readings`` change the outputs in place (time, outputs, all states). ``extra`` has, for
    each state that laws bring, the state whose initial value it shares, or None for zero. ``sizes`` are what the rig's
    own states usually are, for the tolerances; ``method`` is SciPy's.
    """

    plant: Plant
    inputs: tuple[str, ...]
    balances: Mapping[str, Balance]
    outputs: tuple[str, ...]
    parameters: Mapping[str, float]
    sizes: tuple[float, ...]
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    method: str = "DOP853"
    terms: list[Term] = field(default_factory=list)
    holds: list[HoldingLaw] = field(default_factory=list)
    forces: list[tuple[int, FloatArray]] = field(default_factory=list)
    actuators: dict[str, Actuator] = field(default_factory=dict)
    readings: list[Callable[[FloatArray, FloatArray, FloatArray], object]] = field(default_factory=list)
    delays: dict[str, float] = field(default_factory=dict)
    extra: list[int | None] = field(default_factory=list)

    @property
    def states(self) -> tuple[str, ...]:
        """The rig's own states."""
        return tuple(self.balances)

    def state(self, name: str) -> int:
        """Return the index of a state."""
        return self.states.index(name)

    def add_state(self, like: int | None = None) -> int:
        """Add a state that starts at zero, or where the state ``like`` starts, and return its index."""
        self.extra.append(like)
        return len(self.balances) + len(self.extra) - 1

    def push(self, name: str, values: FloatArray) -> None:
        """Add a force to a balance, shape (n,), that holds each of its values to the next sample."""
        self.forces.append((self.state(name), values))

    def run(
        self, time: FloatArray, commands: FloatArray, start: Sequence[float], relative: float = 1e-9
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate outputs, shape (n, outputs), and all states, shape (n, states), at ``time`` s.

        ``commands`` has shape (n, inputs); each value holds to the next sample. ``relative`` is the solver's tolerance.
        """
        signals = [self.actuators.get(name, held_command)(time, commands[:, k]) for k, name in enumerate(self.inputs)]
        signals += [held_command(time, values) for _, values in self.forces]
        late = {name: np.maximum(time - delay, time[0]) for name, delay in self.delays.items()}
        grid = _union([time, *late.values(), *(signal.breaks for signal in signals)], time[0], time[-1])
        begin = [*start, *(0.0 if like is None else start[like] for like in self.extra)]
        integrator = RigIntegrator(
            self.plant,
            [*self.terms, *self._forced()],
            self.holds,
            len(self.extra),
            signals,
            self._solver(time, relative),
        )
        found = integrator.run(grid, begin)
        apart = 1e-9 * (time[1] - time[0])
        at = np.searchsorted(grid, time - apart)
        outputs = found[np.ix_(at, self.plant.shown)]
        for name, times in late.items():
            column = self.outputs.index(name)
            outputs[:, column] = found[np.searchsorted(grid, times - apart), self.plant.shown[column]]
        for reading in self.readings:
            reading(time, outputs, found[at])
        return outputs, found[at]

    def _forced(self) -> list[Term]:
        """Return the terms that add the forces, which follow the inputs in u."""

        def term(index: int, column: int) -> Term:
            def add(t: float, x: Sequence[float], u: Sequence[float], e: list[float]) -> None:
                e[index] += u[column]

            return add

        return [term(index, len(self.inputs) + k) for k, (index, _) in enumerate(self.forces)]

    def _solver(self, time: FloatArray, relative: float) -> SolverChoice:
        step = float(time[1] - time[0])
        stiff = self.method != "DOP853"
        longest = step * (LONGEST_WITH_EVENTS if self.holds else inf if stiff else LONGEST)
        own = relative * np.array(self.sizes)
        extra = [1e-3 * relative if like is None else own[like] for like in self.extra]
        return SolverChoice(self.method, relative, np.array([*own, *extra]), None if stiff else step, longest)


def _union(parts: Sequence[FloatArray], first: float, last: float) -> FloatArray:
    """Join the times of all parts within [first, last], sorted, those that differ by rounding only taken as one."""
    grid = np.sort(np.concatenate(parts))
    grid = grid[(grid >= first) & (grid <= last)]
    apart = 1e-9 * float(np.median(np.diff(parts[0])))
    distinct: FloatArray = grid[np.concatenate(([True], np.diff(grid) > apart))]
    return distinct
