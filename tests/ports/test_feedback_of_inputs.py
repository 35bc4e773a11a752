"""A control loop inside a model: its controller's output is a place where something may be missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from closed_form import held
from written_laws import agree, uses_at

from aero_bayes.data import Recording
from aero_bayes.laws.candidates import ports_with_laws
from aero_bayes.laws.law import shipped_laws
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.modelica.rumoca_front import load_flat

AXIS = """model Axis "A position loop"
  parameter Real J(unit = "kg", min = 0) = 0.6;
  parameter Real b(unit = "N.s/m", min = 0) = 1;
  parameter Real K_p(unit = "N/m") = 40;
  parameter Real K_i(unit = "N/(m.s)") = 10;
  parameter Real K_d(unit = "N.s/m") = 4;
  input Real r(unit = "m") "Set point";
  output Real y(unit = "m", start = 0, fixed = true);
  output Real watched(unit = "N") "What acts on the axis";
protected
  Real v(unit = "m/s", start = 0, fixed = true);
  Real z(unit = "m.s", start = 0, fixed = true) "Integral of the error";
  Real e(unit = "m") = r - y;
  Real u(unit = "N") "What the controller asks for";
  Real twice(unit = "m");
equation
  twice = 2*r;
  der(z) = e;
  u = K_p*e + K_i*z - K_d*v;
  der(y) = v;
  J*der(v) = u - b*v;
  watched = u - 0*twice;
end Axis;
"""

BLOCKS = """package Blocks
  connector In = input Real;
  connector Out = output Real;
  block PI
    In r;
    In y;
    Out u;
    parameter Real K_p = 5;
    parameter Real K_i(unit = "1/s") = 2;
    Real z(start = 0, fixed = true);
  equation
    der(z) = r - y;
    u = K_p*(r - y) + K_i*z;
  end PI;
  block Plant
    In u;
    Out y(start = 0, fixed = true);
    parameter Real K = 1.2;
    parameter Real T(unit = "s") = 3;
  equation
    T*der(y) = K*u - y;
  end Plant;
  model Rig "A plant with its controller"
    In r;
    Out y;
    PI pi;
    Plant plant;
  equation
    connect(r, pi.r);
    connect(plant.y, pi.y);
    connect(pi.u, plant.u) annotation (Line(points = {{0, 0}, {10, 0}}));
    connect(plant.y, y);
  end Rig;
end Blocks;
"""


def written(tmp_path: Path) -> Path:
    (tmp_path / "Axis.mo").write_text(AXIS, encoding="utf-8")
    return tmp_path / "Axis.mo"


def test_signals_of_a_loop_are_ports_and_what_is_only_fed_in_is_none(tmp_path):
    ports = {p.id: p for p in ports_with_laws(load_flat("Axis", [written(tmp_path)]), shipped_laws())}
    assert {id_ for id_, p in ports.items() if p.attachment == "signal"} == {"e", "u"}
    assert (ports["u"].kind, ports["u"].unit) == ("input", "N")
    assert set(ports["u"].states) == {"y", "v", "z"}
    assert ports["u"].laws == ports["r"].laws


@pytest.mark.parametrize(
    "ids", [("saturation@u",), ("dead_zone@u", "gain@u", "coulomb_friction@v"), ("offset@y", "lag@e", "rate_limit@u")]
)
def test_what_is_written_at_a_signal_acts_like_what_was_judged(ids, laws, blocks, tmp_path, rng):
    source = written(tmp_path)
    made = agree("Axis", [source], uses_at(load_flat("Axis", [source]), laws, *ids), blocks, tmp_path, rng)
    # what is asked for stays as it was written, at least its equation
    assert "u = K_p*" in made.text


@pytest.mark.parametrize("ids", [("saturation@plant.u",), ("dead_zone@plant.u", "gain@plant.u"), ("lag@pi.y",)])
def test_what_blocks_pass_on_is_a_port_and_its_connection_is_parted(ids, laws, blocks, tmp_path, rng):
    (tmp_path / "Blocks.mo").write_text(BLOCKS, encoding="utf-8")
    flat = load_flat("Blocks.Rig", [tmp_path / "Blocks.mo"])
    assert {p.id for p in ports_with_laws(flat, laws) if p.attachment == "signal"} == {"plant.u", "pi.y"}
    made = agree("Blocks.Rig", [tmp_path / "Blocks.mo"], uses_at(flat, laws, *ids), blocks, tmp_path, rng)
    inner = ids[0].partition("@")[2]
    assert f"  {inner} = {ids[0].partition('@')[0]}.y;" in made.text
    assert "connect(r, pi.r);" in made.text


INTEGRATORS = """package Chain
  connector In = input Real;
  connector Out = output Real;
  block Integrator
    In u;
    Out y(start = 0, fixed = true);
    parameter Real k = 1;
  equation
    der(y) = k*u;
  end Integrator;
  model Rig "A swing in blocks"
    In u;
    Out y;
    Integrator rate;
    Integrator level(k = GAIN);
  equation
    rate.u = 2.0*u - 0.8*rate.y - 1.8*level.y;
    connect(rate.y, level.u);
    connect(level.y, y);
  end Rig;
end Chain;
"""


def test_what_a_block_integrates_from_a_state_is_its_position(laws, blocks, modelica, tmp_path, rng):
    source = modelica(INTEGRATORS.replace("GAIN", "1"))
    flat = load_flat("Chain.Rig", [source])
    port = next(p for p in ports_with_laws(flat, laws) if p.id == "rate.y")
    signals = {"v": "rate.y", "x": "level.y", "load": "2 * u - 0.8 * rate.y - 1.8 * level.y"}
    assert (port.kind, port.signals) == ("motion", signals)
    agree("Chain.Rig", [source], uses_at(flat, laws, "cubic_stiffness@rate.y"), blocks, tmp_path, rng)
    # with a gain of its own it is a level like any other
    source.write_text(INTEGRATORS.replace("GAIN", "3"), encoding="utf-8")
    kinds = {p.id: p.kind for p in ports_with_laws(load_flat("Chain.Rig", [source]), laws)}
    assert (kinds["rate.y"], kinds["level.y"]) == ("storage", "storage")


LIMIT, NOISE = 15.0, 0.002


def motion(name: str, seed: int) -> Recording:
    """An axis whose force is limited, the controller's integral going on: fourth-order Runge-Kutta."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, -0.4, 0.0, 0.4, 1.0], 8), 80)

    def slope(x, aim):
        error = aim - x[0]
        force = np.clip(40.0 * error + 10.0 * x[2] - 4.0 * x[1], -LIMIT, LIMIT)
        return np.array([x[1], (force - 2.0 * x[1]) / 0.5, error])

    y = held(slope, np.zeros(3), r, 0.01, 20)[:, 0]
    return Recording(name, 0.01 * np.arange(r.size), {"r": r}, {"y": y + rng.normal(0.0, NOISE, r.size)})


@pytest.mark.long
def test_the_limit_of_an_actuator_within_a_loop_is_found(tmp_path):
    settings = LoopSettings(
        max_effects=2, parameters=("J", "b"),
        laws=("saturation", "dead_zone", "coulomb_friction"), cache=tmp_path / "fmu",
    )  # fmt: skip
    result = close_loop(
        [motion("a", 61)],
        [motion("b", 62)],
        model=written(tmp_path),
        settings=settings,
        workers=0,
    )
    assert [effect.id for effect in result.effects] == ["saturation@u"]
    assert 1.0 / result.effects[0].parameters[0].value == pytest.approx(LIMIT, rel=0.02)
    assert result.predicted_after.pooled("test")["y"] < 1.1 * NOISE
    assert result.predicted_before.pooled("test")["y"] > 5.0 * NOISE


CASCADE = """model Cascade "A filter, an amplifier and a second filter"
  parameter Real T_1(unit = "s", min = 0) = 0.12;
  parameter Real T_2(unit = "s", min = 0) = 0.25;
  parameter Real K = 1;
  input Real u(unit = "V");
  output Real y(unit = "V", start = 0, fixed = true);
  Real x(unit = "V", start = 0, fixed = true);
  Real g(unit = "V") "What the first filter hands on";
equation
  T_1*der(x) + x = u;
  g = K*x;
  T_2*der(y) + y = g;
end Cascade;
"""


def cascade(name: str, seed: int) -> Recording:
    """A first filter whose output an amplifier limits at -0.8 and 0.5 V: fourth-order Runge-Kutta, the input held."""
    rng = np.random.default_rng(seed)
    u, h = np.repeat(rng.uniform(-1.5, 1.5, 150), 12), 0.02

    def slope(x, level):
        return np.array([(level - x[0]) / 0.1, (np.clip(1.1 * x[0], -0.8, 0.5) - x[1]) / 0.3])

    y = held(slope, np.zeros(2), u, h, 4)[:, 1]
    return Recording(name, h * np.arange(u.size), {"u": u}, {"y": y + rng.normal(0.0, NOISE, u.size)})


def test_what_a_part_hands_on_is_a_port_where_nothing_comes_back(modelica):
    source = modelica(CASCADE)
    ports = {p.id: p for p in ports_with_laws(load_flat("Cascade", [source]), shipped_laws())}
    assert [id_ for id_, p in ports.items() if p.attachment == "signal"] == ["g"]
    assert ports["g"].laws == ports["u"].laws
    assert ports["g"].states == ("x",)
    # once the second filter loads the first it is no signal any more
    source.write_text(CASCADE.replace("x = u;", "x = u - 0.1*y;"), encoding="utf-8")
    assert not [p for p in ports_with_laws(load_flat("Cascade", [source]), shipped_laws()) if p.attachment == "signal"]


@pytest.mark.long
def test_a_limit_that_differs_by_side_is_found_as_one_law(modelica, tmp_path):
    source = modelica(CASCADE)
    settings = LoopSettings(
        max_effects=3, parameters=("T_1", "T_2", "K"),
        laws=("saturation", "saturation_by_side", "dead_zone", "offset", "overflow"), cache=tmp_path / "fmu",
    )  # fmt: skip
    result = close_loop([cascade("a", 63)], [cascade("b", 64)], model=source, settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["saturation_by_side@g"]
    s, a = (p.value for p in result.effects[0].parameters)
    assert 1.0 / (s * (1.0 + a)) == pytest.approx(0.5, rel=0.02)
    assert 1.0 / (s * (1.0 - a)) == pytest.approx(0.8, rel=0.02)
    assert result.predicted_after.pooled("test")["y"] < 1.1 * NOISE
    assert result.predicted_before.pooled("test")["y"] > 5.0 * NOISE


FILTERS = """model Filters "Two filters in a row, by their matrices"
  parameter Real a(unit = "1/s", min = 0) = 9;
  parameter Real A[2, 2](each unit = "1/s") = {{-a, 0}, {5, -5}};
  parameter Real B[2](each unit = "1/s") = {a, 0};
  parameter Real C[2] = {0.3, 0.7};
  input Real u(unit = "V");
  output Real y(unit = "V");
  Real x[2](each unit = "V", each start = 0, each fixed = true);
  Real z[2](each unit = "V", each start = 0, each fixed = true);
  Real w(unit = "V") "Between the filters";
equation
  der(x) = A*x + B*u;
  w = C*x;
  der(z) = A*z + B*w;
  y = z[2];
end Filters;
"""


@pytest.mark.parametrize(("given", "states"), [("C*x", ("x[1]", "x[2]")), ("x[2]", ("x[2]",)), ("-x[2]", ("x[2]",))])
def test_what_vectors_give_and_a_state_by_another_name_are_handed_on(
    given, states, laws, blocks, modelica, tmp_path, rng
):
    source = modelica(FILTERS.replace("w = C*x", f"w = {given}"))
    flat = load_flat("Filters", [source])
    (port,) = (p for p in ports_with_laws(flat, laws) if p.attachment == "signal")
    assert (port.id, port.unit, port.states) == ("w", "V", states)
    made = agree("Filters", [source], uses_at(flat, laws, "saturation_by_side@w", "lag@w"), blocks, tmp_path, rng)
    assert f"= {given};" in made.text
    source.write_text(source.read_text().replace("B*u", "B*(u - 0.1*z[2])"), encoding="utf-8")
    assert not [p for p in ports_with_laws(load_flat("Filters", [source]), laws) if p.attachment == "signal"]
