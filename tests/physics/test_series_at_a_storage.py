"""A drop of potential before a storage, where more than two connectors meet: the series resistance of a capacitor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from fmpy import simulate_fmu
from physics_rigs import RIGS

from aero_bayes.export.embedded import export_flat
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.physics.compose import Models, compose_law
from aero_bayes.physics.find import ports_of
from aero_bayes.physics.laws import Law
from aero_bayes.physics.ports import candidates
from aero_bayes.physics.use import use_of
from aero_bayes.physics.write import write_law

FILTER = """within ;
model Filter "Source, resistor, capacitor, and a probe at their node"
  model Capacitor
    extends Shaft.TwoPin(v(start = 0, fixed = true));
    parameter Real C(unit = "F") = 1e-3;
  equation
    C * der(v) = i;
  end Capacitor;
  input Real u(unit = "V");
  output Real y(unit = "V") = leak.p.v;
  Shaft.Source source(u = u);
  Shaft.Resistor resistor(R = 100);
  Shaft.Resistor leak(R = 1e9);
  Capacitor capacitor;
  Shaft.Ground ground;
equation
  connect(source.p, resistor.p);
  connect(resistor.n, capacitor.p) annotation (Line(points = {{0,0},{1,1}}));
  connect(leak.p, capacitor.p);
  connect(capacitor.n, ground.p);
  connect(source.n, ground.p);
  connect(leak.n, ground.p);
end Filter;
"""


def test_the_series_resistance_of_a_capacitor(laws: tuple[Law, ...], models: Models, tmp_path: Path) -> None:
    """The response to a step begins at once, and then has a longer time constant."""
    path = tmp_path / "Filter.mo"
    path.write_text(FILTER, encoding="utf-8")
    sources = [RIGS / "Shaft.mo", path]
    flat = load_flat("Filter", sources)
    ports = {p.id: p for p in ports_of(flat, laws)}
    assert ports["capacitor.v"].kind == "storage"
    assert (ports["capacitor.p"].kind, ports["capacitor.p"].via) == ("electrical", "series")
    series = 25.0
    (c,) = (c for c in candidates([ports["capacitor.p"]], laws) if c.law.id == "series_resistance")
    use = use_of(c.law, c.port, (), sizes={"v_n": 1.0, "i_n": 0.01}, values={"R_s": series})
    written = write_law(sources, "Filter", flat, [use], tmp_path / "out")
    lines = [line.strip() for line in written.text.splitlines()]
    assert "connect(leak.p, series_resistance.p);" in lines
    assert lines.count("connect(series_resistance.n, capacitor.p);") == 1
    t = np.linspace(0.0, 0.5, 51)
    expected = 3.0 * (1.0 - 100.0 / (100.0 + series) * np.exp(-t / ((100.0 + series) * 1e-3)))
    for made, name in (
        (compose_law(flat, use, models), "composed"), (load_flat(written.name, [*sources, written.path]), "written"),
    ):  # fmt: skip
        file = export_flat(made, tmp_path / f"{name}.fmu")
        y = simulate_fmu(
            str(file), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, stop_time=0.5,
            output_interval=0.01, start_values={"u": 3.0}, output=["y"],
        )["y"]  # fmt: skip
        assert np.abs(y - expected).max() < 1e-5
