"""Modelica files that are wrong, or very large: one line with file and line."""

from __future__ import annotations

import random
import re
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from aero_bayes.commands.init import run_init
from aero_bayes.errors import InputError
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.embedded import explicit_model


def test_constants_that_meet_only_when_solved_are_one_line(modelica):
    text = "model Met\n  Real x;\n  Real w;\nequation\n  der(x) = -x * log(w);\n  w = 0;\nend Met;\n"
    source = modelica(text)
    with pytest.raises(InputError, match=r"^Met\.mo:2: model Met: math domain error"):
        explicit_model("Met", [source])


def test_a_byte_order_mark_is_read_and_another_encoding_refused(modelica, tmp_path):
    text = 'model Marked "Größe"\n  Real x;\nequation\n  der(x) = -x;\nend Marked;\n'
    assert explicit_model("Marked", [modelica(f"\ufeff{text}")]).states == ("x",)
    (tmp_path / "Marked.mo").write_bytes(f"// Latin-1\n{text}".encode("latin-1"))
    with pytest.raises(InputError, match=r"Marked\.mo:2: .*0xf6.* UTF-8"):
        explicit_model("Marked", [tmp_path / "Marked.mo"])
    with pytest.raises(InputError, match=r"Marked\.mo:2: .*0xf6.* UTF-8"):
        run_init(tmp_path / "Marked.mo", tmp_path / "Marked.mo", tmp_path / "rig.toml")


def test_a_model_of_many_states_runs_as_co_simulation(modelica, tmp_path):
    """Its Jacobian is larger than a thread's stack."""
    source = modelica("""model Chain
  parameter Integer n = 1200;
  Real x[n](each start = 1, each fixed = true);
  output Real y = x[2];
equation
  der(x[1]) = -2 * x[1];
  for i in 2:n loop
    der(x[i]) = 2 * (x[i - 1] - x[i]);
  end for;
end Chain;
""")  # fmt: skip
    written = export_fmu("Chain", tmp_path / "Chain.fmu", compiler="embedded", sources=[source])
    found = simulate_fmu(str(written), stop_time=1.0, output_interval=1.0, output=["y"], fmi_type="CoSimulation")
    assert found["y"][-1] == pytest.approx(3.0 * np.exp(-2.0), rel=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_errors_of_changed_files_name_file_and_line(seed, modelica):
    rng = random.Random(seed)
    text = (Path(__file__).parents[1] / "models" / "Motor.mo").read_text("utf-8")
    tokens = [m.span() for m in re.finditer(r"\w+|[^\w\s]", text)]
    (a, b), (c, d) = rng.sample(tokens, 2)
    changed = [text[:a] + text[b:], text[:a] + text[c:d] + text[b:], text[:a], text[:a] + "zzz" + text[b:]]
    said = ""
    try:
        explicit_model("Motor", [modelica(changed[seed % 4])])
    except InputError as error:
        said = str(error)
    assert re.fullmatch(r"(Motor\.mo:\d+: .+)?", said)


BUS = """package Wires
  expandable connector Bus{members}
  end Bus;
  connector Out = output Real;
  connector In = input Real;
  model Source
    Bus bus;
    Out y = 2;
  equation
    connect(y, bus.v);
  end Source;
  model Sink
    Bus bus;
    In v;
    Real x(start = 1, fixed = true);
  equation
    connect(bus.v, v);
    der(x) = v - x;
  end Sink;
  model Wired
    Source source;
    Sink sink;
  equation
    connect(source.bus, sink.bus);
  end Wired;
end Wires;
"""


def test_an_expandable_connector_needs_its_members_declared(modelica):
    with pytest.raises(InputError, match=r"^Wires\.mo:2: .*expandable.*declare"):
        explicit_model("Wires.Wired", [modelica(BUS.format(members=""))])
    assert explicit_model("Wires.Wired", [modelica(BUS.format(members=" Real v;"))]).states == ("sink.x",)


def test_an_initial_algorithm_is_told_with_its_line(modelica):
    text = "model Set\n  Real y;\ninitial algorithm\n  y := 2;\nequation\n  der(y) = -y;\nend Set;\n"
    with pytest.raises(InputError, match=r"^Set\.mo:3: .*initial equation"):
        explicit_model("Set", [modelica(text)])
    way_out = text.replace("algorithm", "equation").replace(":=", "=")
    assert explicit_model("Set", [modelica(way_out)]).states == ("y",)
