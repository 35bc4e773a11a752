"""The laws of the library against closed forms, and what every law must be: off by default, smooth, felt when on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from closed_form import damped_stops
from facts import facts
from small_rigs import RIGS, Numbers, explicit, rig
from written_laws import written_flat

from aero_bayes.errors import InputError
from aero_bayes.laws.candidates import Candidate, place_law, ports_with_laws
from aero_bayes.laws.law import LAW_INTERFACES, read_laws
from aero_bayes.laws.law_models import law_models
from aero_bayes.modelica.classes import snake_case
from aero_bayes.modelica.compose import add_input, set_parameter
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.modelica.flat import FlatEquation
from aero_bayes.modelica.syntax import Call, Name, Number

pytestmark = pytest.mark.fast

LISTED = {
    "input": "gain offset dead_zone dead_zone_by_side saturation saturation_by_side rate_limit square_law lag delay "
    "lag_of_second_order hysteresis curve",
    "output": "gain offset saturation saturation_by_side unsigned lag lag_of_second_order delay curve",
    "reading": "lag lag_of_second_order delay",
    "motion": "coulomb_friction friction_by_direction stribeck_friction presliding_friction rounded_friction "
    "load_friction viscous_friction quadratic_drag offset linear_stiffness cubic_stiffness unbalance hysteretic_spring "
    "attached_mass end_stop end_stop_by_side backlash curve position_curve fine_position_curve",
    "storage": "linear_loss root_loss square_loss offset second_storage radiation curve",
    "overflow": "overflow",
    "exchange": "exchange",
    "electrical": "series_resistance contact_drop heating polarisation polarisation_of_two_pairs curve",
}
SIZES = {
    "f_n": 3.0,
    "v_n": 0.5,
    "x_n": 0.2,
    "x_w": 0.1,
    "x_0": 0.02,
    "u_n": 4.0,
    "q_n": 7.0,
    "h_n": 10.0,
    "d_n": 10.0,
    "i_n": 2.0,
    "t_n": 0.5,
}


def clip(x: float, limit: float) -> float:
    return max(-limit, min(limit, x))


def bumps(z: float, heights: dict[str, float]) -> float:
    """A curve by its definition: normal bumps at even steps from -1 to 1, as wide as they are apart."""
    places = np.linspace(-1.0, 1.0, len(heights))
    width = places[1] - places[0]
    return float(
        np.array([heights[f"c_{k + 1}"] for k in range(places.size)]) @ np.exp(-(((z - places) / width) ** 2) / 2)
    )


#: What each law says where nothing is rounded, with its own parameters by name.
CLOSED: dict[tuple[str, str], Callable[..., float]] = {
    ("input", "gain"): lambda u, g: (1 + g) * u,
    ("input", "offset"): lambda u, b: u + b,
    ("input", "dead_zone"): lambda u, u_d: u - clip(u, u_d),
    ("input", "saturation"): lambda u, s: clip(u, 1 / s),
    ("input", "dead_zone_by_side"): lambda u, u_d, a: u - max((a - 1) * u_d, min((a + 1) * u_d, u)),
    ("input", "saturation_by_side"): lambda u, s, a: max(-1 / (s * (1 - a)), min(1 / (s * (1 + a)), u)),
    ("input", "square_law"): lambda u, a: (1 - a) * u + a * u * abs(u) / SIZES["u_n"],
    ("output", "gain"): lambda u, g: (1 + g) * u,
    ("output", "offset"): lambda u, b: u + b,
    ("output", "saturation"): lambda u, s: clip(u, 1 / s),
    ("output", "saturation_by_side"): lambda u, s, a: max(-1 / (s * (1 - a)), min(1 / (s * (1 + a)), u)),
    ("output", "unsigned"): lambda u, r: u + r * (abs(u) - u),
    ("motion", "coulomb_friction"): lambda v, F_c: F_c * np.sign(v),
    ("motion", "friction_by_direction"): lambda v, F_c, a: F_c * (1 + a) if v > 0 else -F_c * (1 - a),
    ("motion", "stribeck_friction"): lambda v, F_c, r, v_s: np.sign(v) * F_c * (1 + r * np.exp(-((v / v_s) ** 2))),
    ("motion", "rounded_friction"): lambda v, F_c, v_c: F_c * np.tanh(v / v_c),
    ("motion", "load_friction"): lambda v, load, L, f_0: L * (f_0 + abs(load)) * np.sign(v),
    ("motion", "viscous_friction"): lambda v, d: d * v,
    ("motion", "quadratic_drag"): lambda v, c: c * v * abs(v),
    ("motion", "offset"): lambda F_0: F_0,
    ("motion", "linear_stiffness"): lambda x, k: k * x,
    ("motion", "cubic_stiffness"): lambda x, k_3: k_3 * x**3,
    ("motion", "unbalance"): lambda x, M_g, phi_g: M_g * np.sin(x + phi_g),
    ("motion", "end_stop"): lambda x, k_s, x_s: k_s * (x - clip(x, x_s)),
    ("motion", "end_stop_by_side"): lambda x, v, k_s, x_s, b, t_s: damped_stops(x - b - 0.02, v, k_s, x_s, t_s),
    ("motion", "backlash"): lambda x, v, k_b, x_b, t_b: damped_stops(x, v, k_b, x_b, t_b) - k_b * (x + t_b * v),
    ("storage", "linear_loss"): lambda h, h_s, k: k * (h - h_s),
    ("storage", "root_loss"): lambda h, h_s, k: k * np.sqrt(abs(h - h_s)) * np.sign(h - h_s),
    ("storage", "square_loss"): lambda h, h_s, c: c * (h - h_s) * abs(h - h_s),
    ("storage", "offset"): lambda q_0: q_0,
    ("storage", "radiation"): lambda h, h_s, c: c * (h**4 - h_s**4),
    ("overflow", "overflow"): lambda h, k_o, h_o, share: k_o * max(h - h_o, 0.0),
    ("exchange", "exchange"): lambda h_1, h_2, k: k * (h_1 - h_2),
    ("electrical", "series_resistance"): lambda i, R_s: R_s * i,
    ("electrical", "contact_drop"): lambda i, V_c: V_c * np.sign(i),
    ("input", "curve"): lambda u, **c: u + SIZES["u_n"] * bumps(u / SIZES["u_n"], c),
    ("output", "curve"): lambda u, **c: u + SIZES["u_n"] * bumps(u / SIZES["u_n"], c),
    ("motion", "curve"): lambda v, **c: bumps(v / SIZES["v_n"], c),
    ("motion", "position_curve"): lambda x, **c: bumps(x / SIZES["x_n"], c),
    ("motion", "fine_position_curve"): lambda x, **c: bumps(x / SIZES["x_n"], c),
    ("storage", "curve"): lambda h, **c: bumps(h / SIZES["h_n"], c),
    ("electrical", "curve"): lambda i, **c: bumps(i / SIZES["i_n"], c),
}
#: A limit beyond what occurs cannot be felt, of a value or of its rate, nor a narrow bump beside it, a play that rests
#: in its middle, a sign that is read right.
UNFELT_AT_ZERO = {"saturation", "saturation_by_side", "unsigned", "fine_position_curve", "hysteresis", "rate_limit"}


def test_the_library_has_every_law_that_is_listed(laws):
    found: dict[str, list[str]] = {}
    for law in laws:
        found.setdefault(law.kind, []).append(law.id)
        assert "Source: " in law.text
    assert {k: sorted(v) for k, v in found.items()} == {k: sorted(v.split()) for k, v in LISTED.items()}


@pytest.mark.parametrize(
    ("flow", "level", "unit"),
    [("kg/(s.m3)", "g/l", "1/s"), ("l/min", "m", "l/(min.m)"), ("W", "K", "W/K"), ("m3/s", "m", "m2/s")],
)
def test_a_parameters_unit_is_as_plain_as_the_ports(flow, level, unit, laws):
    law = next(law for law in laws if (law.kind, law.id) == ("storage", "linear_loss"))
    assert law.magnitude.unit({"q_n": flow, "h_n": level, "t_n": "s"}) == unit


def test_ids_are_snake_case():
    assert [snake_case(n) for n in ("CoulombFriction", "Lag", "ACDrop", "RateLimit2")] == [
        "coulomb_friction", "lag", "ac_drop", "rate_limit2",
    ]  # fmt: skip


def test_attributes_are_ordered_and_scale_with_the_port(laws):
    for law in laws:
        sizes = {**law.nominals, **{k: v for k, v in SIZES.items() if k in law.nominals}}
        for p in law.parameters:
            low, high = (p.value(k, sizes) if k in p.terms else end for k, end in (("min", -np.inf), ("max", np.inf)))
            assert low <= p.value("default", sizes) <= high
            assert low < p.value("nominal", sizes) < high
        assert law.magnitude.value("default", sizes) == 0.0
    friction = next(law for law in laws if law.id == "viscous_friction")
    assert friction.magnitude.unit({"f_n": "N.m", "v_n": "rad/s"}) == "N.m.s/rad"
    assert friction.magnitude.value("max", {"f_n": 3.0, "v_n": 0.5}) == pytest.approx(60.0)


@pytest.mark.parametrize("key", sorted(CLOSED))
def test_a_law_is_its_closed_form(key, laws, models, rng):
    law = next(law for law in laws if (law.kind, law.id) == key)
    model = explicit(models[key])
    b = model.system.builder
    sizes = {**law.nominals, **{k: v for k, v in SIZES.items() if k in law.nominals}}
    fitted = {p.name: p.value("nominal", sizes) for p in law.parameters}
    own, acts = Numbers(model).at, model.solved[law.interface.output]
    typical = {
        g: next((SIZES[n] for n, of in law.interface.nominals.items() if of[0] == g[0] and n in SIZES), SIZES["f_n"])
        for g in sorted(law.used_inputs)
    }
    typical |= {"h_s": -0.5 * SIZES["h_n"]} if "h_s" in typical else {}
    largest = max(abs(CLOSED[key](**typical, **fitted)), 1e-9)
    for _ in range(200):
        given = {g: float(rng.uniform(-1.5, 1.5)) * size for g, size in typical.items()}
        at = {**own, **{b.symbol(n): v for n, v in {**sizes, **fitted, **given}.items()}}
        # rounding reaches as far as its width: a few thousandths of the size at a corner
        above = {**given, "h": given["h"] - given["h_s"]} if "h_s" in given else given
        assert evaluate_nodes([acts], at)[0] == pytest.approx(
            CLOSED[key](**given, **fitted), abs=4e-3 * largest, rel=2e-3
        ) or (min(abs(v / size) for v, size in zip(above.values(), typical.values(), strict=True)) < 5e-3)


def test_every_law_is_off_at_its_default_and_felt_when_switched_on(laws, tmp_path, rng):
    """At the default the model is the base; the slope beside it is right, and of the size of the law itself."""
    cart, tanks, circuit = (rig(m) for m in ("Cart", "TankPair", "Rlc"))
    special = {"radiation": rig("Bodies.Pair"), "unbalance": rig("Pendulum")}
    carrier = {"input": cart, "output": cart, "reading": cart, "motion": cart, "electrical": circuit}
    for law in laws:
        flat = special.get(law.id, carrier.get(law.kind, tanks))
        ports = ports_with_laws(flat, laws)
        if law.kind == "reading":
            ports = tuple(replace(p, kind="reading", laws=(law.id,)) for p in ports if p.kind == "output")
        port = next(p for p in ports if law.id in p.laws and p.kind in (law.kind, "storage"))
        neighbour = next((p for p in ports if p.id in port.neighbours[:1]), None)
        placed = place_law(Candidate(law, port, neighbour), [v.name for v in flat.variables])
        model = explicit(written_flat(flat.name, [RIGS / f"{flat.name.partition('.')[0]}.mo"], [placed], tmp_path))
        b = model.system.builder
        base, wide = Numbers(explicit(flat)), Numbers(model)
        # the last bump of a curve is where the points are
        felt = law.parameters[-1] if law.curve_input else law.magnitude
        switch = b.symbol(placed.names[felt.name])
        point = {n: float(v) for n, v in zip(wide.names(), rng.uniform(1.1, 1.9, len(wide.names())), strict=True)}
        # states of the law are where they are on their own: equal
        point |= dict.fromkeys((n for n in point if n.startswith(placed.instance + ".")), 0.4)
        expected = base({n: v for n, v in point.items() if n in base.names()})
        found = wide(point)
        assert {k: found[k] for k in expected} == pytest.approx(expected, rel=1e-13), law.id
        every = [*model.rates, *(model.solved.get(n, b.symbol(n)) for n in wide.outputs)]
        # at the default itself a law with states may sleep
        nominal = felt.value("nominal", placed.all_nominals)
        beside, step = 1e-6 * nominal, 5e-7 * nominal
        at = {**wide.at, **{b.symbol(n): v for n, v in point.items()}, switch: beside}
        slope = np.array(evaluate_nodes([b.derivative(e, switch) for e in every], at))
        up, down = (np.array(evaluate_nodes(every, {**at, switch: beside + s})) for s in (step, -step))
        assert slope == pytest.approx((up - down) / (2 * step), rel=1e-3, abs=1e-6 * (1 + np.abs(slope).max())), law.id
        if law.id not in UNFELT_AT_ZERO:
            assert np.abs(slope).max() > 1e-3, law.id
        if law.id in ("lag", "delay", "rate_limit", "hysteresis"):
            # fast states of a law that is off would set the pace of every simulation
            own = [r for n, r in zip(model.states, model.rates, strict=True) if n.startswith(placed.instance + ".")]
            off, on = (np.abs(evaluate_nodes(own, {**at, switch: s})).max() for s in (0.0, beside))
            assert off < 1e-4 * on, law.id


#: The transfer function of each law with states, by its own parameters, and an angular frequency at which it is asked.
TRANSFER: dict[str, tuple[float, dict[str, float], Callable[[complex], complex]]] = {
    "lag": (4.0, {"T_l": 0.1}, lambda s: 1 / (1 + 0.1 * s)),
    "lag_of_second_order": (9.0, {"T_l": 0.1, "d_l": 0.3}, lambda s: 1 / (1 + 0.06 * s + 0.01 * s**2)),
    "delay": (15.0, {"T_d": 0.1}, lambda s: np.exp(-0.1 * s)),
    "polarisation": (2.0, {"R_1": 0.3, "T_1": 0.7}, lambda s: 0.3 / (1 + 0.7 * s)),
    "polarisation_of_two_pairs": (
        2.0, {"R_1": 0.3, "T_1": 0.7, "s_2": 0.6, "a_2": 9.0}, lambda s: 0.12 / (1 + 0.7 * s) + 0.18 / (1 + 6.3 * s),
    ),
    "second_storage": (2.0, {"k_2": 0.3, "T_2": 0.7}, lambda s: 0.3 * 0.7 * s / (1 + 0.7 * s)),
    # a mass of 0.3 that a spring of 30 and a damper of 0.6 hold: the force for each unit of speed
    "attached_mass": (
        8.0, {"m_a": 0.3, "w_a": 10.0, "d_a": 0.1}, lambda s: 0.3 * s * (30 + 0.6 * s) / (0.3 * s**2 + 0.6 * s + 30),
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "law_id"),
    [
        *((kind, id_) for kind in ("input", "output", "reading") for id_ in ("lag", "lag_of_second_order", "delay")),
        ("electrical", "polarisation"), ("electrical", "polarisation_of_two_pairs"), ("storage", "second_storage"),
        ("motion", "attached_mass"),
    ],
)  # fmt: skip
def test_a_linear_law_with_states_has_its_transfer_function(kind, law_id, laws, models):
    """By the linear state space of the law alone, for an output with its rate as input."""
    law = next(law for law in laws if (law.kind, law.id) == (kind, law_id))
    w, own, exact = TRANSFER[law_id]
    s = 1j * w
    flat = models[kind, law_id]
    for name, value in own.items():
        flat = set_parameter(flat, name, Number(value))
    if kind == "output":
        inner = tuple(replace(v, causality="local") if v.name == "u" else v for v in flat.variables)
        rate = FlatEquation(Call("der", (Name("u"),)), Name("w_in"), "added")
        flat = add_input(replace(flat, variables=inner, equations=(*flat.equations, rate)), "w_in")
    model = explicit(flat)
    b = model.system.builder
    at = {**Numbers(model).at, b.symbol("t_n"): SIZES["t_n"]}
    x = [b.symbol(n) for n in model.states]
    u, y = b.symbol("w_in" if kind == "output" else law.interface.inputs[0]), model.solved[law.interface.output]
    a = np.array([evaluate_nodes([b.derivative(r, j) for j in x], at) for r in model.rates])
    into = np.array(evaluate_nodes([b.derivative(r, u) for r in model.rates], at))
    out = np.array(evaluate_nodes([b.derivative(y, j) for j in x], at))
    direct = evaluate_nodes([b.derivative(y, u)], at)[0]
    response = direct + out @ np.linalg.solve(s * np.eye(len(x)) - a, into)
    response *= s if kind == "output" else 1.0
    assert response == pytest.approx(exact(s), rel=2e-3)


def test_a_users_law_needs_no_python(modelica):
    own = modelica("""package Mine "Laws of my rig"
  partial model Friction "A base of its own"
    extends Laws.Interfaces.MotionLaw;
  end Friction;
  model RopeDrag "Rope that is dragged along"
    extends Laws.Interfaces.MotionLaw(v(unit = "m/s"));
    parameter Real r(min = 0, max = 5 * f_n, nominal = 0.2 * f_n / v_n ^ 3) = 0 "Drag of the rope";
  equation
    f = r // a comment within
      * cube(v);
    annotation (__aero_bayes(refines = "quadratic_drag"));
  end RopeDrag;
  function cube
    input Real x;
    output Real y = x ^ 3;
  algorithm
  end cube;
  model NoLaw
    Real y = 1;
  end NoLaw;
end Mine;
""")
    (law,) = read_laws([own])
    assert (law.id, law.kind, law.model, law.refines) == ("rope_drag", "motion", "Mine.RopeDrag", "quadratic_drag")
    assert law.required_units == {"v": "m/s"}
    assert law.used_inputs == {"v"}
    assert law.magnitude.unit({"f_n": "N", "v_n": "m/s"}) == "N.s3/m3"
    model = explicit(law_models([law], [own])["motion", "rope_drag"])
    at = {model.system.builder.symbol(n): v for n, v in {"r": 2.0, "v": 3.0}.items()}
    assert evaluate_nodes([model.solved["f"]], at) == [54.0]
    own.write_text(
        "model Bare\n  extends Laws.Interfaces.StorageLaw;\n  parameter Real k = 1;\nequation\n  q = k;\nend Bare;\n",
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=facts("Mine.mo", "Bare", "nominal")):
        read_laws([own])


@pytest.mark.parametrize(
    ("partial", "memory", "told"),
    [
        ("OutputLaw", "play", "kind"),
        ("InputLaw", "delay", "kind"),
        ("InputLaw", "play", "2"),
        ("InputLaw", "pla", "play"),
    ],
)
def test_a_memory_that_a_law_cannot_have_is_refused(partial, memory, told, tmp_path):
    own = tmp_path / "Mine.mo"
    own.write_text(
        f"model Slow\n  extends Laws.Interfaces.{partial};\n  parameter Real r(min = 0, nominal = 1) = 0;\nequation\n"
        f'  y = u;\n  annotation (__aero_bayes(memory = "{memory}"));\nend Slow;\n',
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=facts("Mine.mo", "Slow", told)):
        read_laws([own])


def test_every_partial_model_has_a_shape():
    from aero_bayes.modelica.library import modelica_root

    folder = modelica_root() / "Laws" / "Interfaces"
    assert {p.stem for p in folder.glob("*Law.mo")} == set(LAW_INTERFACES)
