"""Several runs at a time: what a run gives does not depend on those beside it, and is what it gives alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from runs import ran
from test_engine_isolation import BLOW_UP, EXPECTED, FINE, NOT_A_NUMBER, REFUSE_START, STIFFEN, trouble

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool
from aero_bayes.structure.attach import LawBlocks, attached
from aero_bayes.structure.coupled_fmu import couple
from aero_bayes.structure.open_ports import OpenModel

pytestmark = pytest.mark.fast

#: What expressions can hold: functions, powers, branches, an input beside the time.
RIG = """model Rig
  parameter Real k(min = 0) = 40 "Stiffness";
  parameter Real d(min = 0) = 0.5 "Damping";
  parameter Real q = 0.3 "Exponent";
  parameter Real a = 0.2 "Size of the ripple";
  parameter Real half = k / 2 "Depends on another";
  input Real u "Force";
  output Real x(start = 0.1, fixed = true) "A state";
  output Real power "No state";
  output Real side "No state, with a branch";
  Real v(start = 0, fixed = true);
  Real w(start = 1000, fixed = true) "Of another size";
equation
  der(x) = v;
  der(v) = u - half * sin(x) - FRICTION + a * sin(3 * time);
  der(w) = -1000 * (w - 1000 * exp(-q * x) * (1 + x ^ 2) ^ q) + tanh(v);
  power = v * u + log(1 + x ^ 2);
  side = noEvent(if x > 0 and not v > 0 then max(x, v) else sign(x) * min(abs(x), abs(v)));
end Rig;
"""
#: With kinks, at which the size of a step hangs on the last bit of its error.
FRICTIONS = {"smooth": "d * v", "kinks": "d * v * abs(v) - noEvent(if v > 0 then d * v else 0.5 * d * v)"}
TIME = np.linspace(0.0, 4.0, 301)
OUTPUTS = ("x", "power", "side", "w")


def both(source: Path, name: str) -> tuple[Model, Model]:
    """The model with and without lanes."""
    lanes = export_fmu(name, source.with_suffix(".fmu"), compiler="embedded", sources=source)
    with_lanes, single = Model.load(lanes), source.with_suffix(".single.fmu")
    bare = OpenModel(with_lanes, tuple(v.name for v in with_lanes.inputs), {}, {})
    couple(attached(bare, (), LawBlocks({}, source.parent)), single)  # a coupled FMU has none
    return with_lanes, Model.load(single)


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Model, Model]]:
    """Of both kinds of friction, each with and without lanes."""
    found = {}
    for kind, friction in FRICTIONS.items():
        source = tmp_path_factory.mktemp(kind) / "Rig.mo"
        source.write_text(RIG.replace("FRICTION", friction))
        found[kind] = both(source, "Rig")
    return found


def signals(kind: str) -> tuple[InputSignal, ...]:
    if kind == "held":
        return (InputSignal("u", np.array([0.0, 1.0, 2.5]), np.array([2.0, -3.0, 0.5])),)
    time = np.linspace(0.0, 3.8, 39)  # no segment of less than five samples, which single runs take otherwise
    level = 3.0 * np.sin(2.0 * np.maximum(time, time[1]))
    return (InputSignal("u", time, level, "hold" if kind == "moving" else "linear"),)


def pose(model: Model, kind: str) -> Problem:
    """Two recordings, of which the second one is longer sampled and starts elsewhere."""
    targets = (ParameterTarget("k"), ParameterTarget("d"), ParameterTarget("q"), StartTarget("v"), DelayTarget())
    measured = np.random.default_rng(0).standard_normal((TIME.size, len(OUTPUTS)))
    one = Experiment(TIME, OUTPUTS, signals(kind), measured=measured)
    sparse = Experiment(TIME[::10] ** 1.1, OUTPUTS[:2], signals("held"), {"x": -0.5}, measured[::10, :2])
    return Problem(model, (one, sparse), (targets, targets), settings=SolverSettings(1e-7, 1e-7))


def draw(count: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    values = np.array([40.0, 0.5, 0.3, 0.0, 0.05]) * np.exp(0.3 * rng.standard_normal((count, 5)))
    values[:, 3] = rng.standard_normal(count)
    return values


@pytest.mark.parametrize("instructions", ["", "baseline"])
@pytest.mark.parametrize(
    ("friction", "kind", "near"),
    [("smooth", "held", 1e-9), ("smooth", "moving", 1e-8), ("smooth", "linear", 1e-8), ("kinks", "held", 1e-4)],
)
def test_lanes_give_what_the_other_method_gives(rigs, here, friction, kind, near, instructions, monkeypatch):
    monkeypatch.setenv("AERO_BAYES_INSTRUCTIONS", instructions)
    values, noise = draw(21), np.array([0.5, 0.2, 0.1])
    found = []
    for model in rigs[friction]:
        with NativeSimulator(pose(model, kind), pool=here) as simulator:
            found.append((simulator.simulate(values), simulator.log_likelihood(values, noise)))
    for a, b in zip(*(f[0].outputs for f in found), strict=True):
        assert np.all(np.isfinite(b))
        span = np.ptp(b, axis=1, keepdims=True)
        assert np.max(np.abs(a - b) / span) <= near
    np.testing.assert_allclose(found[0][1].log_likelihood, found[1][1].log_likelihood, rtol=near)


def test_neighbours_change_no_bit(rigs, here, pool):
    problem, values = pose(rigs["kinks"][0], "moving"), draw(30)
    rng = np.random.default_rng(2)
    noise = np.array([0.5, 0.0, 0.0])
    with NativeSimulator(problem, pool=here) as simulator, NativeSimulator(problem, pool=pool) as elsewhere:
        whole = simulator.simulate(values)
        likelihood = simulator.log_likelihood(values, noise).log_likelihood
        assert np.array_equal(elsewhere.log_likelihood(values, noise).log_likelihood, likelihood)
        for _ in range(3):
            order = rng.permutation(30)
            again = simulator.simulate(values[order])
            for a, b in zip(whole.outputs, again.outputs, strict=True):
                assert np.array_equal(a[order], b)
        cuts = [0, 1, 2, 5, 13, 30]
        for first, last in pairwise(cuts):
            part = simulator.simulate(values[first:last])
            for a, b in zip(whole.outputs, part.outputs, strict=True):
                assert np.array_equal(a[first:last], b)


def test_rows_are_exchanged_where_a_pivot_is_small(tmp_path, here):
    source = tmp_path / "Swap.mo"
    source.write_text(
        """model Swap "1/(h gamma) - J has pivots that are small beside other entries of their columns"
  parameter Real k = 10;
  parameter Real g = 1;
  output Real x(start = 1, fixed = true);
  Real y(start = 0, fixed = true);
  Real z(start = 0, fixed = true);
equation
  der(x) = -g * x - k * y;
  der(y) = k * x - g * y + 1e-6 * z;
  der(z) = 1e6 * x - z;
end Swap;
"""
    )
    values = np.array([[1.0, 1.0], [30.0, 3.0], [0.0, 2.0], [1000.0, 1.0], [3.0, 10.0]])
    found = []
    for model in both(source, "Swap"):
        what = Experiment(np.linspace(0.0, 3.0, 11), ("x",))
        problem = Problem(model, (what,), ((ParameterTarget("k"), ParameterTarget("g")),))
        with NativeSimulator(problem, pool=here) as simulator:
            found.append(simulator.simulate(values).outputs[0])
            alone = np.concatenate([simulator.simulate(row[None]).outputs[0] for row in values])
        assert np.array_equal(alone, found[-1])
    assert np.all(np.isfinite(found[0]))
    np.testing.assert_allclose(*found, atol=1e-8)


def test_events_loops_and_other_tools_run_singly(exported, here):
    model = exported(
        """model Ball
  parameter Real e = 0.7;
  output Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = -9.81;
  when h < 0 then
    reinit(v, -e * pre(v));
  end when;
end Ball;
"""
    )
    problem = Problem(model, (Experiment(np.linspace(0.0, 1.0, 11), ("h",)),), ((ParameterTarget("e"),),))
    found = ran(problem, here, np.linspace(0.1, 0.9, 9)[:, None])
    fall = np.sqrt(2.0 / 9.81)
    before = found.outputs[0][:, 4, 0]  # at 0.4 s, before the first impact
    np.testing.assert_allclose(before, 1.0 - 0.5 * 9.81 * 0.4**2, atol=1e-7)
    after = 1.0 - fall
    expected = np.linspace(0.1, 0.9, 9) * 9.81 * fall * (0.5 - fall) - 0.5 * 9.81 * (0.5 - fall) ** 2
    assert after > 0.0
    np.testing.assert_allclose(found.outputs[0][:, 5, 0], expected, atol=1e-6)


CRASH_AT_START, HANG_AT_START = 25, 26
ENDS = {mode: EXPECTED[mode] for mode in (FINE, NOT_A_NUMBER, REFUSE_START, STIFFEN, BLOW_UP)} | {
    CRASH_AT_START: {Outcome.CRASHED},
    HANG_AT_START: {Outcome.TIMED_OUT},
}
LANES = {"defines": ("LANES", "NO_CALLBACK")}


@pytest.mark.long
def test_failing_lanes_leave_the_others_alone(test_fmu):
    problem = trouble(test_fmu, **LANES)
    modes = np.array([m for mode in ENDS for m in (FINE, mode, FINE, FINE)], dtype=float)
    with WorkerPool(1) as workers, NativeSimulator(problem, pool=workers) as simulator:
        alone = simulator.simulate(np.zeros((1, 1))).outputs[0][0]
        found = simulator.simulate(modes[:, None])
    np.testing.assert_allclose(alone[:, 0], np.exp(-problem.experiments[0].time), atol=1e-5)
    for mode, outcome, out in zip(modes, found.outcomes[:, 0], found.outputs[0], strict=True):
        assert Outcome(outcome) in ENDS[int(mode)], mode
        assert np.array_equal(out, alone) if mode == FINE else np.all(np.isnan(out))


def test_a_run_out_of_time_ends_alone(test_fmu, here):
    problem = trouble(test_fmu, **LANES)
    settings = SolverSettings(time_limit=0.05, max_steps=1_000_000_000)
    found = ran(replace(problem, settings=settings), here, np.array([[FINE], [STIFFEN], [FINE]], dtype=float))
    assert list(found.outcomes[[0, 2], 0]) == [Outcome.OK, Outcome.OK]
    assert Outcome(found.outcomes[1, 0]) in EXPECTED[STIFFEN]
