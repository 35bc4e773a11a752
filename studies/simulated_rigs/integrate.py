"""Integration of a rig by SciPy's solvers, from jump to jump of its inputs and from event to event of its laws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from simulated_rigs.plant import HoldingLaw, Plant, Term, Values
from simulated_rigs.signals import Pieces, PiecewiseSignal

FloatArray = NDArray[np.float64]
#: Absolute value of a state above which the rig counts as unstable.
MAX_STATE = 1e9
#: Changes of mode between two jumps of the inputs after which the run is given up.
MAX_EVENTS = 100_000


@dataclass(frozen=True)
class SolverChoice:
    """SciPy's method, its relative tolerance, the absolute ones by state, and the first and longest step in s."""

    method: str
    relative: float
    absolute: FloatArray
    first: float | None
    longest: float


class RigIntegrator:
    """Integrator of one rig with its laws; ``extra`` counts the states that laws bring."""

    def __init__(
        self,
        plant: Plant,
        terms: Sequence[Term],
        holds: Sequence[HoldingLaw],
        extra: int,
        signals: Sequence[PiecewiseSignal],
        solver: SolverChoice,
    ) -> None:
        self._plant, self._terms, self._holds, self._signals = plant, list(terms), list(holds), list(signals)
        self._solver, self._blank = solver, [0.0] * extra
        self._inverse = [1.0 / c for c in (*plant.capacity, *([1.0] * extra))]
        self._events = [self._event(law) for law in holds]
        self._pieces: list[Pieces] = []
        self._all_held = all(signal.held for signal in signals)
        self._k, self._now = 0, [0.0] * len(signals)

    def run(self, grid: FloatArray, start: Sequence[float]) -> FloatArray:
        """Integrate to ``grid`` (increasing, s; holds every break of the signals): states, shape (n, states).

        Raises OverflowError for a rig that runs away.
        """
        out = np.empty((grid.size, len(start)))
        out[0] = start
        apart = 1e-9 * float(np.median(np.diff(grid)))
        jumps = np.unique(np.concatenate([np.searchsorted(grid, signal.breaks - apart) for signal in self._signals]))
        edges = [0, *jumps[(jumps > 0) & (jumps < grid.size - 1)].tolist(), grid.size - 1]
        self._pieces = [signal.pieces(grid[edges]) for signal in self._signals]
        x = list(start)
        for law in self._holds:
            law.begin(x)
        try:
            for k in range(len(edges) - 1):
                self._k = k
                self._now = [piece.base[k] for piece in self._pieces]
                x = self._segment(grid, (edges[k], edges[k + 1]), x, out)
        except OverflowError:
            raise OverflowError("a simulated rig runs away") from None
        return out

    def _segment(self, grid: FloatArray, span: tuple[int, int], x: list[float], out: FloatArray) -> list[float]:
        """Integrate between two jumps of the inputs, which are the points ``span`` of the grid."""
        (at, last), chosen = span, self._solver
        t, end = float(grid[at]), float(grid[last])
        self._settle(t, x)
        for _ in range(MAX_EVENTS):
            found = solve_ivp(
                self._rates, (t, end), np.array(x), chosen.method, grid[at + 1 : last + 1], events=self._events or None,
                rtol=chosen.relative, atol=chosen.absolute, 
                first_step=None if chosen.first is None else min(chosen.first, end - t), max_step=chosen.longest,
            )  # fmt: skip
            states, reached = found.y.T if len(found.t) else np.empty((0, len(x))), at + len(found.t)
            if found.status < 0 or not (np.abs(states) < MAX_STATE).all():
                raise OverflowError
            out[at + 1 : reached + 1] = states
            if not found.status:
                return [float(value) for value in out[last]]
            which = next(k for k, times in enumerate(found.t_events) if len(times))
            t, x, at = float(found.t_events[which][0]), found.y_events[which][0].tolist(), reached
            self._holds[which].switch(x, partial(self._efforts, t, x, self._holds[which]))
            self._settle(t, x)
            if at == last:  # the event is where the segment ends
                return x
        raise OverflowError

    def _settle(self, t: float, x: list[float]) -> None:
        """Give every law whose mode no longer holds the one that does."""
        for law in self._holds:
            efforts = partial(self._efforts, t, x, law)
            if law.margin(x, efforts) < 0.0:
                law.switch(x, efforts)

    def _event(self, law: HoldingLaw) -> Callable[[float, FloatArray], float]:
        def margin(t: float, x: FloatArray) -> float:
            values = x.tolist()
            return law.margin(values, partial(self._efforts, t, values, law))

        event: Any = margin
        event.terminal, event.direction = True, -1.0
        return margin

    def _efforts(self, t: float, x: Values, without: HoldingLaw | None = None) -> list[float]:
        u = self._now if self._all_held else [piece.at(self._k, t) for piece in self._pieces]
        e = self._plant.efforts(x, u) + self._blank
        for term in self._terms:
            term(t, x, u, e)
        for law in self._holds:
            if law is not without:
                law.add(t, x, u, e)
        return e

    def _rates(self, t: float, x: FloatArray) -> list[float]:
        return [a * b for a, b in zip(self._efforts(t, x.tolist()), self._inverse, strict=True)]
