"""Nominal values of the signals at ports, from a simulation at a fit. Laws scale their parameters by them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import OpenSimulator, Optimum
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.laws.aliases import AliasStructure, alias_structure
from aero_bayes.laws.balance import KELVIN, PORT_KINDS, Port
from aero_bayes.laws.probes import with_probe
from aero_bayes.modelica.compose import add_output
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, summands
from aero_bayes.simulation.interface import InputSignal, Outcome
from aero_bayes.simulation.model import Model

#: The nominal value of a signal is this quantile of its absolute values.
NOMINAL_QUANTILE = 0.995
#: Share of its range that a place must move in a direction for that to count.
MIN_TRAVEL_SHARE = 0.02
#: Share of its range by which a signal must move back to count as turning back: sensor noise is less.
MIN_RETURN_SHARE = 0.1
#: Parts of a signal's range that are looked at for how often it passes them.
RANGE_PARTS = 40
#: Least time scale in readings. Laws regard a small share of the time scale as short.
MIN_READINGS_PER_TIME = 10.0


def signal_nominal(parts: Sequence[FloatArray]) -> float:
    """Return the quantile :data:`NOMINAL_QUANTILE` of the absolute values of a signal; 0 without values."""
    return float(np.quantile(np.abs(np.concatenate(parts)), NOMINAL_QUANTILE)) if parts else 0.0


def visited_range(signal: str, parts: Sequence[FloatArray]) -> dict[str, float]:
    """Return the range of a signal but for rare extremes, by ``<signal>_low`` and ``<signal>_high``.

    Empty without values."""
    if not parts:
        return {}
    low, high = np.quantile(np.concatenate(parts), (1.0 - NOMINAL_QUANTILE, NOMINAL_QUANTILE))
    return {f"{signal}_low": float(low), f"{signal}_high": float(high)}


def share_visited_twice(parts: Sequence[FloatArray]) -> float:
    """Compute the share of a signal's range that it passes at least twice, over recordings (n,) one after the other.

    It counts as turning back where it moves back by :data:`MIN_RETURN_SHARE` of its range. Zero for what never moves.
    """
    whole = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.zeros(0)
    span = float(np.ptp(whole)) if whole.size else 0.0
    if span <= 0.0:
        return 0.0
    turns = _turning_points(whole, MIN_RETURN_SHARE * span)
    grid = float(whole.min()) + span * (np.arange(RANGE_PARTS) + 0.5) / RANGE_PARTS
    low, high = np.minimum(turns[:-1], turns[1:]), np.maximum(turns[:-1], turns[1:])
    passes = ((low[:, np.newaxis] <= grid) & (grid <= high[:, np.newaxis])).sum(axis=0)
    return float(np.mean(passes >= 2))


def _turning_points(signal: FloatArray, least: float) -> FloatArray:
    """Find first value, extremes from which a signal (n,) moves back by more than ``least``, and the last extreme."""
    found, extreme, rising = [float(signal[0])], float(signal[0]), None
    for value in signal.tolist():
        if rising is None:
            rising = value > found[0] if abs(value - found[0]) > least else None
            extreme = value
        elif (value > extreme) is rising:
            extreme = value
        elif abs(value - extreme) > least:
            found.append(extreme)
            extreme, rising = value, not rising
    return np.array([*found, extreme])


def possible_directions(places: Sequence[FloatArray], speed: Mapping[str, float]) -> dict[str, float]:
    """Return the range of a speed, without a direction in which the place does not move.

    A place may be recorded where its speed is only simulated, by a fit that lacks an effect."""
    span = float(np.ptp(np.concatenate(places)))
    up = max(float(np.max(x - np.minimum.accumulate(x))) for x in places)
    down = max(float(np.max(np.maximum.accumulate(x) - x)) for x in places)
    found = dict(speed)
    if up < MIN_TRAVEL_SHARE * span:
        found["v_high"] = min(found["v_high"], 0.0)
    if down < MIN_TRAVEL_SHARE * span:
        found["v_low"] = max(found["v_low"], 0.0)
    return found


def relative_change(inputs: Sequence[InputSignal], time: float) -> float:
    """Compute the change of an input within ``time`` (s), over its nominal value.

    Changes that are at least as large make up half of the sum of all changes."""
    size = signal_nominal([s.values for s in inputs])
    moved = [np.abs(np.interp(s.time + time, s.time, s.values) - s.values) for s in inputs]
    steps = np.sort(np.concatenate(moved)) if moved else np.zeros(0)
    if size <= 0.0 or not steps.any():
        return 1.0
    return float(steps[np.searchsorted(np.cumsum(steps), 0.5 * steps.sum())]) / size


def fastest_time_scale(data: MeasuredData) -> float:
    """Estimate the time scale of the fastest output in s: its standard deviation over the RMS of its derivative."""
    times = []
    for experiment in data.experiments:
        for y in np.asarray(_smooth(experiment.measured)).T if experiment.measured is not None else ():
            seen = np.isfinite(y)
            if seen.sum() < 10:
                continue
            t, v = experiment.time[seen], y[seen]
            rate = float(np.sqrt(np.mean((np.diff(v) / np.diff(t)) ** 2)))
            step = float(np.median(np.diff(t)))
            if rate > 0.0:
                times.append(max(float(np.std(v)) / rate, MIN_READINGS_PER_TIME * step))
    return min(times, default=1.0)


def _smooth(measured: FloatArray, width: int = 5) -> FloatArray:
    """Compute moving averages, which suppress noise in the derivative."""
    kernel = np.ones(width) / width
    return np.stack([np.convolve(y, kernel, mode="same") for y in measured.T], axis=1)


#: Nominal value below which a signal counts as zero.
MIN_NOMINAL = 1e-200
#: Share of the range of an output that a constant as large as the terms of a model moves at least, in a model that is
#: driven by them.
MIN_REACH = 0.03
#: Number of first readings whose regression line gives the initial value of a level.
LEVEL_READINGS = 5
#: Time for which a model is simulated until it settles, in lengths of the recording; and the largest change of a level
#: in the second half of that time, as a share of its range in the recording.
SETTLING_LENGTHS, MAX_DRIFT_SHARE = 20.0, 0.01
#: Is added to an output, so that it does not become an alias of a state.
NEGLIGIBLE_TERM = Call("*", (Number(1e-300), Name("time")))


def port_nominals(
    flat: FlatModel, ports: Sequence[Port], calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator
) -> dict[str, dict[str, float]]:
    """Compute nominal values by the id of the port, under the names of partial models of laws (``f_n``, ``v_n``, ...).

    The nominal value of a law's output in a balance is that of the largest term of the balance. Beside them stands the
    range of each signal, ``v_low`` and ``v_high`` for ``v``, and the share of it that is visited twice, ``v_twice``."""
    structure, data = alias_structure(flat), calibration.data
    outputs = _AddedOutputs(flat)
    acting: dict[str, list[str]] = {}
    seen: dict[str, dict[str, str]] = {}
    levels = {p.id: p.signals["h"].expression for p in ports if p.kind == "storage"}
    for port in ports:
        seen[port.id] = {signal: outputs.of(given.expression) for signal, given in port.signals.items()}
        if port.kind == "storage" and port.neighbours:
            seen[port.id]["d"] = outputs.of(Call("-", (levels[port.id], levels[port.neighbours[0]])))
        acting[port.id] = [outputs.of(term) for term in _terms(flat, port)]
    warm = {p.id for p in ports if p.kind == "storage" and p.units.get("h") in KELVIN and "h_s" not in p.signals}
    with tempfile.TemporaryDirectory() as folder:
        own, probes = outputs.exported(calibration, ports, Path(folder) / "watched.fmu")
        found, rest = outputs.run(own, fit, open_simulator, undriven=bool(warm))
        sizes = {name: max((_size(found, n) for n in acting[id_]), default=0.0) for id_, name in probes.items()}
        larger = _shortfall(own, sizes, fit, open_simulator)
    found = {
        name: _recorded_over(structure, data, e, found[name]) for e, name in outputs.names.items() if name in found
    }
    time = fastest_time_scale(data)
    starts = _first_readings(structure, ports, data)
    for id_ in warm:
        ends = rest.get(seen[id_]["h"], [])
        if ends and all(_settled(end, found[seen[id_]["h"]]) for end in ends):
            starts[id_] = float(np.mean([end[-1] for end in ends]))
    return {p.id: _nominals(p, found, seen[p.id], acting[p.id], time, data, starts.get(p.id), larger) for p in ports}


def _shortfall(own: Calibration, sizes: Mapping[str, float], fit: Optimum, open_simulator: OpenSimulator) -> float:
    """How many times larger than the terms of the model those must be that move an output through its range.

    It is 1 but where no constant as large as they (``sizes`` by the input that adds it) moves an output by
    :data:`MIN_REACH` of its range: the model lacks what drives it, such as the weight of a body that falls, so that its
    own terms are no measure of what is missing."""
    data, reach = own.data, 0.0
    read = np.concatenate([np.asarray(e.measured) for e in data.experiments])
    span = np.maximum(np.nanmax(read, axis=0) - np.nanmin(read, axis=0), MIN_NOMINAL)

    def outputs(**pushed: float) -> FloatArray:
        moved = [
            replace(e, inputs=(*e.inputs, *(InputSignal(n, e.time[:1], np.array([v])) for n, v in pushed.items())))
            for e in data.experiments
        ]
        there = replace(own, data=data.with_experiments(moved))
        found = simulated_signals(there, data.outputs, fit, open_simulator)
        return np.stack([np.concatenate(found[o]) for o in data.outputs], axis=1)

    still = outputs()
    for name, size in sizes.items():
        with suppress(InputError):
            if size > MIN_NOMINAL:
                reach = max(reach, float(np.max(np.abs(outputs(**{name: size}) - still) / span)))
    return 1.0 / reach if 0.0 < reach < MIN_REACH else 1.0


def _size(found: Mapping[str, list[FloatArray]], name: str) -> float:
    return signal_nominal(found[name]) if name in found else 0.0


def _settled(end: FloatArray, over: Sequence[FloatArray]) -> bool:
    """Return whether a level without inputs has settled."""
    return abs(float(end[-1] - end[-2])) < MAX_DRIFT_SHARE * float(np.ptp(np.concatenate(over)))


def _near(
    data: MeasuredData, outputs: Mapping[str, list[FloatArray]], signals: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return signals of each recording, at times when every simulated output is near the range of its readings."""
    kept = []
    for e, (experiment, signal) in enumerate(zip(data.experiments, signals, strict=True)):
        near = np.ones(signal.size, dtype=np.bool_)
        for column, name in enumerate(experiment.outputs if experiment.measured is not None else ()):
            assert experiment.measured is not None
            low, high = np.nanmin(experiment.measured[:, column]), np.nanmax(experiment.measured[:, column])
            near &= np.abs(outputs[name][e] - 0.5 * (low + high)) <= high - low
        kept.append(signal[near])
    return kept


def _undriven(calibration: Calibration) -> Calibration:
    """Make long experiments without inputs. Inputs that are temperatures keep their means."""
    warm = {v.name for v in calibration.model.inputs if v.unit in KELVIN}
    experiments = []
    for e in calibration.data.experiments:
        means = {s.name: float(np.mean(s.values)) if s.name in warm else 0.0 for s in e.inputs}
        inputs = tuple(replace(s, time=s.time[:1], values=np.array([means[s.name]])) for s in e.inputs)
        time = e.time[0] + (e.time[-1] - e.time[0]) * np.array([0.0, 0.5, 1.0]) * SETTLING_LENGTHS
        experiments.append(replace(e, time=time, inputs=inputs))
    return replace(calibration, data=calibration.data.with_experiments(experiments))


def _recorded_over(
    structure: AliasStructure, data: MeasuredData, expression: Expression, simulated: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return the readings of a signal that is an output; where there is none, the simulated values."""
    members = structure.members(structure.of(expression.name)) if isinstance(expression, Name) else ()
    found, recorded = list(simulated), set[int]()
    for k, e in enumerate(data.experiments):
        for column in (c for c, output in enumerate(e.outputs) if output in members and e.measured is not None):
            assert e.measured is not None
            recorded.add(k)
            found[k] = np.where(np.isfinite(e.measured[:, column]), e.measured[:, column], found[k])
    # where every recording has it, what the model says of it elsewhere is not asked
    return found[: len(recorded)] if len(recorded) == len(data.experiments) else found


def _first_readings(structure: AliasStructure, ports: Sequence[Port], data: MeasuredData) -> dict[str, float]:
    """Return initial values of levels that are outputs, from the first readings of the first recording."""
    first = data.experiments[0]
    found = {}
    for port in ports:
        level = structure.of(str(port.signals.get("h", "")))
        for column, output in enumerate(first.outputs):
            if output in structure.members(level) and first.measured is not None:
                seen = np.flatnonzero(np.isfinite(first.measured[:, column]))[:LEVEL_READINGS]
                if seen.size == LEVEL_READINGS:
                    line = np.polyfit(first.time[seen] - first.time[0], first.measured[seen, column], 1)
                    found[port.id] = float(line[-1])
    return found


class _AddedOutputs:
    """Expressions of a flat model that are added as outputs, each once."""

    def __init__(self, flat: FlatModel) -> None:
        self.flat = flat
        self.names: dict[Expression, str] = {}

    def of(self, expression: Expression) -> str:
        if expression not in self.names:
            self.names[expression] = f"watched_{len(self.names)}"
        return self.names[expression]

    def exported(
        self, calibration: Calibration, ports: Sequence[Port], path: Path
    ) -> tuple[Calibration, dict[str, str]]:
        """Return the calibration on the model that has them, and inputs that add to the balances of ports, by their id.

        Expressions, and inputs, with which the model cannot be exported are left out."""
        probes = {p.id: f"pushed_{k}" for k, p in enumerate(ports) if p.balance is not None}
        try:
            model = self._export(self.names, path, [(p, probes[p.id]) for p in ports if p.id in probes])
        except InputError:
            probes = {}
            try:
                model = self._export(self.names, path)
            except InputError:
                model = self._export([e for e in self.names if self._can_be_exported(e, path)], path)
        return replace(calibration, model=model), probes

    def run(
        self, own: Calibration, fit: Optimum, open_simulator: OpenSimulator, *, undriven: bool
    ) -> tuple[dict[str, list[FloatArray]], dict[str, list[FloatArray]]]:
        """Return each expression over the recordings, by its name, and with ``undriven`` also without inputs."""
        model = own.model
        names = [name for name in self.names.values() if any(v.name == name for v in model.outputs)]
        found, rest = simulated_signals(own, names, fit, open_simulator), {}
        alive = own.parameters.revived(fit.coordinates, fit.free)
        if not np.array_equal(alive, fit.coordinates):
            with suppress(InputError):
                there = simulated_signals(
                    own, [*names, *own.data.outputs], replace(fit, coordinates=alive), open_simulator
                )
                found = {name: [*found[name], *_near(own.data, there, there[name])] for name in names}
        if undriven:
            with suppress(InputError):
                rest = simulated_signals(_undriven(own), names, fit, open_simulator)
        return found, rest

    def _export(self, expressions: Iterable[Expression], path: Path, probes: Sequence[tuple[Port, str]] = ()) -> Model:
        flat = self.flat
        for port, name in probes:
            flat = with_probe(flat, port, name, -1.0)
        for expression in expressions:
            flat = add_output(flat, self.names[expression], Call("+", (expression, NEGLIGIBLE_TERM)))
        return Model.load(export_flat(flat, path))

    def _can_be_exported(self, expression: Expression, path: Path) -> bool:
        try:
            self._export([expression], path)
        except InputError:
            return False
        return True


def simulated_signals(
    calibration: Calibration, names: Sequence[str], fit: Optimum, open_simulator: OpenSimulator
) -> dict[str, list[FloatArray]]:
    """Simulate variables of a model at a fit."""
    data = calibration.data.with_experiments(
        replace(e, outputs=tuple(names), measured=None, spread=None) for e in calibration.data.experiments
    )
    values = calibration.parameters.from_search(fit.coordinates)
    with open_simulator(replace(calibration, data=data).problem()) as simulator:
        run = simulator.simulate(values[None])
    if np.any(run.outcomes != Outcome.OK):
        raise InputError(f"{calibration.model.name}: cannot be simulated with its ports watched")
    return {name: [y[0, :, k] for y in run.outputs] for k, name in enumerate(names)}


def _terms(flat: FlatModel, port: Port) -> list[Expression]:
    """Return the additive terms of the balance of a port, in the unit of a law's output there."""
    if port.balance is None:
        return []
    if port.attachment == "series" and port.states and port.unit == flat.variable(port.states[0]).unit:
        return [Name(port.states[0])]
    if port.attachment in ("node", "series") and port.connectors:
        return [Name(f"{c}.{port.flow if port.attachment == 'node' else port.potential}") for c in port.connectors]
    if port.balance.row is not None:
        return list(port.balance.beside)
    equation = flat.equations[port.balance.equation]
    terms = [t for side in (equation.left, equation.right) for _, t in summands(side)]
    inside = f"{equation.component}." if equation.component else "."
    # flows at the connectors of a component may be larger than the terms in one of its equations
    flows = [Name(v.name) for v in flat.variables if v.flow and v.name.startswith(inside) and v.unit == port.unit]
    return [*(Call("/", (t, port.balance.scale)) for t in terms), *flows]


def recorded_inputs(data: MeasuredData, name: str) -> list[InputSignal]:
    """Return the signals of an input in the recordings that have it."""
    return [s for e in data.experiments for s in e.inputs if s.name == name]


def _nominals(
    port: Port,
    found: Mapping[str, list[FloatArray]],
    seen: Mapping[str, str],
    acting: Sequence[str],
    time: float,
    data: MeasuredData,
    start: float | None,
    larger: float,
) -> dict[str, float]:
    own = {signal: signal_nominal(found[name]) for signal, name in seen.items() if name in found}
    act = larger * max((_size(found, name) for name in acting), default=0.0)
    if port.kind in ("input", "output", "reading"):
        nominals = {"u_n": own.get("u", 0.0)}
        if port.kind == "input":
            inputs = recorded_inputs(data, port.id)
            if port.attachment != "input":
                simulated = zip(data.experiments, found.get(seen["u"], ()), strict=False)
                inputs = [InputSignal(seen["u"], e.time, y) for e, y in simulated]
            nominals = {"u_n": signal_nominal([s.values for s in inputs]), "w_n": relative_change(inputs, time)}
    else:
        kind = PORT_KINDS[port.kind]
        nominals = {f"{kind.acts}_n": act, **{f"{signal}_n": own.get(signal, 0.0) for signal in kind.signals}}
        if port.kind == "motion":
            place = own.get("x", nominals["v_n"] * time)
            nominals |= {"x_n": place, "x_w": place}
        elif port.kind == "storage":
            nominals["d_n"] = own.get("d", 0.0)
    nominals = {name: value if value > MIN_NOMINAL else 1.0 for name, value in nominals.items()}
    if port.kind == "motion" and "x" in own:
        low, high = np.quantile(np.concatenate(found[seen["x"]]), (1.0 - NOMINAL_QUANTILE, NOMINAL_QUANTILE))
        nominals |= {"x_w": 0.5 * float(high - low) or 1.0, "x_0": 0.5 * float(high + low)}
    if port.kind == "storage" and "h" in own and ("h_s" in own or port.units.get("h") in KELVIN):
        level = found[seen["h"]]
        if "h_s" in own:
            around = found[seen["h_s"]]
            mean = float(np.mean(np.concatenate(around)))
        else:
            # relative to its rest or initial value, so that a law is the same in K and in degC
            mean = start if start is not None else float(level[0][0])
            around = [np.array(mean)] * len(level)
        # Levels that were recorded have no simulations beyond the recordings.
        above = signal_nominal([y - z for y, z in zip(level, around, strict=False)]) or 1.0
        nominals |= {"h_n": above, "h_0": mean, "h_z": KELVIN.get(port.units.get("h", ""), 0.0)}
    for signal, name in seen.items():
        nominals |= visited_range(signal, found.get(name, ()))
        if found.get(name):
            nominals[f"{signal}_twice"] = share_visited_twice(found[name])
    if "v_high" in nominals and seen.get("x", "") in found and found[seen["x"]]:
        nominals |= possible_directions(found[seen["x"]], {name: nominals[name] for name in ("v_low", "v_high")})
    return nominals | {"t_n": time}
