"""A drop of potential in a branch of a circuit, also where more than two connectors meet: a capacitor's resistance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from port_models import FILTER, MODELS
from small_rigs import RIGS

from aero_bayes.laws.attach import AlgebraicLoopError
from aero_bayes.laws.candidates import find_candidates, place_law, ports_with_laws
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.write_model import write_laws
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.rumoca_front import load_flat

TIME = np.linspace(0.0, 0.5, 51)


def answer(fmu: Path) -> np.ndarray:
    """The output every 10 ms after a step to 3 V."""
    found = simulate_fmu(
        str(fmu), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, stop_time=0.5,
        output_interval=0.01, start_values={"u": 3.0}, output=["y"],
    )  # fmt: skip
    return found["y"]


@pytest.mark.parametrize(
    ("name", "port", "values", "expected", "tolerance", "line"),
    [
        (
            "filter of components", "capacitor.p", {"series_resistance": {"R_s": 25.0}},
            3.0 * (1.0 - 0.8 * np.exp(-TIME / 0.125)), 1e-5, "connect(leak.p, series_resistance.p);",
        ),
        (
            "filter of components", "resistor.p", {"series_resistance": {"R_s": 25.0}, "contact_drop": {"V_c": 0.4}},
            2.6 * (1.0 - np.exp(-TIME / 0.125)), 1e-4, "",
        ),
        (
            "grounded capacitor", "series_one.p", {"series_resistance": {"R_s": 50.0}},
            3.0 * (1.0 - np.exp(-TIME / 0.15)), 1e-4, "",
        ),
    ],
)  # fmt: skip
def test_drops_in_a_branch(name, port, values, expected, tolerance, line, laws, tmp_path):
    """Written they stand before one pin; the search, too, solves them with the model, whose current they change."""
    model = MODELS[name]
    sources = model.written_to(tmp_path)
    flat = load_flat(model.name, sources)
    (place,) = (p for p in ports_with_laws(flat, laws) if p.id == port)
    placed_laws = [
        place_law(c, (), nominals={"v_n": 1.0, "i_n": 0.01}, values=values[c.law.id])
        for c in find_candidates([place], laws) if c.law.id in values
    ]  # fmt: skip
    assert len(placed_laws) == len(values)
    written = write_laws(sources, model.name, flat, placed_laws, tmp_path / "out")
    lines = [one.strip() for one in written.text.splitlines()]
    assert line in written.text
    assert sum(one.endswith(f"{port.removeprefix('series_')});") for one in lines) == 1
    y = answer(export_flat(load_flat(written.name, [*sources, written.path]), tmp_path / "written.fmu"))
    assert np.abs(y - expected).max() < tolerance
    family = ModelicaFamily(LawPlaces(model.name, tuple(sources)), tmp_path / "fmus")
    family.placed.update({placed.id: placed for placed in placed_laws})
    with pytest.raises(AlgebraicLoopError):
        family._attached(placed_laws)
    assert np.abs(answer(family.with_candidates([*family.placed]).model.path) - expected).max() < 1e-4


def test_a_branch_has_one_place(laws, modelica):
    text = FILTER.replace(
        "  connect(source.p, resistor.p);", "  connect(source.p, one.p);\n  connect(one.n, resistor.p);"
    )
    path = modelica(text.replace("  Shaft.Ground", "  Shaft.Resistor one(R = 7);\n  Shaft.Ground"))
    flat = load_flat("Filter", [RIGS / "Shaft.mo", path])
    found = [p.id for p in ports_with_laws(flat, laws) if p.kind == "electrical"]
    # the third is that of the two resistors, which share a current
    assert len(found) == 3
    assert {"capacitor.p", "leak.p"} < set(found)
