"""``aero-bayes init``: what it writes is what ``fit`` needs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import vessel
from click.testing import CliRunner, Result
from facts import facts
from scipy.io import savemat

from aero_bayes.cli import main
from aero_bayes.commands.init import match_columns
from aero_bayes.data.columns import split_unit
from aero_bayes.modelica.sources import main_class

pytestmark = pytest.mark.fast

RIG = """within ;
partial model Base
  parameter Real k(unit = "1/s", min = 0.01, max = 10) = 0.3 "Rate of \\"loss\\"";
end Base;
model Vessel "Fed and leaking"
  extends Base;
  parameter Real gain(unit = "kg/s", min = 0.1, max = 10) = 2 "Per volt";
  parameter Real twin = 1 "Multiplies the gain, so that no data tells the two apart";
  parameter Real unused(unit = "m") = 3 "Not in any equation that is read";
  input Real u(unit = "V");
  output Real level(unit = "kg") = a;
  Real a(unit = "kg", start = 0, fixed = true);
  Real b(start = 0, fixed = true);
equation
  der(a) = gain * twin * u - k * a;
  der(b) = unused - b;
end Vessel;
"""
RIGS = Path(__file__).parents[2] / "studies" / "simulated_rigs" / "models"


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, list(map(str, arguments)))


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "Rig.mo").write_text(RIG)
    vessel.record(tmp_path / "run.csv", "Time,U [V],height", gain=1.5)
    return tmp_path


def test_columns_are_mapped_every_parameter_is_listed_and_what_the_outputs_tell_is_free(rig):
    written = run("init", rig / "models" / "Rig.mo", rig / "run.csv", "--out", rig / "rig.toml")
    assert written.exit_code == 0, written.output
    document = tomllib.loads((rig / "rig.toml").read_text())
    assert document["model"] == {"sources": ["models/Rig.mo"], "name": "Vessel"}
    assert document["data"]["columns"] == {
        "time": {"source": "Time"}, "u": {"source": "U [V]"}, "level": {"source": "height"},
    }  # fmt: skip
    lines = (rig / "rig.toml").read_text().splitlines()
    free = {name: given["free"] for name, given in tomllib.loads("\n".join(lines))["parameters"].items()}
    assert free == {"k": True, "gain": True, "twin": "later"}
    for name, words in (
        ("k", ("value = 0.3", 'Rate of "loss"', "1/s")),
        ("twin", ("no unit", "cannot distinguish it")),
        ("unused", ("in m", "do not respond")),
    ):
        (line,) = (x for x in lines if x.removeprefix("# ").startswith(f"{name} ="))
        assert all(word in line for word in words), line


def test_signals_of_a_mat_file_are_matched(rig):
    time, u, level = np.loadtxt(rig / "run.csv", delimiter=",", skiprows=1).T
    signals = [{"values": v[:, None], "label": n} for n, v in (("u", u), ("level", level))]
    savemat(rig / "run.mat", {"log": {"time": time[:, None], "signals": np.array(signals, dtype=object)}})
    done = run("init", rig / "models" / "Rig.mo", rig / "run.mat", "--out", rig / "rig.toml")
    assert done.exit_code == 0, done.output
    found = tomllib.loads((rig / "rig.toml").read_text())["data"]["columns"]
    assert {name: column["source"] for name, column in found.items()} == {
        "time": "log.time", "u": "log.u", "level": "log.level",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("header", "lines"),
    [
        ("t_ms,U [mV],level/g", (
            'time = {source = "t_ms", unit = "ms"}', 'u = {source = "U [mV]", unit = "mV"}',
            'level = {source = "level/g", unit = "g"}',
        )),
        # what only its unit told is to be looked at
        ("min,drive (mV),mass_kg", (
            'u = {source = "drive (mV)", unit = "mV"}  # ', 'time = {source = "min", unit = "min"}  # ',
        )),
        ("time,first,second", ("# u = {source",)),
    ],
)  # fmt: skip
def test_columns_are_written_with_units_that_differ_and_others_as_comments(rig, header, lines):
    vessel.record(rig / "odd.csv", header, gain=1.5)
    done = run("init", rig / "models" / "Rig.mo", rig / "odd.csv", "--out", rig / "rig.toml")
    assert done.exit_code == 0, done.output
    text = (rig / "rig.toml").read_text()
    assert "parameters" in tomllib.loads(text)
    found = [next(line for line in text.splitlines() if line.startswith(begin)) for begin in lines]
    if header == "time,first,second":
        assert re.search(facts("first", "second"), found[0])


UNITS = {"time": "s", "i_load": "A", "v_out": "V"}


@pytest.mark.parametrize(
    ("wanted", "columns", "expected"),
    [
        (UNITS, ("t [us]", "Iload", "IL", "V-Out"), {"time": "t [us]", "i_load": "Iload", "v_out": "V-Out"}),
        (UNITS, ("s", "i_load", "U_out (mV)", "I_coil (A)"), {"time": "s", "i_load": "i_load", "v_out": "U_out (mV)"}),
        (UNITS, ("time", "i_load_1", "i_load_2", "a_mV", "b_mV"), {"time": "time"}),
        (UNITS, ("time", "v_out", "temp_degC"), {"time": "time", "v_out": "v_out"}),
        (None, ("time", "u", "y"), {"time": "time", "u": "u", "y": "y"}),
        (None, ("time", "Y [mm]", "U"), {"time": "time", "u": "U", "y": "Y [mm]"}),
        (None, ("time", "u", "U", "z"), {"time": "time", "u": "u"}),
        (None, ("time", "u", "reading"), {"time": "time", "u": "u", "y": "reading"}),
        (None, ("time", "a", "b"), {"time": "time"}),
        (None, ("t", "h1", "u", "y"), {"time": "t", "u": "u", "y": "y"}),
        (None, ("h1", "u", "y"), {"time": "h1", "u": "u", "y": "y"}),
    ],
)
def test_columns_are_matched_by_name_or_unit_where_only_one_fits(wanted, columns, expected):
    assert match_columns(tuple(wanted or ("time", "u", "y")), columns, wanted).columns == expected


@pytest.mark.parametrize("rig", sorted(RIGS.iterdir()), ids=lambda rig: rig.name)
def test_the_model_is_the_one_that_nothing_uses(rig):
    known = tomllib.loads((rig / "rig.toml").read_text())["model"]["name"]
    assert main_class(rig / "Rig.mo") == known


@pytest.mark.parametrize(
    ("column", "name", "unit"),
    [("time/s", "time", "s"), ("phi (deg)", "phi", "deg"), ("T_degC", "T", "degC"), ("F_cmd", "F_cmd", ""),
     ("temp_1", "temp_1", ""), ("q [l/min]", "q", "l/min"), ("Zeit [s]", "Zeit", "s"), ("m", "m", "")],
)  # fmt: skip
def test_a_unit_in_a_column_s_name(column, name, unit):
    assert split_unit(column) == (name, unit)


def test_defaults_of_a_library_are_listed_and_left(rig):
    """The user's own and what the user sets are free, whatever the outputs make of the rest."""
    library = rig / "lib" / "Lib.mo"
    library.parent.mkdir()
    library.write_text(
        """package Lib
  model Vessel
    parameter Real gain(unit = "kg/s", min = 0.1, max = 10) = 2;
    parameter Real k(unit = "1/s", min = 0.01, max = 10) = 0.3;
    parameter Real start_level(unit = "kg") = 0.1 "Unstretched";
    input Real u(unit = "V");
    output Real level(unit = "kg") = a - start_level;
    Real a(unit = "kg", start = 0, fixed = true);
  equation
    der(a) = gain * u - k * a;
  end Vessel;
end Lib;
"""
    )
    (rig / "Own.mo").write_text(
        """partial model Half
  parameter Real rate(unit = "1/s", min = 0.01, max = 10) = 0.3;
  Lib.Vessel vessel(k = rate, a(start = 0));
  input Real u(unit = "V");
end Half;
model Own
  extends Half;
  Lib.Vessel again[2](each gain = 1.5, each u = u);
  output Real level(unit = "kg") = vessel.level + again[1].level;
equation
  vessel.u = u;
end Own;
"""
    )
    done = run("init", rig / "Own.mo", rig / "run.csv", "--library", library.parent, "--out", rig / "rig.toml")
    assert done.exit_code == 0, done.output
    text = (rig / "rig.toml").read_text()
    assert set(tomllib.loads(text)["parameters"]) == {"rate", "again[1].gain"}
    left = [line for line in text.splitlines() if "library default" in line]
    assert {line.split('"')[1] for line in left} == {
        "vessel.gain", "vessel.start_level", "again[1].k", "again[2].k", "again[1].start_level", "again[2].start_level",
    }  # fmt: skip
