"""Laws around an FMU without source, against the same laws in the source, and the loop on such an FMU."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from export_driver import driven
from facts import facts
from fmpy.validation import validate_fmu
from numpy.random import Generator
from numpy.typing import NDArray
from small_rigs import RIGS, Numbers, explicit, rig, somewhere
from written_laws import written_flat

from aero_bayes.cli import main
from aero_bayes.errors import InputError
from aero_bayes.laws.attach import LawBlocks, attached
from aero_bayes.laws.balance import Port
from aero_bayes.laws.candidates import PlacedLaw, find_candidates, place_law, ports_with_laws
from aero_bayes.laws.coupled_fmu import couple
from aero_bayes.laws.law import Law
from aero_bayes.loop.fmu_family import FmuFamily, FmuPlaces
from aero_bayes.modelica.embedded import export_embedded, export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]
#: Laws at an input, at readings, at a force; the values of their first parameters.
ASKED = {"dead_zone@u": 0.3, "lag@u": 0.07, "delay@x": 0.05, "gain@a": 0.2, "coulomb_friction@v": 0.2}
SIZES = {"u_n": 2.0, "f_n": 2.0, "v_n": 1.0, "x_n": 1.0, "t_n": 0.3}


def exported(folder: Path) -> Model:
    return Model.load(export_embedded("Plant", folder / "Plant.fmu", [RIGS / "Plant.mo"]))


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return exported(tmp_path_factory.mktemp("plant"))


def placed_laws(ports: tuple[Port, ...], laws: tuple[Law, ...], flat: FlatModel) -> list[PlacedLaw]:
    """The asked laws at ports whose names do not matter."""
    taken = {v.name for v in flat.variables}
    found = {}
    for c in find_candidates(ports, laws):
        id_ = c.id.replace("output_", "")
        if id_ in ASKED:
            found[id_] = place_law(c, taken, nominals=SIZES, values={c.law.magnitude.name: ASKED[id_]})
            taken |= {found[id_].instance, *found[id_].names.values()}
    return [found[id_] for id_ in ASKED]


def run(path: Path) -> tuple[FloatArray, FloatArray]:
    """Outputs and their sensitivities to all parameters that matter, by the names that both models share."""
    model = Model.load(path)
    model = replace(model, relay=None, operators=() if any(o.memory for o in model.operators) else model.operators)
    t = np.linspace(0.0, 6.0, 301)
    signal = InputSignal("u", t, 2.0 * np.sign(np.sin(2.0 * t)) + np.sin(5.0 * t))
    names = ("m", "d", "u_d", "T_l", "T_d", "g", "F_c")
    targets = (*map(ParameterTarget, names), StartTarget("x_unread" if path.stem == "coupled" else "x_true"))
    problem = Problem(
        model, (Experiment(t, ("x", "a"), (signal,)),), (targets,), settings=SolverSettings(1e-8, 1e-8, 100000, 20.0)
    )
    values = np.array([[*(model.parameter(n).start for n in names), 0.1]])
    with open_simulator(problem) as simulator:
        found = simulator.simulate(values, active=range(len(targets)))
    assert found.outcomes[0, 0] == Outcome.OK
    return found.outputs[0][0], found.sensitivities[0][0]


def test_laws_around_an_fmu_are_the_laws_in_its_source(laws, models, tmp_path):
    """Two implementations: the chain rule between two binaries, and one system of equations."""
    plant = exported(tmp_path)
    flat = rig("Plant")
    inside = placed_laws(ports_with_laws(flat, laws), laws, flat)
    export_flat(written_flat("Plant", [RIGS / "Plant.mo"], inside, tmp_path), tmp_path / "source.fmu")
    around = FmuPlaces("Plant", fmu=plant.path)
    blocks = LawBlocks(models, tmp_path)
    couple(attached(around.opened(), placed_laws(around.ports, laws, flat), blocks), tmp_path / "coupled.fmu")
    assert validate_fmu(str(tmp_path / "coupled.fmu")) == []
    (y, s), (y_source, s_source) = run(tmp_path / "coupled.fmu"), run(tmp_path / "source.fmu")
    assert np.abs(y - y_source).max(axis=0) == pytest.approx([0.0, 0.0], abs=1e-6)
    worst = np.abs(s - s_source).max(axis=0) / np.abs(s_source).max(axis=0).max(axis=0)
    assert worst.max() < 1e-3


def assert_written_is_coupled(name: str, text: Path, coupled: Path, modelica: Callable[..., Path], rng: Generator):
    """The Modelica file, the imported FMU being its own source, has the rates and outputs of the written FMU."""
    stand_in = modelica((RIGS / "Plant.mo").read_text().replace("Plant", "Plant_fmu"))
    again = Numbers(explicit(load_flat(name, [stand_in, text])))
    point = somewhere(again.names(), rng)
    with driven(coupled) as fmu:
        fmu.begin()
        fmu.set(u=point["u"], **{n: again.at[again.b.symbol(f"plant.{n}")] for n in "mdk"})
        names = {s: s if s in point else f"plant.{s.removesuffix('_unread')}" for s in fmu.states}
        rates = fmu.rhs(np.array([point[names[s]] for s in fmu.states]))
        found = {f"der({names[s]})": rate for s, rate in zip(fmu.states, rates, strict=True)}
        found |= dict(zip(("x", "a"), fmu.get("x", "a"), strict=True))
    assert found == pytest.approx(again(point), rel=1e-9)


def test_the_text_around_an_fmu_is_the_table_of_the_coupled_one(plant, laws, modelica, tmp_path, rng):
    """Laws behind each other at an input, at readings and at a force."""
    family = FmuFamily(FmuPlaces("Plant", fmu=plant.path), tmp_path / "built")
    found = placed_laws(family.places.ports, laws, rig("Plant"))
    written, coupled = family._write(found, {}, tmp_path / "written")
    assert_written_is_coupled(written.name, written.path, coupled.path, modelica, rng)


def measure(rng: Generator, seconds: float = 8.0) -> FloatArray:
    """Time, input, reading of a mass on a spring behind a dead zone of 0.4 N; exact between steps of the input."""
    m, d, k, u_d, dt = 2.2, 0.9, 12.0, 0.4, 0.02
    t = np.arange(0.0, seconds, dt)
    u = np.repeat(rng.uniform(-3.0, 3.0, 1 + int(seconds / 0.5)), 25)[: t.size]
    acts = np.sign(u) * np.maximum(np.abs(u) - u_d, 0.0)
    a = np.array([[0.0, 1.0], [-k / m, -d / m]])
    values, vectors = np.linalg.eig(a)
    phi = (vectors * np.exp(values * dt) @ np.linalg.inv(vectors)).real
    into = np.linalg.solve(a, (phi - np.eye(2)) @ np.array([0.0, 1.0 / m]))
    x = np.zeros((t.size, 2))
    x[0, 0] = 0.1
    for i in range(t.size - 1):
        x[i + 1] = phi @ x[i] + into * acts[i]
    return np.column_stack([t, u, x[:, 0] + rng.normal(0.0, 2e-3, t.size)])


@pytest.mark.long
def test_the_loop_finds_what_an_fmu_lacks(plant, modelica, tmp_path, rng):
    for name in ("train", "test"):
        np.savetxt(tmp_path / f"{name}.csv", measure(rng), delimiter=",", header="time,u,x", comments="")
    config = tmp_path / "rig.toml"
    config.write_text(
        '[data]\ninputs = ["u"]\noutputs = ["x"]\n[parameters]\nm = {free = true}\nd = {free = true}\n'
        'k = {value = 12.0}\n[loop]\nlaws = ["dead_zone", "gain", "coulomb_friction"]\n'
    )
    out = tmp_path / "out"
    asked = ["close-loop", "--model", plant.path, "--config", config, "--out", out, "--workers", 1, "--quiet"]
    asked += ["--train", tmp_path / "train.csv", "--test", tmp_path / "test.csv"]
    done = CliRunner().invoke(main, list(map(str, asked)), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    loop = json.loads((out / "result.json").read_text())["loop"]
    (effect,) = loop["effects"]
    assert effect["id"] == "dead_zone@u"
    found = effect["parameters"]["u_d"]
    assert found["value"] == pytest.approx(0.4, abs=5.0 * found["sd"] + 1e-3)
    assert loop["after"]["test"]["x"] < 1.2 * 2e-3 < 0.2 * loop["before"]["test"]["x"]

    name, path = loop["model"], out / effect["modelica"]
    assert_written_is_coupled(name, path, out / f"{name}.fmu", modelica, np.random.default_rng(3))
    assert re.search(r"plant\(m = 2\..*k = 12\.0\)", path.read_text())


def test_an_fmu_with_co_simulation_only_is_refused(plant, tmp_path):
    path = tmp_path / "Steps.fmu"
    with zipfile.ZipFile(plant.path) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                data = data.replace(b"<ModelExchange", b"<NoExchange").replace(b"</ModelExchange", b"</NoExchange")
            new.writestr(name, data)
    done = CliRunner().invoke(main, ["ports", "--model", str(path)])
    assert done.exit_code == 2
    assert re.search(facts("Model Exchange"), done.output)


def test_every_input_and_output_is_a_port(plant):
    ports = {p.id: p for p in FmuPlaces("Plant", fmu=plant.path).ports}
    assert {k: p.kind for k, p in ports.items()} == {"u": "input", "x": "reading", "a": "reading", "v": "motion"}
    assert {"gain", "offset", "dead_zone", "saturation", "lag", "delay"} <= {*ports["u"].laws}
    assert {*ports["a"].laws} == {
        "gain", "offset", "saturation", "saturation_by_side", "unsigned", "lag", "lag_of_second_order",
        "delay", "curve",
    }  # fmt: skip
    assert {signal: str(given) for signal, given in ports["v"].signals.items()} == {"v": "v_inside", "x": "x_inside"}


def test_a_wrong_law_is_named(plant, tmp_path):
    from aero_bayes.laws.law_places import CandidateFilter

    places = FmuPlaces("Plant", candidate_filter=CandidateFilter(laws=("deadzone",)), fmu=plant.path)
    with pytest.raises(InputError, match=facts("deadzone", "dead_zone")):
        places.check()
