"""What a term at a port does to the equations, by closed form, and where it stands in the text."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from port_models import CHAIN, CHAIN_BALANCES, DAMPERS, JOINTS_BALANCES, MODELS, PortModel
from small_rigs import Numbers, explicit, rig, somewhere
from written_laws import uses_at

from aero_bayes.laws.candidates import Candidate, find_candidates, place_law, ports_with_laws
from aero_bayes.laws.probes import with_probe
from aero_bayes.laws.write_model import reserved_names, write_laws
from aero_bayes.modelica.compose import add_output
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Name, Number

Point = Mapping[str, float]
Changes = Callable[[Point], dict[str, float]]


def of_joint(joint: int) -> Changes:
    """A friction of 0.7 at a joint moves both by the mass matrix."""

    def changes(at: Point) -> dict[str, float]:
        coupling, torque = 0.05 * np.cos(at["q[2]"]), np.zeros(2)
        torque[joint - 1] = -0.7 * at[f"v[{joint}]"]
        rates = np.linalg.solve([[0.3, coupling], [coupling, 0.02]], torque)
        return {"der(v[1])": rates[0], "der(v[2])": rates[1]}

    return changes


def of_chain(n: int) -> Changes:
    return lambda at: {"der(T[2])": -0.7 * at["T[2]"] / np.linspace(2, 4, n)[1]}


def of_strut(at: Point) -> dict[str, float]:
    force = 0.7 * (at["wheel.v"] - at["body.v"])
    return {"der(body.v)": force / 2.0, "der(wheel.v)": -force / 0.5}


def of_shaft(at: Point) -> dict[str, float]:
    torque = 0.7 * (at["motor.w"] - at["load.w"])
    return {"der(motor.w)": -torque / 0.01, "der(load.w)": torque / 0.03}


VALUES = {"viscous_friction": {"d": 0.7}, "linear_loss": {"k": 0.7}, "polarisation": {"R_1": 0.2}}
VALUES |= {"radiation": {"c": 2e-9}, "square_loss": {"c": 0.3}}
SPEEDS = zip(DAMPERS, (1.0, -1.0, 1.0, -1.0, 1.0), strict=True)
#: Model, law and port, the changes of rates and outputs, and what stands in the text.
CASES: list[tuple[PortModel, str, Changes, str]] = [
    *(
        (MODELS[f"damper {how}"], "viscous_friction@F", lambda at, sign=sign: {"F": sign * 0.7 * at["v"]}, "")
        for how, sign in SPEEDS
    ),
    (MODELS["cell"], "polarisation@v", lambda at: {"v": -0.2 * at["polarisation.i_1"]}, ""),
    (MODELS["charged cell"], "polarisation@v", lambda at: {"v": 0.2 * at["polarisation.i_1"]}, ""),
    *(
        (MODELS[f"joints {how}"], f"viscous_friction@v[{joint}]", of_joint(joint), text if joint == 2 else "")
        for how, (_, text) in JOINTS_BALANCES.items()
        for joint in (1, 2)
    ),
    *(
        (PortModel("Chain", CHAIN.format(n=n, balance=balance)), "linear_loss@T[2]", of_chain(n), text)
        for n, balance, text in CHAIN_BALANCES.values()
    ),
    (
        MODELS["array of components"], "linear_loss@tank[2].h",
        lambda at: {"der(tank[2].h)": -0.7 * at["tank[2].h"] / 2.0},
        "Vessel_tank tank[2](linear_loss_q = {0, linear_loss.q});",
    ),
    (MODELS["each place once"], "viscous_friction@body.a", lambda at: {"der(body.v)": -0.7 * at["body.v"] / 2.0}, ""),
    (MODELS["each place once"], "viscous_friction@strut.s_rel", of_strut, ""),
    (
        MODELS["each place once"], "viscous_friction@tyre.s_rel",
        lambda at: {"der(wheel.v)": 0.7 * (at["shaker.v"] - at["wheel.v"]) / 0.5}, "",
    ),
    (MODELS["shaft that is a component"], "viscous_friction@motor.fl-load.fl", of_shaft, ""),
    # a temperature counts from its level
    (
        MODELS["bodies"], "radiation@one.port",
        lambda at: {"der(one.T)": -2e-9 * (at["one.T"] ** 4 - 295.0**4) / 20.0}, "",
    ),
    (
        MODELS["bodies"], "square_loss@one.port",
        lambda at: {"der(one.T)": -0.3 * (at["one.T"] - 295.0) ** 2 / 20.0}, "",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("model", "id_", "changes", "text"), CASES, ids=[f"{c[0].name} {c[1]}" for c in CASES])
def test_a_law_changes_what_it_must(model, id_, changes, text, laws, tmp_path, rng):
    sources = model.written_to(tmp_path)
    flat = rig(model.name, *map(str, sources))
    law_id, at = id_.split("@")
    (port,) = (p for p in ports_with_laws(flat, laws) if p.id == at)
    law = next(law for law in laws if law.id == law_id and law.kind == port.kind)
    neighbour = next((p for p in ports_with_laws(flat, laws) if p.id in port.neighbours[:1]), None)
    sizes = {"h_0": 295.0, "h_z": 0.0} if model.name == "Bodies.Pair" else {}
    taken = reserved_names(flat, sources)
    placed = place_law(Candidate(law, port, neighbour), taken, nominals=sizes, values=VALUES[law_id])
    written = write_laws(sources, model.name, flat, [placed], tmp_path / "written")
    wide, base = Numbers(explicit(load_flat(written.name, [*sources, written.path]))), Numbers(explicit(flat))
    point = somewhere(wide.names(), rng)
    point |= {n: 300.0 + 10.0 * point[n] for n in ("one.T", "two.T") if n in point}
    before, after = base({n: point[n] for n in base.names()}), wide(point)
    expected = changes(point)
    found = {k: after[k] - before[k] for k in before if k in expected or k.startswith("der(")}
    size = max(map(abs, expected.values()))
    assert found == pytest.approx({k: expected.get(k, 0.0) for k in found}, rel=1e-8, abs=1e-9 * size)
    assert text in written.text.replace("  ", " ")


@pytest.mark.parametrize("name", ["rim of matrices", "rim of a loop", "rim of connectors", "rim of states"])
def test_laws_at_one_signal_act_in_their_order(name, laws, tmp_path, rng):
    """At an input the first one acts last, at an output the last one; other elements of an array are as they were."""
    model = MODELS[name]
    sources = model.written_to(tmp_path)
    flat = rig(model.name, *map(str, sources))
    ids = {c.id for c in find_candidates(ports_with_laws(flat, laws), laws)}
    at = "output_y[2]" if "gain@output_y[2]" in ids else "y[2]"
    placed_laws = uses_at(flat, laws, "gain@u[2]", "offset@u[2]", f"gain@{at}", f"offset@{at}")
    (g_u, b_u), (g_y, b_y) = ([p.value(p.law.magnitude) for p in placed_laws[k : k + 2]] for k in (0, 2))
    written = write_laws(sources, model.name, flat, placed_laws, tmp_path / "written")
    wide, base = Numbers(explicit(load_flat(written.name, [*sources, written.path]))), Numbers(explicit(flat))
    point = somewhere(wide.names(), rng)
    acting = {n.replace("_true[", "["): value for n, value in point.items()}
    found, expected = wide(point), base(acting | {"u[2]": (1.0 + g_u) * (point["u[2]"] + b_u)})
    expected["y[2]"] = (1.0 + g_y) * expected["y[2]"] + b_y
    same = {n.replace("_true[", "[") if n.startswith("der(") else n: value for n, value in found.items()}
    assert {n: same[n] for n in expected} == pytest.approx(expected, rel=1e-12)


FORMS = [
    ("", "M * der(v) = F - d * v;", "1 / M"),
    ("", "M * der(v) + d * v = F;", "1 / M"),
    ("", "0 = F - d * v - M * der(v);", "1 / M"),
    ("", "der(v) = (F - d * v) / M;", "1 / M"),
    ("", "der(v) = 1 / M * (F - d * v);", "1 / M"),
    ("", "der(v) = -(d * v - F) / M;", "1 / M"),
    ("", "F = d * v + M * der(v);", "1 / M"),
    ("", "-M * der(v) = d * v - F;", "1 / M"),
    ("Real a;", "a = der(v);\n  M * a = F - d * v;", "1 / M"),
    ("Real a;", "der(v) = a;\n  a = (F - d * v) / M;", "1 / M"),
    ("Real a = (F - d * v) / M;", "der(v) = a;", "1 / M"),
    ("Real f;", "f = F - d * v;\n  M * der(v) = f;", "1 / M"),
    ("", "der(v) = F / M - d / M * v;", "1"),
    ("", "n * der(v) = n / M * F - n * d / M * v;", "-1 / n"),
]


@pytest.mark.parametrize(("declared", "balance", "gain"), FORMS)
def test_friction_brakes_however_the_balance_is_written(declared, balance, gain, laws, modelica, tmp_path, rng):
    """The acceleration changes by minus the force over the mass, or by minus an acceleration; never by plus."""
    path = modelica(f"""model Form
  parameter Real M(unit = "kg") = 2.5;
  parameter Real d(unit = "N.s/m") = 0.7;
  parameter Real n = -3;
  input Real F(unit = "N");
  output Real q(unit = "m", start = 0.2, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  {declared}
equation
  der(q) = v;
  {balance}
end Form;
""")
    flat = rig("Form", str(path))
    (port,) = (p for p in ports_with_laws(flat, laws) if p.kind == "motion")
    assert port.id == "v"
    assert (str(port.signals["v"]), str(port.signals["x"])) == ("v", "q")
    law = next(law for law in laws if law.id == "viscous_friction")
    placed = place_law(Candidate(law, port), [v.name for v in flat.variables], values={"d": 0.9})
    assert placed.names == {"d": "d_v"}
    shown = Numbers(explicit(add_output(flat, "load", port.signals["load"].expression)))
    written = write_laws([path], "Form", flat, [placed], tmp_path / "written")
    wide, base = Numbers(explicit(load_flat(written.name, [path, written.path]))), Numbers(explicit(flat))
    point = somewhere(base.names(), rng)
    change = wide(point)["der(v)"] - base(point)["der(v)"]
    factor = {"1 / M": 1 / 2.5, "1": 1.0, "-1 / n": 1 / 3.0}[gain]
    assert change == pytest.approx(-factor * 0.9 * point["v"], rel=1e-12)
    # the load is what accelerates the body
    assert factor * shown(point)["load"] == pytest.approx(base(point)["der(v)"], rel=1e-12)


@pytest.mark.parametrize("name", list(MODELS)[:7])
def test_a_probe_drives_at_every_port(name, laws, tmp_path, rng):
    model = MODELS[name]
    flat = rig(model.name, *map(str, model.written_to(tmp_path)))
    ports = [p for p in ports_with_laws(flat, laws) if p.attachment != "output"]
    base = Numbers(explicit(flat))
    point = somewhere(base.names(), rng)
    expected = base(point)
    for port in ports:
        wide = Numbers(explicit(with_probe(flat, port, "probe", -1.0)))
        assert wide({**point, "probe": 0.0}) == pytest.approx(expected, rel=1e-12)
        felt = wide({**point, "probe": 0.1})
        assert any(abs(felt[k] - expected[k]) > 1e-9 for k in expected), port.id
        if port.kind in ("motion", "storage"):
            moved = port.signals["v" if port.kind == "motion" else "h"]
            for sign, signal in moved.parts[:1]:  # what moves against it has a port of its own
                assert sign * (felt[f"der({signal})"] - expected[f"der({signal})"]) > 0, port.id


@pytest.mark.parametrize("name", ["rim of matrices", "rim of states"])
def test_what_a_term_stands_beside_is_a_number(name, laws, tmp_path):
    """Also where one side is a vector and the other is written element by element."""
    model = MODELS[name]
    flat = load_flat(model.name, model.written_to(tmp_path))
    terms = [t for p in ports_with_laws(flat, laws) if p.balance is not None for t in p.balance.beside]
    assert len(terms) >= 6
    for n, term in enumerate(terms):
        wider = add_output(flat, "watched", Call("+", (term, Call("*", (Number(1e-300), Name("time"))))))
        export_flat(wider, tmp_path / f"{n}.fmu")
