"""A rig: its equations, laws, actuators and sensors put together, and what it then does.

Every state x_i obeys c_i dx_i/dt = e_i: a mass and the sum of its forces, an area and the sum of its flows; c_i = 1
and e_i a rate for a state that only follows others. A term adds to e; friction that sticks and a tank that is full hold
their state, and change between two modes at events. SciPy's solvers integrate from jump to jump of the inputs and from
event to event.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise, zip_longest
from math import copysign, cos, exp, inf, pi, sin, sqrt
from typing import Any, Literal

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from aero_bayes.arrays import FloatArray
from simulated_rigs.signals import Signal, held_command

Values = Sequence[float]
Parameters = Mapping[str, float]
#: (t, states, inputs) -> a rate each.
Rates = Callable[[float, Values, Values], list[float]]
Actuator = Callable[[FloatArray, FloatArray], Signal]
#: Longest step in samples, with laws that hold a state (a short visit to the other side is no event) and without.
LONGEST_WITH_EVENTS, LONGEST = 1.0, 10.0
#: Absolute value of a state above which the rig counts as unstable.
MAX_STATE = 1e9
#: Changes of mode between two jumps of the inputs after which the run is given up.
MAX_EVENTS = 100_000


#: Names in expressions, and functions that they may use.
NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?")
FUNCTIONS: dict[str, Any] = {f.__name__: f for f in (abs, max, min, cos, copysign, exp, sin, sqrt)} | {"pi": pi}
ARRAYS: dict[str, Any] = {name: getattr(np, name) for name in ("abs", "clip", "maximum", "pi", "sign", "sin")}


def with_values(expression: str, places: Mapping[str, str], values: Parameters) -> str:
    """Put into an expression where names stand (``x[0]``), and the values of parameters."""

    def put(found: re.Match[str]) -> str:
        name = found[0]
        return places.get(name) or (f"({float(values[name])!r})" if name in values else name)

    return NAME.sub(put, expression)


def function(arguments: str, expression: str, names: dict[str, Any] = FUNCTIONS) -> Callable[..., Any]:
    """Compile an expression of some arguments and of functions by their names."""
    found: Callable[..., Any] = eval(f"lambda {arguments}: {expression}", names)
    return found


def compiled(expressions: Sequence[str]) -> Rates:
    """Compile expressions of the time ``t``, the states ``x`` and the inputs ``u``."""
    return function("t, x, u", f"[{', '.join(expressions)}]")


@dataclass(frozen=True)
class Plant:
    """The equations of one rig: c_i, (time, states, inputs) -> e_i, and the states that are measured."""

    capacity: tuple[float, ...]
    efforts: Rates
    shown: tuple[int, ...]


@dataclass(frozen=True)
class Balance:
    """A state: what is balanced (forces, flows, voltages; a rate only follows another state), and its sum.

    ``efforts``, ``inertia`` and ``rest``, the state at rest under the drives' centres, are expressions. ``size`` is how
    large it usually gets, ``shake`` the standard deviation of where a recording starts, about rest. ``position`` is the
    state whose derivative this one is, ``reference`` the level at which losses vanish, and ``neighbour`` the storage
    that takes what spills, or exchanges with this one.
    """

    family: Literal["motion", "storage", "electrical", "rate"]
    efforts: str
    size: float
    shake: float = 0.0
    inertia: str = "1.0"
    rest: str = "0.0"
    position: str | None = None
    reference: float = 0.0
    neighbour: str | None = None


@dataclass(frozen=True)
class Coupling:
    """The elastic element whose stretch is a state: its force on ``first`` (and against it on ``second``)."""

    first: str
    second: str
    stiffness: str
    damping: str


@dataclass(frozen=True)
class Drive:
    """How an input is driven: around ``centre``, by up to ``height``, in units of ``clock`` s."""

    centre: float
    height: float
    clock: float
    unit: str = ""


@dataclass(frozen=True)
class RigKind:
    """One kind of rig.

    ``name`` is also the folder of its model, ``parameters`` are the values in the Modelica file, from which the fit
    starts; ``known`` are right there, all others are free, and ``constants`` are none of the model. ``outputs`` show a
    state each, in a unit (none where the model declares none); ``step`` is the sample interval in s, ``rows`` the
    number of samples. ``laws`` has per place the laws that may be missing there, in one string; inputs as ``in:NAME``,
    outputs as ``out:NAME``. ``linear`` says whether the equations without laws are, ``method`` is SciPy's for the
    others. A command holds for ``hold`` samples.
    """

    name: str
    parameters: Parameters
    inputs: Mapping[str, Drive]
    states: Mapping[str, Balance]
    outputs: Mapping[str, tuple[str, str]]
    step: float
    rows: int
    laws: Mapping[str, str]
    known: tuple[str, ...] = ()
    constants: Parameters = field(default_factory=dict)
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    linear: bool = True
    method: str = "DOP853"
    hold: int = 1

    @property
    def units(self) -> dict[str, str]:
        """Units of time, inputs and outputs."""
        drives = {name: drive.unit for name, drive in self.inputs.items()}
        return {"time": "s", **drives, **{name: unit for name, (_, unit) in self.outputs.items()}}

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that the fit may change."""
        return tuple(name for name in self.parameters if name not in self.known)

    def rest(self, parameters: Parameters) -> list[float]:
        """Return the states at rest under the drives' centres."""
        return compiled([with_values(b.rest, {}, parameters) for b in self.states.values()])(0.0, [], [])

    def plant(
        self, parameters: Parameters, acting: Mapping[str, str] | None = None, added: Sequence[str] = ()
    ) -> Plant:
        """Return the equations, in which some inputs are what is ``acting``, and something is ``added`` to efforts."""
        states, balances, values = list(self.states), self.states.values(), {**self.constants, **parameters}
        places = {name: f"x[{k}]" for k, name in enumerate(states)}
        places |= {name: f"u[{k}]" for k, name in enumerate(self.inputs)} | dict(acting or {})
        further = ["1.0"] * (len(added) - len(states))
        inertia = compiled([with_values(b.inertia, {}, values) for b in balances] + further)(0.0, [], [])
        efforts = [f"({with_values(b.efforts, places, values)})" for b in balances] + ["0.0"] * len(further)
        sums = map("".join, zip_longest(efforts, added, fillvalue=""))
        shown = tuple(states.index(name) for name, _ in self.outputs.values())
        return Plant(tuple(inertia), compiled(list(sums)), shown)


@dataclass
class DryFriction:
    """A level that opposes motion and holds what stands still until it is pushed harder than that.

    ``level`` is a function of direction and speed (not negative); at zero speed it is the push that breaks loose.
    """

    index: int
    level: Callable[[int, float], float]
    direction: int = 0

    def begin(self, x: Values) -> None:
        """Take the mode of a state at which a run begins."""
        self.direction = (x[self.index] > 0.0) - (x[self.index] < 0.0)

    def add(self, e: list[float], x: Values) -> None:
        """Add to the efforts, those of all other laws."""
        if self.direction:
            e[self.index] -= self.direction * self.level(self.direction, max(self.direction * x[self.index], 0.0))
        else:
            e[self.index] = 0.0

    def margin(self, x: Values, e: Callable[[], Values]) -> float:
        """Return what is positive while the present mode holds, else negative; ``e()`` are efforts without this law."""
        if self.direction:
            return x[self.index] * self.direction
        push = e()[self.index]
        return self.level(1 if push > 0.0 else -1, 0.0) - abs(push)

    def switch(self, x: list[float], e: Callable[[], Values]) -> None:
        """Leave the present mode, and put ``x`` where the next one starts."""
        x[self.index] = 0.0
        push = e()[self.index]
        side = 1 if push > 0.0 else -1
        # What stuck is loose now, also where rounding leaves the push just below the level.
        self.direction = side if not self.direction or abs(push) > self.level(side, 0.0) else 0


@dataclass
class Overflow:
    """A storage that cannot rise above a rim; a share of what spills goes to a neighbour (or none)."""

    index: int
    rim: float
    neighbour: int | None
    share: float
    full: bool = False

    def begin(self, x: Values) -> None:
        self.full = False

    def add(self, e: list[float], x: Values) -> None:
        if self.full:
            spilled, e[self.index] = e[self.index], 0.0
            if self.neighbour is not None:
                e[self.neighbour] += self.share * spilled

    def margin(self, x: Values, e: Callable[[], Values]) -> float:
        return e()[self.index] if self.full else self.rim - x[self.index]

    def switch(self, x: list[float], e: Callable[[], Values]) -> None:
        x[self.index] = self.rim
        self.full = not self.full


HoldingLaw = DryFriction | Overflow


class Assembly:
    """One rig, to which laws add themselves.

    Laws that hold a state come after what is ``added`` to the efforts of each. ``forces`` follow the inputs in u.
    ``actuators`` make of a command what is applied, ``acting`` has inputs that a state stands for; ``delays`` (s) are
    those of outputs, ``readings`` change the outputs in place (time, outputs, all states). ``extra`` has, for each
    state that laws bring, the state or the input whose initial value it shares, or None for zero.
    """

    def __init__(self, kind: RigKind, parameters: Parameters) -> None:
        self.kind, self.parameters, self.plant = kind, parameters, kind.plant(parameters)
        self.method = kind.method
        self.added = [""] * len(kind.states)
        self.holds: list[HoldingLaw] = []
        self.forces: list[FloatArray] = []
        self.actuators: dict[str, Actuator] = {}
        self.acting: dict[str, str] = {}
        self.readings: list[Callable[[FloatArray, FloatArray, FloatArray], object]] = []
        self.delays: dict[str, float] = {}
        self.extra: list[int | str | None] = []

    def state(self, name: str) -> int:
        """Return the index of a state."""
        return list(self.kind.states).index(name)

    def column(self, name: str) -> int:
        """Return the index of an output."""
        return list(self.kind.outputs).index(name)

    def add_state(self, like: int | str | None = None) -> int:
        """Add a state that starts at zero, or where the state or input ``like`` starts, and return its index."""
        self.extra.append(like)
        self.added.append("")
        return len(self.added) - 1

    def push(self, name: str, values: FloatArray) -> None:
        """Add a force to a balance, shape (n,), that holds each of its values to the next sample."""
        self.add({"x": self.state(name)}, {}, x=f"u[{len(self.kind.inputs) + len(self.forces)}]")
        self.forces.append(values)

    def add(self, places: Mapping[str, int], values: Parameters, **expressions: str) -> None:
        """Add expressions to the efforts of states; ``places`` says which state a name is."""
        states = {name: f"x[{k}]" for name, k in places.items()}
        for name, expression in expressions.items():
            self.added[places[name]] += f" + ({with_values(expression, states, values)})"

    def run(
        self, time: FloatArray, commands: FloatArray, start: Sequence[float], relative: float = 1e-9
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate outputs, shape (n, outputs), and all states, shape (n, states), at even ``time`` s.

        ``commands`` has shape (n, inputs); each value holds to the next sample. ``relative`` is the solver's tolerance.
        """
        names = enumerate(self.kind.inputs)
        signals = [self.actuators.get(name, held_command)(time, commands[:, k]) for k, name in names]
        signals += [held_command(time, values) for values in self.forces]
        late = {name: np.maximum(time - delay, time[0]) for name, delay in self.delays.items()}
        apart = 1e-9 * (time[1] - time[0])
        grid = _union([time, *late.values(), *(breaks for breaks, _ in signals)], time, apart)
        first = [*start, *commands[0].tolist(), 0.0]
        begin = [*start, *(first[k] for k in self._alike())]
        found = _Integration(self, signals, self._solver(time, relative)).run(grid, begin)
        at = np.searchsorted(grid, time - apart)
        outputs = found[np.ix_(at, self.plant.shown)]
        for name, times in late.items():
            column = self.column(name)
            outputs[:, column] = found[np.searchsorted(grid, times - apart), self.plant.shown[column]]
        for reading in self.readings:
            reading(time, outputs, found[at])
        return outputs, found[at]

    def _alike(self) -> list[int]:
        """Return what each further state is like: a place among states, inputs and zero."""
        names = [*range(len(self.kind.states)), *self.kind.inputs, None]
        return [names.index(like) for like in self.extra]

    def _solver(self, time: FloatArray, relative: float) -> dict[str, Any]:
        step = float(time[1] - time[0])
        stiff = self.method != "DOP853"
        sizes = [b.size for b in self.kind.states.values()] + [d.height for d in self.kind.inputs.values()] + [1e-3]
        own = relative * np.array(sizes)
        states = [*range(len(self.kind.states)), *self._alike()]
        return {
            "method": self.method, "rtol": relative, "atol": own[states],
            "first_step": None if stiff else step,
            "max_step": step * (LONGEST_WITH_EVENTS if self.holds else inf if stiff else LONGEST),
        }  # fmt: skip


def _union(parts: Sequence[FloatArray], time: FloatArray, apart: float) -> FloatArray:
    """Join the times of all parts that lie within ``time``, sorted; of those that differ by rounding only the first."""
    grid = np.sort(np.concatenate(parts))
    grid = grid[(grid >= time[0]) & (grid <= time[-1])]
    distinct: FloatArray = grid[np.concatenate(([True], np.diff(grid) > apart))]
    return distinct


class _Integration:
    """One run of a rig under ``signals``, by SciPy's ``solver``."""

    def __init__(self, rig: Assembly, signals: Sequence[Signal], solver: dict[str, Any]) -> None:
        self._rig, self._signals, self._solver = rig, signals, solver
        self._plant = rig.kind.plant(rig.parameters, rig.acting, rig.added)
        self._inverse = [1.0 / c for c in self._plant.capacity]
        self._events = [self._event(law) for law in rig.holds]

    def run(self, grid: FloatArray, start: Sequence[float]) -> FloatArray:
        """Integrate to ``grid`` (increasing, s; holds every break of the signals): states, shape (n, states).

        Raises OverflowError for a rig that runs away.
        """
        out = np.empty((grid.size, len(start)))
        out[0] = start
        apart = 1e-9 * float(np.median(np.diff(grid)))
        jumps = np.unique(np.concatenate([np.searchsorted(grid, breaks - apart) for breaks, _ in self._signals]))
        edges = [0, *jumps[(jumps > 0) & (jumps < grid.size - 1)].tolist(), grid.size - 1]
        x = list(start)
        for law in self._rig.holds:
            law.begin(x)
        try:
            for first, last in pairwise(edges):
                at = grid[first] + apart
                self._now = [float(v[max(np.searchsorted(t, at, "right") - 1, 0)]) for t, v in self._signals]
                x = self._segment(grid, (first, last), x, out)
        except OverflowError:
            raise OverflowError("a simulated rig runs away") from None
        return out

    def _segment(self, grid: FloatArray, span: tuple[int, int], x: list[float], out: FloatArray) -> list[float]:
        """Integrate between two jumps of the inputs, which are the points ``span`` of the grid."""
        (at, last), chosen, first = span, self._solver, self._solver["first_step"]
        t, end = float(grid[at]), float(grid[last])
        self._settle(t, x)
        for _ in range(MAX_EVENTS):
            found = solve_ivp(
                self._rates, (t, end), np.array(x), t_eval=grid[at + 1 : last + 1], events=self._events or None,
                **{**chosen, "first_step": first and min(first, end - t)},
            )  # fmt: skip
            states, reached = found.y.T if len(found.t) else np.empty((0, len(x))), at + len(found.t)
            if found.status < 0 or not (np.abs(states) < MAX_STATE).all():
                raise OverflowError
            out[at + 1 : reached + 1] = states
            if not found.status:
                return [float(value) for value in out[last]]
            which = next(k for k, times in enumerate(found.t_events) if len(times))
            t, x, at = float(found.t_events[which][0]), found.y_events[which][0].tolist(), reached
            law = self._rig.holds[which]
            law.switch(x, partial(self._efforts, t, x, law))
            self._settle(t, x)
            if at == last:  # the event is where the segment ends
                return x
        raise OverflowError

    def _settle(self, t: float, x: list[float]) -> None:
        """Give every law whose mode no longer holds the one that does."""
        for law in self._rig.holds:
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
        e = self._plant.efforts(t, x, self._now)
        for law in self._rig.holds:
            if law is not without:
                law.add(e, x)
        return e

    def _rates(self, t: float, x: FloatArray) -> list[float]:
        return [a * b for a, b in zip(self._efforts(t, x.tolist()), self._inverse, strict=True)]


def run_linear(
    plant: Plant, step: float, commands: FloatArray, start: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """Simulate outputs, shape (n, outputs), and states, shape (n, states), of a linear rig at samples ``step`` s apart.

    The equations dx/dt = A x + B u + c are read off by unit vectors.
    """
    states, inputs = len(start), commands.shape[1]
    capacity = np.array(plant.capacity)
    origin = np.array(plant.efforts(0.0, [0.0] * states, [0.0] * inputs)) / capacity
    units = np.eye(states + inputs).tolist()
    columns = [np.array(plant.efforts(0.0, unit[:states], unit[states:])) / capacity - origin for unit in units]
    driven, held = np.column_stack([*columns[states:], origin]), np.column_stack([commands, np.ones(len(commands))])
    system = np.column_stack(columns[:states]), driven, np.eye(states), np.zeros(driven.shape)
    x = lsim(system, held, step * np.arange(len(commands)), start, interp=False)[2]
    return x[:, list(plant.shown)], x
