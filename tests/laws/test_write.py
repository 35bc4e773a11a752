"""Written models against models with attached laws: the same rates, and the user's text kept."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from facts import facts
from numpy.typing import NDArray
from small_rigs import RIGS, Numbers, explicit, rig, somewhere
from written_laws import SIZES, agree, uses_at, written_flat

from aero_bayes.errors import InputError
from aero_bayes.laws.candidates import find_candidates, place_law, ports_with_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.write_model import write_laws
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.simulation.interface import Experiment, InputSignal, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool


def test_the_users_text_is_kept(laws, tmp_path):
    flat = rig("Cart")
    written = write_laws([RIGS / "Cart.mo"], "Cart", flat, uses_at(flat, laws, "coulomb_friction@v"), tmp_path)
    gone = [line[1:] for line in written.diff.splitlines() if line.startswith("-") and not line.startswith("---")]
    assert [line.split()[0] for line in gone] == ["model", "M", "end"]
    assert (
        '  M * der(v) = F - F_v * v - K * x - F_c * tanh(v / 2.6e-05) "Newton\'s second law" annotation '
        '(Documentation(info = "a balance; of forces"));'
    ) in written.text.splitlines()
    assert '  // the balance of forces; "equation" is only a word here' in written.text
    assert "F_v(unit" in written.text
    assert (
        'parameter Real F_c(unit = "N", min = 0, max = 25, nominal = 0.25) = 0.25 "Dry friction at v";' in written.text
    )
    assert written.name == "Cart_coulomb_friction"
    assert written.path.read_text(encoding="utf-8") == written.text


def test_a_law_at_a_connector_extends_one_in_series_splits_a_connection(laws, tmp_path):
    flat = rig("Shaft.Motor")
    sources = [RIGS / "Shaft.mo"]
    node = write_laws(sources, "Shaft.Motor", flat, uses_at(flat, laws, "coulomb_friction@load.a"), tmp_path)
    assert "  extends Shaft.Motor;" in node.text
    assert "  connect(coulomb_friction.port, load.a);" in node.text
    assert node.diff.startswith("--- /dev/null\n")
    series = write_laws(sources, "Shaft.Motor", flat, uses_at(flat, laws, "contact_drop@inductor.p"), tmp_path)
    changed = [line for line in series.diff.splitlines() if line.startswith(("-  ", "+  ")) and "connect" in line]
    assert changed == [
        "-  connect(resistor.n, inductor.p);",
        "+  connect(resistor.n, contact_drop.p);",
        "+  connect(contact_drop.n, inductor.p);",
    ]


def test_names_that_are_taken_get_the_ports_name(laws):
    flat = rig("Pendulum")  # has a parameter d
    (placed,) = uses_at(flat, laws, "viscous_friction@w")
    assert placed.names == {"d": "d_w"}
    assert placed.unit(placed.law.magnitude) == "N.m.s/rad"


def test_outputs_that_are_states_and_readings_that_feed_back(laws, blocks, modelica, tmp_path, rng):
    """The reading changes, what the rig does with the true quantity does not."""
    path = modelica("""model Level
  input Real u(unit = "m3/s");
  output Real h(unit = "m", start = 1, fixed = true) "Level";
  output Real twice(unit = "m") = 2 * h + u;
equation
  der(h) = u - 0.3 * h;
end Level;

model Other "stands beside it"
  Real x = 1;
end Other;
""")
    flat = rig("Level", str(path))
    for ids in (("offset@output_h",), ("gain@twice", "dead_zone@u")):
        placed_laws = uses_at(flat, laws, *ids)
        agree("Level", [path], placed_laws, blocks, tmp_path / "out", rng)
    placed_laws = uses_at(flat, laws, "offset@output_h")
    offset = Numbers(explicit(written_flat("Level", [path], placed_laws, tmp_path / "out")))
    point = somewhere(offset.names(), rng)
    found = offset(point)
    assert found["twice"] == pytest.approx(2 * point["h_true"] + point["u"])
    assert found["h"] == pytest.approx(point["h_true"] + 0.1 * SIZES["u_n"])


def test_a_class_of_a_package_keeps_its_meanings(laws, blocks, tmp_path, rng):
    """Short names, imports and constants of the packages around a class still mean the same in its copy."""
    folder = tmp_path / "Bench"
    (folder / "Rigs").mkdir(parents=True)
    (folder / "package.mo").write_text(
        'within ;\npackage Bench "Über allem"\n  import P = Bench.Parts;\n  constant Real g = 9.81;\nend Bench;\n',
        encoding="utf-8",
    )
    (folder / "Parts.mo").write_text(
        "within Bench;\npackage Parts\n  block Gain\n    parameter Real k = 2;\n    input Real u;\n"
        "    output Real y = k * u;\n"
        "  end Gain;\nend Parts;\n",
        encoding="utf-8",
    )
    (folder / "Rigs" / "package.mo").write_text('within Bench;\npackage Rigs "ä ö ü"\nend Rigs;\n', encoding="utf-8")
    (folder / "Rigs" / "Height.mo").write_text(
        'within Bench.Rigs;\ntype Height = Real(unit = "m");\n', encoding="utf-8"
    )
    (folder / "Rigs" / "Fall.mo").write_text(
        """within Bench.Rigs;
model Fall "Fällt"
  parameter Real m = 0.5 "Größe";
  input Real u;
  output Real y = x;
  model Double
    P.Gain twice;
  end Double;
  type Place = Height(min = -1e3);
  P.Gain gain(k = 3, u = u);
  Double double(twice(u = u));
  Place x(start = 0, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(x) = v;
  m * der(v) = gain.y - m * g;
end Fall;
""",
        encoding="utf-8",
    )
    flat = rig("Bench.Rigs.Fall", str(folder))
    (port,) = (p for p in ports_with_laws(flat, laws) if p.id == "v")
    assert str(port.place) == "Bench/Rigs/Fall.mo:16"
    placed_laws = uses_at(flat, laws, "quadratic_drag@v", "offset@u")
    written = agree("Bench.Rigs.Fall", [folder], placed_laws, blocks, tmp_path / "out", rng)
    assert "  m * der(v) = gain.y - m * Bench.g - c * v * abs(v);" in written.text
    assert "  Bench.Parts.Gain gain(k = 3, u = offset.y);" in written.text


BLOCKS = """package Blocks "Tanks without connectors"
  partial model Vessel
    parameter Real A(unit = "m2") = 0.5;
    input Real q_in(unit = "m3/s");
    output Real q_out(unit = "m3/s");
    Real h(unit = "m", start = 1, fixed = true);
  protected
    Real q;
  equation
    q = q_in - q_out; // net
    A * der(h) = q_in - q_out;
  end Vessel;

  model Tank
    extends Vessel(final A = 0.25, h(start = 2, nominal = 3));
    parameter Real k = 0.1;
  equation
    q_out = k * h;
  end Tank;

  model Line "Two in a row"
    input Real u(unit = "m3/s");
    Tank upper(k = 0.2, q_in = u);
    Tank lower;
  equation
    lower.q_in = upper.q_out;
  end Line;

  partial model Slow "starts where it stays"
    input Real u(unit = "m3/s");
    Real s;
  equation
    der(s) = u - s;
  initial equation
    s = 0.5;
  end Slow;

  model Late
    extends Slow;
    output Real y = s;
    annotation (Icon());
  end Late;

  partial model Bench
    Line line;
    input Real u(unit = "m3/s");
    output Real y(unit = "m") = line.lower.h;
    Real T(start = 1, fixed = true) "Temperature";
  equation
    line.u = u;
    der(T) = -0.1 * T;
  end Bench;

  model Rig "The bench"
    extends Bench(T(start = 4));
    output Real z = T;
  end Rig;
end Blocks;
"""


def test_balances_inside_components_and_of_base_classes(laws, blocks, modelica, tmp_path, rng):
    """The classes on the way are copied, with their base classes written out; what is not on it stays a reference."""
    path = modelica(BLOCKS)
    flat = rig("Blocks.Rig", str(path))
    ports = {p.id: p for p in ports_with_laws(flat, laws)}
    assert set(ports) == {"u", "y", "z", "T", "line.upper.h", "line.lower.h"}
    assert ports["line.upper.h"].unit == "m3/s"
    for ids in (
        ("root_loss@line.upper.h",), ("overflow@line.upper.h", "linear_loss@line.lower.h"), ("square_loss@T",),
        ("offset@y", "dead_zone@u"),
    ):  # fmt: skip
        written = agree("Blocks.Rig", [path], uses_at(flat, laws, *ids), blocks, tmp_path / "out", rng)
        assert "within ;" in written.text
    assert written.diff.count("extends") == 1
    late = rig("Blocks.Late", str(path))
    written_late = agree("Blocks.Late", [path], uses_at(late, laws, "square_loss@s"), blocks, tmp_path / "out", rng)
    assert explicit(load_flat(written_late.name, [path, written_late.path])).starts[0].value == 0.5
    starts = explicit(load_flat(written.name, [path, written.path]))
    assert dict(zip(starts.states, [n.value for n in starts.starts], strict=True))["T"] == 4.0


def test_a_class_of_a_library_gets_a_wrapper_or_a_copy(laws, modelica, tmp_path):
    """Nothing is written into the library, and it is still needed to load what was written."""
    library = tmp_path / "library"
    library.mkdir()
    (library / "Shaft.mo").write_text((RIGS / "Shaft.mo").read_text(encoding="utf-8"), encoding="utf-8")
    own = modelica("model Mine\n  Shaft.Motor motor(V = 1);\nend Mine;\n")
    flat = load_flat("Shaft.Motor", [own], [library])
    for id_, head in (("viscous_friction@load.a", "  extends Shaft.Motor;"), ("dead_zone@V", "  Shaft.Resistor")):
        placed_laws = uses_at(flat, laws, id_)
        written = write_laws([own], "Shaft.Motor", flat, placed_laws, tmp_path / "out")
        assert head in written.text
        again = Numbers(explicit(load_flat(written.name, [own, written.path], [library])))
        point = somewhere(again.names(), np.random.default_rng(3))
        plain = Numbers(explicit(written_flat("Shaft.Motor", [RIGS / "Shaft.mo"], placed_laws, tmp_path / "plain")))
        assert again(point) == pytest.approx(plain(point), rel=1e-12)
    assert [p.name for p in library.iterdir()] == ["Shaft.mo"]


def test_components_declared_together_part_where_one_changes(laws, blocks, modelica, tmp_path, rng):
    path = modelica(
        """model Part
  Real x(start = 0, fixed = true);
equation
  der(x) = -x;
end Part;

model Loose
  Part one, two(x(start = 3)) "both";
  output Real y = one.x;
end Loose;
""",
        "Loose",
    )
    flat = rig("Loose", str(path))
    placed_laws = uses_at(flat, laws, "square_loss@one.x")
    written = agree("Loose", [path], placed_laws, blocks, tmp_path / "out", rng)
    assert '  Part_one one(square_loss_q = square_loss.q);\n  Part two(x(start = 3)) "both";\n' in written.text
    both = uses_at(flat, laws, "square_loss@one.x", "offset@two.x")
    agree("Loose", [path], both, blocks, tmp_path / "out", rng)


def test_what_cannot_be_written_is_said(laws, modelica, tmp_path):
    path = modelica("""model Branch
  parameter Boolean quick = true;
  Real x(start = 1, fixed = true);
  output Real y = x;
equation
  if quick then
    der(x) = -2 * x;
  else
    der(x) = -x;
  end if;
end Branch;
""")
    flat = rig("Branch", str(path))
    assert {p.id for p in ports_with_laws(flat, laws)} == {"y"}  # a balance in branches is no port
    with pytest.raises(InputError, match=facts("Nowhere")):
        write_laws([path], "Nowhere", flat, [], tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("law", ["Lag(T_l = 0.3)", "Delay(T_d = 0.3)", "RateLimit(r = 4)", "Hysteresis(s_p = 0.5)"])
def test_an_actuator_starts_where_its_input_does(law, tmp_path):
    """Of an input that is 3 from the start, and stays, nothing is held back."""
    time = np.linspace(0.0, 2.0, 41)
    found = acted(law, InputSignal("u", np.array([0.0, 1.0]), np.array([3.0, 3.5])), time, tmp_path)
    assert np.abs(found[time < 0.999] - 3.0).max() < 1e-6
    assert found[-1] == pytest.approx(3.25 if law.startswith(("Rate", "Hyst")) else 3.5, abs=0.03)


@pytest.mark.parametrize("between", ["linear", "hold"])
def test_a_play_is_pushed_by_its_ends(between, tmp_path):
    """Against the operator by its definition: max(u - w, min(u + w, what it was)); long within its ends, too."""
    rng = np.random.default_rng(4)
    pushed, within = rng.uniform(-2.0, 2.0, 60), rng.uniform(-0.35, 0.35, 2000)
    # a sampling interval of a tenth of the typical time
    levels = np.concatenate(([0.0], pushed, pushed[-1] + np.sign(pushed[-1]) * 0.1 + within, pushed))
    corners = 0.05 * np.arange(levels.size)
    time = np.arange(0.0, corners[-1], 0.01)
    at = np.interp(time, corners, levels) if between == "linear" else levels[np.searchsorted(corners, time + 1e-9) - 1]
    inner, expected = 0.0, []
    for u in at:
        inner = max(u - 0.5, min(u + 0.5, inner))
        expected.append(0.3 * u + 0.7 * inner)
    signal = InputSignal("u", corners, levels, between)
    found = acted("Hysteresis(s_p = 0.7, u_p = 0.5)", signal, time, tmp_path)
    # ends rounded by 0.004, of which 0.7 count; where lines turn the play is 2.5 ms behind
    np.testing.assert_allclose(found, expected, atol=0.004 if between == "hold" else 0.08)


def acted(law: str, signal: InputSignal, time: NDArray[np.float64], folder: Path) -> NDArray[np.float64]:
    """What a law of an input makes of a signal."""
    name, changed = law.rstrip(")").split("(")
    path = folder / "Settled.mo"
    path.write_text(
        f"""model Settled
  input Real u;
  output Real y;
  Laws.Inputs.{name} law(u_n = 4, t_n = 0.5, {changed});
equation
  law.u = u;
  y = law.y;
end Settled;
""",
        encoding="utf-8",
    )
    library = RIGS.parents[1] / "modelica" / "Laws"
    fmu = export_fmu("Settled", folder / "settled.fmu", compiler="embedded", sources=[library, path])
    problem = Problem(Model.load(fmu), (Experiment(time, ("y",), (signal,)),), ((),), {}, SolverSettings(1e-8, 1e-8))
    with WorkerPool(0) as pool, NativeSimulator(problem, pool=pool) as simulator:
        return simulator.simulate(np.zeros((1, 0))).outputs[0][0][:, 0]


def test_a_second_reader_takes_the_written_text_and_the_library(laws, tmp_path):
    """pymoca's grammar, which shares nothing with the reader here."""
    parser = pytest.importorskip("pymoca.parser", reason="the second reader, pymoca, is not installed")
    texts = {}
    for model, id_ in (("Cart", "delay@q"), ("TankPair", "overflow@h1"), ("Shaft.Motor", "contact_drop@inductor.p")):
        flat = rig(model)
        sources = [RIGS / f"{model.partition('.')[0]}.mo"]
        written = write_laws(sources, model, flat, uses_at(flat, laws, id_), tmp_path)
        texts[written.name] = written.text.replace("within ;\n", "")
    library = RIGS.parents[1] / "modelica" / "Laws"
    for path in [*library.rglob("*Law.mo"), *(library / "Motion").glob("[A-Z]*.mo")]:
        texts[path.stem] = re.sub(r"^within[^;]*;", "", path.read_text(encoding="utf-8"))
    assert len(texts) >= 10
    for name, text in texts.items():
        tree = parser.parse(text)
        assert tree is not None, name
        assert name in tree.classes


def test_readings_that_are_states_take_inputs_at_once_or_are_connected(modelica, tmp_path):
    """What the reading was is found again: after a modifier of the same name, by its aliases, without its rate."""
    path = modelica("""package Read
  connector Out = output Real;
  model Inner
    Real i(start = 0, fixed = true);
    Out y;
    input Real u;
  equation
    der(i) = u - i;
    y = i;
  end Inner;
  model Rig
    input Real u;
    output Real x(start = 0, fixed = true);
    output Real z = 2 * x + u;
    Out i;
    Inner plant(u = u, i(start = 1));
  equation
    der(x) = u - 3 * x;
    connect(plant.y, i);
  end Rig;
end Read;
""")
    family = ModelicaFamily(LawPlaces("Read.Rig", (path,)), tmp_path / "fmu")
    assert {p.id: p.kind for p in family.places.ports if p.attachment == "output"}["z"] == "reading"
    found = find_candidates(family.places.ports, family.places.laws)
    lags = [c for c in found if c.port.attachment == "output" and c.law.id == "lag"]
    assert {str(c.port.signals["u"]) for c in lags} == {"x", "z", "i"}
    for c in lags:
        placed = place_law(c, {v.name for v in family.places.flat.variables}, nominals={})
        written = write_laws([path], "Read.Rig", family.places.flat, [placed], tmp_path / "out")
        flat = load_flat(written.name, [path, written.path])
        assert {v.name for v in flat.variables if v.causality == "output"} >= {"x", "z", "i"}
        export_flat(flat, tmp_path / "out" / f"{c.port.signals['u']}.fmu")
    same = family.base_model().state_aliases
    assert same["plant.i"] == same["i"]


def test_only_what_can_be_written_is_tried(laws, tmp_path):
    """A balance that only stands in a component as rows of a matrix equation need not stop a search."""
    (tmp_path / "Filter.mo").write_text(
        """package Filter
  model Rows
    parameter Real A[2, 2] = {{-1, 0.2}, {0, -3}};
    input Real u;
    Real x[2](each start = 0, each fixed = true);
  equation
    der(x) = A * x + {0, 1} * u;
  end Rows;
  model Rig
    input Real u;
    output Real y = rows.x[1];
    Rows rows(u = u);
  end Rig;
end Filter;
"""
    )
    places = LawPlaces("Filter.Rig", (tmp_path / "Filter.mo",))
    tried = places.candidates_for(None)
    assert {"lag@u", "offset@y"} <= {c.id for c in tried}
    for c in tried:
        placed = place_law(c, {v.name for v in places.flat.variables}, nominals={})
        write_laws(places.sources, places.base, places.flat, [placed], tmp_path / "out")
