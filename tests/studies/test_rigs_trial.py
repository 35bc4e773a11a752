"""Trials over many rigs: drawn as asked for, the truth apart, and distances that mean what they say."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, Problem, SolverSettings, StartTarget
from aero_bayes.simulation.model import Model
from simulated_rigs.experiment import RigExperiment, arma_innovations
from simulated_rigs.kinds import KINDS
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.trial import MODELS, draw_rig_trial, write_trial
from simulated_rigs.truth import LawPlace, LawTruth, law_places, simulate_rig

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", KINDS)
def test_the_modelica_model_and_the_simulator_are_the_same_rig(name: str, tmp_path: Path) -> None:
    kind, folder = KINDS[name], MODELS / name
    settings = tomllib.loads((folder / "rig.toml").read_text())
    assert settings["data"] == {"inputs": list(kind.inputs), "outputs": list(kind.outputs)}
    assert set(settings["parameters"]) == set(kind.free)
    fmu = export_fmu(settings["model"]["name"], tmp_path / "rig.fmu", compiler="embedded", sources=[folder / "Rig.mo"])
    model = Model.load(fmu)
    declared = {item.name: item for item in model.parameters}
    assert {name: declared[name].start for name in kind.parameters} == kind.parameters
    trial = draw_rig_trial(name, 1, what="none")
    noise_free = trial.noise_free["test"]
    # A state that an output shows may go by the output's name.
    found, shown = {item.name for item in model.states}, kind.plant(kind.parameters).shown
    aliases = dict(zip((list(kind.states)[index] for index in shown), kind.outputs, strict=True))
    states = [state if state in found else aliases[state] for state in kind.states]
    assert found == set(states)
    assert {"time": "s"} | {item.name: item.unit or "" for item in (*model.inputs, *model.outputs)} == kind.units
    rows = 500
    start = dict(zip(states, trial.starts["test"], strict=True))
    experiment = Experiment(
        noise_free.time[:rows],
        tuple(kind.outputs),
        tuple(
            InputSignal(column, noise_free.time[:rows], values[:rows]) for column, values in noise_free.inputs.items()
        ),
        start,
    )
    targets = (tuple(StartTarget(state) for state in states),)
    problem = Problem(model, (experiment,), targets, trial.parameters, SolverSettings(1e-9, 1e-9))
    with open_simulator(problem, workers=0) as simulator:
        outputs = simulator.simulate(np.array([list(start.values())])).outputs[0][0]
    expected = noise_free.measured(tuple(kind.outputs))
    assert (np.abs(outputs - expected[:rows]).max(axis=0) < 2e-6 * np.ptp(expected, axis=0)).all()


def test_trials_are_what_was_asked_for(tmp_path: Path) -> None:
    for what, count in (("none", 0), ("law", 1), ("pair", 2), ("outside", 1)):
        trial = draw_rig_trial("heat", 3, 17001, what)  # type: ignore[arg-type]
        assert len({law.place for law in trial.laws}) == len(trial.laws) == count
        listed = {law for law, _ in law_places(trial.kind)}
        assert all((law.law in listed) == (what != "outside") for law in trial.laws)
        assert all(0.7 <= value / KINDS["heat"].parameters[name] <= 1.3 for name, value in trial.parameters.items())
        assert all(1.0 <= law.d < 400.0 for law in trial.laws)
    again = draw_rig_trial("heat", 3, 17001, "outside")
    np.testing.assert_array_equal(again.train.outputs["T_plate"], trial.train.outputs["T_plate"])
    assert draw_rig_trial("heat", 3, 11001, "outside").parameters != trial.parameters
    assert not np.array_equal(trial.train.inputs["P"], trial.test.inputs["P"])
    noise = trial.train.outputs["T_plate"] - trial.noise_free["train"].outputs["T_plate"]
    assert noise.std() == pytest.approx(np.hypot(trial.noise["T_plate"].white, trial.noise["T_plate"].slow), rel=0.2)
    write_trial(trial, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["Rig.mo", "rig.toml", "test.csv", "train.csv"]
    assert (tmp_path / "train.csv").read_text().splitlines()[0] == "time,P,T_heater,T_plate"


def test_whitening_is_the_noise_covariance() -> None:
    """Against the dense covariance of white noise and an Ornstein-Uhlenbeck process, after the first readings."""
    noise, time = SensorNoise(0.3, 0.5, 0.7), np.arange(300) * 0.1
    covariance = 0.25 * np.exp(-np.abs(time[:, None] - time) / 0.7) + 0.09 * np.eye(300)
    values = np.sin(0.8 * time) + 0.2 * np.cos(5.0 * time)
    exact = values @ cho_solve(cho_factor(covariance), values)
    assert np.sum(arma_innovations(values, noise, 0.1) ** 2) == pytest.approx(exact, rel=0.02)
    np.testing.assert_allclose(arma_innovations(values, SensorNoise(0.3), 0.1), values / 0.3)


def experiment(name: str) -> RigExperiment:
    trial = draw_rig_trial(name, 7, what="none")
    train, start = trial.noise_free["train"], trial.starts["train"]
    commands = np.column_stack(list(train.inputs.values()))
    clean = simulate_rig(trial.kind, trial.parameters, [], train.time, commands, start)
    return RigExperiment(trial.kind, trial.parameters, start, train.time, commands, trial.noise, clean)


def test_the_distance_is_what_a_free_fit_of_the_base_model_leaves() -> None:
    stick = experiment("heat")
    law = LawTruth("radiation", LawPlace("balance", "heater.T"), {"k": 3e-9})
    there = stick.white(stick.outputs([law]))
    fit = least_squares(lambda change: there - stick.white(stick.outputs([], change)), np.zeros(6), xtol=1e-10)
    found = stick.distance([law], [])
    assert found > 5.0
    assert found == pytest.approx(np.sqrt(2.0 * fit.cost), rel=0.05)


@pytest.mark.parametrize(
    ("name", "law", "state", "parameters"),
    [
        ("motor", "viscous_friction", "w", {"d": 1e-4}),
        ("heat", "linear_loss", "plate.T", {"k": 0.2}),
        ("reservoirs", "linear_loss", "second.h", {"k": 1e-4}),
    ],
)
def test_laws_that_are_left_out_are_changes_of_the_parameters(name: str, law: str, state: str, parameters) -> None:
    stick = experiment(name)
    there = LawTruth(law, LawPlace("balance", state), parameters)
    plain, changed = stick.outputs([]), stick.outputs([there])
    assert np.linalg.norm(stick.white(changed - plain)) > 20.0
    assert stick.distance([there], []) < 0.5
