"""A package of one's own that declares its rig is treated as the shipped one is; other models get nothing of either."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from math import copysign
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes import LoopSettings, close_loop, load_model, read_recording
from aero_bayes.cli import main
from aero_bayes.data import Layout, Recording, write_csv
from aero_bayes.declared import DECLARATION_MEMBER
from aero_bayes.errors import InputError
from aero_bayes.estimate import parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.fit import declared_overrides
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.library import declaration_of
from aero_bayes.simulation.model import Model, ModelicaSource

SLEDGE = Path(__file__).parent.parent / "models" / "Sledge"
DECLARED = declaration_of("Sledge.Rig", [SLEDGE])
EXTENDED = "model Loaded\n  extends Sledge.Rig(M = 2);\nend Loaded;\n"
STRANGER = """model Stranger
  parameter Real R_a(unit = "Ohm") = 3;
  parameter Real J_p = 2;
  parameter Real D_t = 1;
  parameter Real c_m = 1;
  parameter Real k_t = 1;
  parameter Real K_sp = 1;
  input Real V_m;
  output Real theta(start = 0, fixed = true);
equation
  J_p * der(theta) = V_m * c_m * k_t * D_t - R_a * K_sp * theta;
end Stranger;
"""


def sledge(rng: np.random.Generator, name: str, friction: float) -> Recording:
    """A recording of the sledge with dry friction: steps of 0.2 ms, a sign in place of the rounded step."""
    time = np.arange(1501) / 50.0
    force = 8.0 * rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], 31)[(time / 1.0).astype(int)]
    x = v = 0.0
    positions = []
    for f in force:
        positions.append(x)
        for _ in range(100):
            free = v + 2e-4 * (f - 40.0 * x - 0.5 * v) / 1.1
            v = copysign(max(abs(free) - 2e-4 * friction / 1.1, 0.0), free)
            x += 2e-4 * v
    y = np.array(positions) + 1e-3 * rng.standard_normal(time.size)
    return Recording(name, time, {"F": force}, {"y": y}, {"time": "s", "F": "N", "y": "m"})


def test_priors_columns_and_reasons_come_from_the_package(tmp_path):
    model = load_model("Sledge.Rig", sources=[SLEDGE], folder=tmp_path)
    overrides = declared_overrides(model)
    assert list(overrides) == ["M", "R_a"]
    assert (overrides["M"].start, overrides["M"].lower, overrides["M"].upper) == (1.0, 0.25, 4.0)
    assert (overrides["R_a"].lower, overrides["R_a"].upper) == (pytest.approx(0.04), pytest.approx(5.0))
    assert model.declared.fixed == {"k": "weighed"}
    layout = Layout.of(declared=DECLARED)
    assert layout.units == {"time": "s", "F": "N", "y": "m"}
    mild = sledge(np.random.default_rng(1), "mild", 0.0)
    path = write_csv(replace(mild, inputs={"F": 10.0 * mild.inputs["F"]}), tmp_path / "far.csv")
    with pytest.raises(InputError, match="beyond 50 N"):
        read_recording(path, layout=layout)


def test_only_a_model_that_extends_a_system_has_its_declaration(tmp_path):
    for name, text in (("Loaded", EXTENDED), ("Stranger", STRANGER)):
        (tmp_path / f"{name}.mo").write_text(text)
    loaded = load_model("Loaded", sources=[SLEDGE, tmp_path / "Loaded.mo"])
    assert declared_overrides(loaded)["M"].start == 2.0
    family = ModelicaFamily(LawPlaces("Loaded", (SLEDGE, tmp_path / "Loaded.mo")), tmp_path)
    assert family.base_model().declared.recording == loaded.declared.recording
    stranger = load_model("Stranger", sources=[tmp_path / "Stranger.mo"])
    assert declared_overrides(stranger) == {}
    assert stranger.declared.fixed == {}
    time = np.arange(200) / 100.0
    step = Recording("step", time, {"V_m": np.where(time < 1.0, 0.0, 1.0)}, {"theta": 0.1 * time})
    calibration = calibrate([step], stranger, parameters_from_model(stranger, free=["R_a"]))
    assert [p.name for p in calibration.parameters] == ["R_a"], "no input delay of another rig"


def test_an_fmu_of_another_tool_goes_by_its_name(tmp_path):
    """Without the member that this exporter adds, only a shipped system is known."""
    for name, sources, known in (("Aero.Systems.HalfQuad", [], 8), ("Sledge.Rig", [SLEDGE], 0)):
        made = export_fmu(name, tmp_path / "made.fmu", sources=sources)
        with zipfile.ZipFile(made) as archive, zipfile.ZipFile(tmp_path / "plain.fmu", "w") as plain:
            for member in archive.namelist():
                if member != DECLARATION_MEMBER:
                    plain.writestr(member, archive.read(member))
        assert len(declared_overrides(Model.load(made))) in (8, 2)
        assert len(declared_overrides(Model.load(tmp_path / "plain.fmu"))) == known


def test_the_commands_take_it_from_there(tmp_path):
    config = tmp_path / "rig.toml"
    config.write_text(f'[model]\nname = "Sledge.Rig"\nsources = ["{SLEDGE}"]\n')
    listed = CliRunner().invoke(main, ["ports", "--config", str(config), "--json"])
    assert [row["id"] for row in json.loads(listed.stdout)] == ["rubbing", "snow"]
    path = write_csv(sledge(np.random.default_rng(1), "run", 0.3), tmp_path / "run.csv")
    out = tmp_path / "out"
    arguments = ["fit", "--config", config, "--data", path, "--out", out, "--workers", 1, "--quiet"]
    ran = CliRunner().invoke(main, [str(a) for a in arguments])
    assert ran.exit_code == 0, ran.output
    table = json.loads((out / "result.json").read_text())["parameters"]
    assert {name: entry["status"] for name, entry in table.items()} == {
        "M": "identified", "R_a": "identified", "k": "fixed",
    }  # fmt: skip
    assert table["k"]["note"] == "weighed"


@pytest.mark.long
def test_the_loop_finds_an_effect_by_the_name_that_the_package_gives_it(tmp_path):
    streams = np.random.default_rng(2).spawn(2)
    train, test = (sledge(rng, name, 0.6) for name, rng in zip(("train", "test"), streams, strict=True))
    settings = LoopSettings()
    found = close_loop(
        [train], [test], model=ModelicaSource("Sledge.Rig", (SLEDGE,)), settings=settings, workers=0, out_dir=tmp_path
    )
    assert [(e.id, e.port) for e in found.effects] == [("rubbing", "runners")]
    (friction,) = found.effects[0].parameters
    assert friction.value == pytest.approx(0.6, abs=5 * friction.sd + 0.02)
    assert "extends Sledge.Rig;\n" in found.modelica
    assert found.effects[0].summary == "runners that rub at runners"


def test_a_declaration_with_a_mistake_is_refused(tmp_path):
    package = tmp_path / "Sledge"
    shutil.copytree(SLEDGE, package)
    text = (package / "package.toml").read_text()
    (package / "package.toml").write_text(text.replace("starts", "stars"))
    with pytest.raises(InputError, match=r"package.toml: key 'effects.rubbing.stars'"):
        declaration_of("Sledge.Rig", [package])
    (package / "package.toml").write_text(text.replace("dry_runner@", "dry_runer@"))
    with pytest.raises(InputError, match=r"effects.rubbing.law: .*did you mean 'dry_runner@runners'"):
        LawPlaces("Sledge.Rig", (package,)).check()
    (package / "package.toml").write_text(
        text.replace("dry_runner@", "curve@").replace("runners", "F").replace("mass.flange", "y")
    )
    with pytest.raises(InputError, match=r"effects.rubbing.law: 'curve@F' names laws of several kinds"):
        LawPlaces("Sledge.Rig", (package,)).check()
    (package / "package.toml").write_text(text + "[[")
    with pytest.raises(InputError, match="not a valid declaration"):
        declaration_of("Sledge.Rig", [package])
