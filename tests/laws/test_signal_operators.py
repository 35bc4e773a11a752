"""Laws at a recorded input act on its signal, those at an output on its samples: beside the same laws in the equations,
and closed form."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim
from written_laws import written_flat

from aero_bayes.laws.candidates import place_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.fmu_family import FmuFamily, FmuPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    Interpolation,
    Outcome,
    ParameterTarget,
    Problem,
    ProcessNoise,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import operators_in_use
from aero_bayes.simulation.workers import WorkerPool

SOURCE = """model Arm "A rotor on a spring, and a shunt through which its drive is read"
  parameter Real k(min = 0) = 40;
  input Real u;
  input Real wind;
  output Real angle;
  output Real shunt = 0.5 * u + 0.1 * v;
  Real x(start = 0.2, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = u + wind - k * x - 1.5 * v;
  angle = x;
end Arm;
"""
TIME = np.linspace(0.0, 8.0, 401)
STATIC = ("curve", "dead_zone", "dead_zone_by_side", "gain", "offset", "saturation", "saturation_by_side", "square_law")


@pytest.fixture(scope="module")
def here() -> Iterator[WorkerPool]:
    with WorkerPool(0) as pool:
        yield pool


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> ModelicaFamily:
    folder = tmp_path_factory.mktemp("arm")
    (folder / "Arm.mo").write_text(SOURCE, encoding="utf-8")
    return placed_family("Arm", folder / "Arm.mo")


def placed_family(name: str, source: Path) -> ModelicaFamily:
    return with_laws(ModelicaFamily(LawPlaces(name, (source,)), source.parent / "built"))


def with_laws(found: ModelicaFamily) -> ModelicaFamily:
    sizes = {"u_n": 1.5, "t_n": 0.4, "v_n": 0.5, "x_n": 0.3, "x_w": 0.3, "f_n": 2.0}
    ports = {p.id: sizes for p in found.places.ports}
    for placed in place_laws(found.places.candidates, found.places.taken_names(), ports, free_starts=True):
        found.placed[placed.id] = placed
    return found


def values_of(found: ModelicaFamily, id_: str) -> dict[str, float]:
    """Of the parameters of a law: where a search starts; starts somewhere beside zero."""
    placed = found.placed[id_]
    values = {p.name: placed.limits(p)["nominal"] for p in placed.parameters()}
    return {placed.names[name]: 0.1 if name.startswith("start") else value for name, value in values.items()}


def inside(found: ModelicaFamily, ids: list[str], out: Path) -> Model:
    """The model with laws in its equations, as they are written."""
    placed = [found.placed[id_] for id_ in ids]
    flat = written_flat(found.places.base, found.places.sources, placed, out.with_suffix(""))
    return Model.load(export_flat(flat, out))


def signals(interpolation: Interpolation) -> tuple[InputSignal, ...]:
    smooth = 1.8 * np.sin(1.7 * TIME) + 0.9 * np.sin(7.3 * TIME + 1.0)
    held = np.repeat(np.random.default_rng(5).uniform(-2.0, 2.0, 41), 10)[: TIME.size]
    u = smooth if interpolation == "linear" else held
    return InputSignal("u", TIME, u, interpolation), InputSignal("wind", TIME, np.cos(TIME), "linear")


def posed(model: Model, given: dict[str, float], interpolation: Interpolation) -> Problem:
    targets = (*map(ParameterTarget, given), StartTarget(model.states[0].name), DelayTarget("u"))
    experiment = Experiment(TIME, ("angle", "shunt"), signals(interpolation))
    return Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-9, 1e-9, 400_000, 60.0))


def run(problem: Problem, given: dict[str, float], pool: WorkerPool, delay: float = 0.013):
    values = np.array([[*given.values(), 0.2, delay]])
    with open_simulator(problem, pool=pool) as simulator:
        found = simulator.simulate(values, active=range(values.size))
    assert found.outcomes[0, 0] == Outcome.OK
    return found.outputs[0][0], found.sensitivities[0][0]


@pytest.mark.parametrize(
    "ids", [*([f"{law}@u"] for law in STATIC), ["dead_zone@u", "gain@u", "saturation@u"], ["dead_zone@u", "lag@u"]]
)
@pytest.mark.parametrize(("interpolation", "tolerance"), [("hold", 1e-6), ("linear", 1e-4)])
def test_laws_at_a_recorded_input_are_the_written_laws(ids, interpolation, tolerance, arm, here, tmp_path):
    """Static ones act on the signal, as one where they are behind one another; what is behind a lag is solved."""
    ids = [id_ for id_ in arm.placed if id_ in ids]
    given = {name: x for id_ in ids for name, x in values_of(arm, id_).items()}
    problem = posed(arm.with_candidates(ids).model, given, interpolation)
    if "lag@u" not in ids:
        assert [(o.signal, set(o.parameters)) for o in operators_in_use(problem).values()] == [("u", set(given))]
    y, slopes = run(problem, given, here)
    expected, expected_slopes = run(posed(inside(arm, ids, tmp_path / "in.fmu"), given, interpolation), given, here)
    assert np.all(np.abs(y - expected).max(axis=0) <= tolerance * np.ptp(expected, axis=0))
    size = np.abs(expected_slopes).max(axis=0)
    assert np.all(np.abs(slopes - expected_slopes).max(axis=0) <= 50.0 * tolerance * size + 1e-9)


def remembered(law: str, time: np.ndarray, u: np.ndarray, given: dict[str, float]) -> np.ndarray:
    """What a rate limit or a play makes of a signal on a grid so fine that it may be taken as held."""
    *shape, start = given.values()
    z, y = u[0] + start, np.empty_like(u)
    for k, now in enumerate(u):
        if law == "rate_limit":
            step = (time[k] - time[k - 1]) / shape[0] if k else 0.0
            z += min(max(now - z, -step), step)
            y[k] = z
        else:
            z = min(max(z, now - shape[1]), now + shape[1])
            y[k] = now - shape[0] * (now - z)
    return y


def driven(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """The arm's angle for a force of line segments, by SciPy."""
    states = ([[0.0, 1.0], [-40.0, -1.5]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    return lsim(states, force, time, [0.2, 0.0])[1]


@pytest.mark.parametrize("law", ["rate_limit", "hysteresis"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_law_that_remembers_a_recorded_input_acts_exactly(law, interpolation, arm, here):
    """Beside a scan of a grid a thousand times as fine and SciPy; its slopes beside differences."""
    id_ = f"{law}@u"
    given = values_of(arm, id_)
    problem = posed(arm.with_candidates([id_]).model, given, interpolation)
    assert [o.memory for o in operators_in_use(problem).values()] == ["rate_limit" if law == "rate_limit" else "play"]
    y, slopes = run(problem, given, here, delay=0.0)
    u, wind = problem.experiments[0].inputs
    fine = np.linspace(0.0, 8.0, 400_001)
    at = np.interp(fine, TIME, u.values) if interpolation == "linear" else u.values[(np.arange(fine.size) // 1000)]
    expected = driven(fine, remembered(law, fine, at, given) + np.interp(fine, TIME, wind.values))
    np.testing.assert_allclose(y[:, 0], expected[::1000], atol=5e-5 * np.ptp(y[:, 0]))
    for k, name in enumerate(given):
        step = 1e-4 * given[name]
        sides = [run(problem, {**given, name: given[name] + s}, here, delay=0.0)[0] for s in (step, -step)]
        np.testing.assert_allclose(
            slopes[:, :, k], (sides[0] - sides[1]) / (2 * step), atol=2e-3 * np.abs(slopes[:, :, k]).max()
        )


def test_a_fit_can_leave_a_start_at_the_input_itself(arm, here):
    """There a start has an effect that grows with its square: its slope must not be zero, or a fit would stay."""
    given = {**values_of(arm, "rate_limit@u"), "start_z": 0.0}
    model = arm.with_candidates(["rate_limit@u"]).model
    _, slopes = run(posed(model, given, "hold"), given, here, delay=0.0)
    y, _ = run(posed(model, {**given, "start_z": 0.1}, "hold"), {**given, "start_z": 0.1}, here, delay=0.0)
    without, _ = run(posed(model, given, "hold"), given, here, delay=0.0)
    column = slopes[:, 0, list(given).index("start_z")]
    assert np.abs(column).max() > 1e-6
    assert column @ (y - without)[:, 0] > 0.0
    off = {**given, "r": 0.0}
    _, slopes = run(posed(model, off, "hold"), off, here, delay=0.0)
    assert not slopes[:, :, : len(off)].any()


@pytest.mark.parametrize("law", ["rate_limit", "hysteresis"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_law_that_remembers_its_input_is_the_written_law_but_for_its_rounding(
    law, interpolation, arm, here, tmp_path
):
    id_ = f"{law}@u"
    given = values_of(arm, id_)
    problem = posed(arm.with_candidates([id_]).model, given, interpolation)
    y, _ = run(problem, given, here)
    kept, _ = run(replace(problem, model=replace(problem.model, operators=())), given, here)
    written, _ = run(posed(inside(arm, [id_], tmp_path / "in.fmu"), given, interpolation), given, here)
    np.testing.assert_allclose(kept, written, atol=1e-6 * np.ptp(written))
    assert np.all(np.abs(y - written).max(axis=0) <= 1e-4 * np.ptp(written, axis=0))


def test_an_input_that_is_not_recorded_keeps_its_law_in_the_equations(arm, here):
    given = values_of(arm, "offset@u")
    offer = arm.with_candidates(["offset@u"]).model
    problem = posed(offer, given, "hold")
    (experiment,) = problem.experiments
    bare = replace(
        problem,
        experiments=(replace(experiment, inputs=()),),
        targets=(tuple(None if isinstance(t, DelayTarget) else t for t in problem.targets[0]),),
    )
    assert not operators_in_use(bare)
    y, _ = run(bare, given, here)
    ((_, offset),) = given.items()
    speed = np.gradient(y[:, 0], TIME, edge_order=2)
    np.testing.assert_allclose(y[:, 1] - 0.5 * offset, 0.1 * speed, atol=2e-3)
    assert not operators_in_use(replace(problem, process=ProcessNoise({"v": 0.1})))


@pytest.mark.parametrize("law", ["dead_zone@u", "saturation@shunt"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_what_is_linear_beside_a_static_law_is_exact_at_any_tolerance(law, interpolation, arm, here):
    """A law before the equations, or behind them, does not make them nonlinear."""
    given = values_of(arm, law)
    problem = posed(arm.with_candidates([law]).model, given, interpolation)
    exact, exact_slopes = run(problem, given, here)
    y, slopes = run(replace(problem, settings=SolverSettings(1e-3, 1e-3)), given, here)
    np.testing.assert_allclose(y, exact, atol=1e-9 * np.ptp(exact))
    np.testing.assert_allclose(slopes, exact_slopes, atol=1e-7 * np.abs(exact_slopes).max())


@pytest.mark.parametrize(
    ("ids", "raw"),
    [
        (["gain@angle"], True),
        (["saturation@shunt"], True),
        (["gain@shunt", "offset@shunt", "saturation@shunt", "unsigned@angle"], True),
        (["gain@shunt", "lag@shunt"], False),
    ],
)
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_laws_without_states_at_an_output_act_on_its_samples(ids, raw, interpolation, arm, here, tmp_path):
    """They are the laws in the equations to rounding; what is before a lag stays there."""
    given = {k: v for id_ in ids for k, v in values_of(arm, id_).items()}
    problem = posed(arm.with_candidates(ids).model, given, interpolation)
    last = ids[-1].partition("@")[2]
    assert any(o.signal == last for o in operators_in_use(problem).values()) is raw
    y, slopes = run(problem, given, here)
    kept = replace(problem, model=replace(problem.model, operators=()))
    y_kept, slopes_kept = run(kept, given, here)
    np.testing.assert_allclose(y, y_kept, atol=1e-8 * np.ptp(y_kept))
    np.testing.assert_allclose(slopes, slopes_kept, atol=1e-6 * np.abs(slopes_kept).max())
    y_written, slopes_written = run(posed(inside(arm, ids, tmp_path / "in.fmu"), given, interpolation), given, here)
    np.testing.assert_allclose(y, y_written, atol=1e-6 * np.ptp(y_written))
    np.testing.assert_allclose(slopes, slopes_written, atol=1e-4 * np.abs(slopes_written).max())


TWO_LAGS = """model Lags
  input Real u;
  output Real a(start = 0, fixed = true);
  output Real b(start = 0, fixed = true);
  output Real sum = a + b;
equation
  der(a) = 2 * (u - a);
  der(b) = 0.5 * (u - b);
end Lags;
"""


@pytest.fixture(scope="module")
def lags(tmp_path_factory: pytest.TempPathFactory) -> ModelicaFamily:
    folder = tmp_path_factory.mktemp("lags")
    (folder / "Lags.mo").write_text(TWO_LAGS, encoding="utf-8")
    return placed_family("Lags", folder / "Lags.mo")


@pytest.mark.parametrize("ids", [["gain@output_a+output_b+sum"], ["lag@output_b", "gain@output_a+output_b+sum"]])
def test_laws_that_share_a_parameter_have_its_slope_at_all_their_places(ids, lags, here):
    offer = lags.with_candidates(ids).model
    given = {k: v for id_ in ids for k, v in values_of(lags, id_).items()}
    experiment = Experiment(TIME, ("a", "b", "sum"), (InputSignal("u", TIME, np.sin(TIME)),))
    targets = (tuple(map(ParameterTarget, given)),)
    problem = Problem(offer, (experiment,), targets, settings=SolverSettings(1e-9, 1e-9))
    assert len(operators_in_use(problem)) == 3
    values, shared = np.array([*given.values()]), [*given].index("g_output_a_output_b_sum")
    step = 1e-5 * (np.arange(values.size) == shared)
    with open_simulator(problem, pool=here) as simulator:
        slopes = simulator.simulate(values[None], active=[shared]).sensitivities[0][0][..., 0]
        high, low = simulator.simulate(np.stack([values + step, values - step])).outputs[0]
    np.testing.assert_allclose(slopes, (high - low) / 2e-5, atol=1e-7)


@pytest.mark.parametrize("law", ["gain@angle", "delay@angle"])
def test_laws_at_an_output_act_once_where_slopes_are_differences(law, here, tmp_path):
    """A state that jumps leaves the engine no derivatives."""
    stop = "  when x < -0.03 then\n    reinit(v, -0.5 * pre(v));\n  end when;\n"
    (tmp_path / "Arm.mo").write_text(SOURCE.replace("  angle = x;\n", f"  angle = x;\n{stop}"), encoding="utf-8")
    found = placed_family("Arm", tmp_path / "Arm.mo")
    given = values_of(found, law)
    problem = posed(found.with_candidates([law]).model, given, "hold")
    with open_simulator(problem, pool=here) as simulator:
        values = np.array([[*given.values(), 0.2, 0.0]])
        plain, beside = simulator.simulate(values), simulator.simulate(values, active=range(3))
    np.testing.assert_allclose(beside.outputs[0], plain.outputs[0], atol=1e-9)


#: Laws at the arm that leave it linear, or not; its delay comes with a law behind it.
BESIDE = {
    "linear": [],
    "static behind": ["saturation@angle"],
    "nonlinear": ["cubic_stiffness@v"],
    "step": ["coulomb_friction@v"],
}


def late(found: ModelicaFamily, beside: list[str], interpolation: Interpolation) -> tuple[Problem, dict[str, float]]:
    """The arm with a late angle, and laws beside its delay; and their values."""
    ids = ["delay@angle", *beside]
    given = {k: v for id_ in ids for k, v in values_of(found, id_).items()} | {"T_d_angle": 0.137}
    given |= {"s_angle": 4.0} if "s_angle" in given else {}
    return posed(found.with_candidates(ids).model, given, interpolation), given


@pytest.mark.parametrize("beside", BESIDE.values(), ids=BESIDE)
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_delayed_reading_of_a_state_is_the_state_before_the_delay(beside, interpolation, arm, here):
    """Beside a run without the delay whose samples are earlier; its slopes beside differences."""
    problem, given = late(arm, beside, interpolation)
    (operator,) = operators_in_use(problem).values()
    assert operator.memory == "delay"
    y, slopes = run(problem, given, here)
    free = {k: v for k, v in given.items() if k != "T_d_angle"}
    (experiment,) = problem.experiments
    bare = posed(arm.with_candidates(beside).model, free, interpolation)
    earlier = TIME[TIME > 0.137] - 0.137
    shifted = replace(experiment, time=np.concatenate([[0.0], earlier, [8.0]]))
    expected = run(replace(bare, experiments=(shifted,)), free, here)[0][:-1, 0]
    expected = np.concatenate([np.full(TIME.size - earlier.size, expected[0]), expected[1:]])
    np.testing.assert_allclose(y[:, 0], expected, atol=1e-8 * np.ptp(expected))
    np.testing.assert_allclose(y[:, 1], run(bare, free, here)[0][:, 1], atol=1e-8 * np.ptp(y[:, 1]))
    undelayed = run(problem, given | {"T_d_angle": 0.0}, here)[0]
    np.testing.assert_allclose(undelayed, run(bare, free, here)[0], atol=1e-12)
    assert np.array_equal(run(problem, given | {"T_d_angle": -0.1}, here)[0], undelayed)
    assert not slopes[: TIME.size - earlier.size, 0, list(given).index("T_d_angle")].any()
    for k, name in enumerate(given):
        step = 1e-4 * given[name]
        high, low = (run(problem, {**given, name: given[name] + s}, here)[0] for s in (step, -step))
        size = np.abs(slopes[..., k]).max()
        np.testing.assert_allclose(slopes[..., k], (high - low) / (2 * step), atol=1e-5 * size + 1e-9)


@pytest.mark.parametrize("of_fmu", [False, True])
def test_readings_have_delays_of_their_own(of_fmu, lags, here, tmp_path):
    """Two lags after a step, beside closed form; their sum is not late."""
    if of_fmu:
        fmu = lags.base_model().path
        lags = with_laws(FmuFamily(FmuPlaces("Lags", fmu=fmu), tmp_path))
    ids = [id_ for id_ in lags.placed if id_ in ("delay@output_a", "delay@output_b", "delay@a", "delay@b")]
    model = lags.with_candidates(ids).model
    names = [name for id_ in ids for name in values_of(lags, id_)]
    time, late = np.linspace(0.0, 4.0, 1001), np.array([0.3015, 1.7015])
    experiment = Experiment(time, ("a", "b", "sum"), (InputSignal("u", np.array([0.0, 1.0]), np.array([0.0, 1.0])),))
    targets = (tuple(map(ParameterTarget, names)),)
    problem = Problem(model, (experiment,), targets, settings=SolverSettings(1e-10, 1e-10))
    assert len(operators_in_use(problem)) == 2
    with open_simulator(problem, pool=here) as simulator:
        found = simulator.simulate(late[None], active=[0, 1])
    rates = np.array([2.0, 0.5])
    since, moves = (time[:, None] - 1.0 - by for by in (late, 0.0))
    decay = np.exp(-rates * np.maximum(since, 0.0))
    y, slopes = found.outputs[0][0], found.sensitivities[0][0]
    np.testing.assert_allclose(y[:, :2], 1.0 - decay, atol=1e-8)
    np.testing.assert_allclose(y[:, 2], np.sum(1.0 - np.exp(-rates * np.maximum(moves, 0.0)), axis=1), atol=1e-8)
    expected = np.zeros_like(slopes)
    expected[:, [0, 1], [0, 1]] = np.where(since > 0.0, -rates * decay, 0.0)
    np.testing.assert_allclose(slopes, expected, atol=1e-7)


@pytest.mark.parametrize("beside", [[], ["saturation@angle"], ["cubic_stiffness@v"]])
def test_a_delayed_reading_is_the_written_law_where_it_is_smooth(beside, arm, here, tmp_path):
    problem, given = late(arm, beside, "linear")
    given["T_d_angle"] = 0.05
    y, slopes = run(problem, given, here)
    written, by = run(posed(inside(arm, ["delay@angle", *beside], tmp_path / "in.fmu"), given, "linear"), given, here)
    np.testing.assert_allclose(y, written, atol=1e-4 * np.ptp(written))
    np.testing.assert_allclose(slopes[10:], by[10:], atol=1e-2 * np.abs(by).max())


def test_a_delay_stays_in_the_equations_with_process_noise_and_of_what_is_no_state(arm, lags, here, tmp_path):
    """So do those that share their time with such a one."""
    assert not lags.with_candidates(["delay@output_a+output_b+sum"]).model.operators
    problem, _ = late(arm, [], "linear")
    assert not operators_in_use(replace(problem, process=ProcessNoise({"v": 0.1})))
    for ids in (["delay@angle", "lag@angle"], ["delay@shunt"]):
        given = {k: v for id_ in ids for k, v in values_of(arm, id_).items()}
        problem = posed(arm.with_candidates(ids).model, given, "linear")
        assert not operators_in_use(problem)
        written = posed(inside(arm, ids, tmp_path / f"{len(ids)}.fmu"), given, "linear")
        np.testing.assert_allclose(run(problem, given, here)[0], run(written, given, here)[0], atol=1e-6)


INTEGRATOR = """model Tank
  input Real u;
  output Real level = h;
  Real h(start = 0, fixed = true);
equation
  der(h) = u;
end Tank;
"""


def test_an_integrator_collects_exactly_what_a_dead_zone_lets_through(here, tmp_path):
    """Over a triangle between -2 and 2, by the antiderivative of the rounded dead zone."""
    (tmp_path / "Tank.mo").write_text(INTEGRATOR, encoding="utf-8")
    found = placed_family("Tank", tmp_path / "Tank.mo")
    model = found.with_candidates(["dead_zone@u"]).model
    time = np.arange(0.0, 9.0)
    u = np.array([-2.0, 2.0, -2.0, 1.1, 1.1, -0.3, 0.2, 2.0, 0.9])
    experiment = Experiment(time, ("level",), (InputSignal("u", time, u, "linear"),))
    width, smooth = 0.7, 1e-3 * 1.5
    problem = Problem(model, (experiment,), ((ParameterTarget("u_d"),),), settings=SolverSettings(1e-9, 1e-9))
    with open_simulator(problem, pool=here) as simulator:
        found_level = simulator.simulate(np.array([[width]]), active=[0])

    def integral(x: np.ndarray) -> np.ndarray:
        def of_root(z: np.ndarray) -> np.ndarray:
            return 0.5 * (z * np.hypot(z, smooth) + smooth**2 * np.arcsinh(z / smooth))

        return 0.5 * x**2 + 0.5 * (of_root(x - width) - of_root(x + width))

    def law(x: np.ndarray) -> np.ndarray:
        return x + 0.5 * (np.hypot(x - width, smooth) - np.hypot(x + width, smooth))

    rising = np.diff(u)
    flat = rising == 0.0
    mean = np.where(flat, law(u[:-1]), np.diff(integral(u)) / np.where(flat, 1.0, rising))
    expected = np.concatenate([[0.0], np.cumsum(mean)])
    np.testing.assert_allclose(found_level.outputs[0][0, :, 0], expected, atol=1e-5)
