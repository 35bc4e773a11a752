"""Fits under noise that differs from reading to reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heated_room import C, G, fit, recording, with_readings

import aero_bayes
from aero_bayes.errors import InputError
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.objective import Objective
from aero_bayes.simulation.engines import open_simulator


def with_outliers(seed: int) -> aero_bayes.Recording:
    rng = np.random.default_rng(100 + seed)
    return with_readings(
        recording(seed=seed),
        lambda y: np.where(rng.random(y.size) < 0.03, y + 0.4 * rng.choice([-1.0, 1.0], y.size), y),
    )


def with_relative_noise(seed: int) -> aero_bayes.Recording:
    rng = np.random.default_rng(200 + seed)
    return with_readings(recording(seed=seed), lambda y: y + 0.03 * np.abs(y - 285.0) * rng.normal(size=y.size))


def test_relative_noise_is_told_and_not_blamed_on_the_model(room: aero_bayes.Model) -> None:
    found = fit(with_relative_noise(1), room)
    assert found.noise_table()["T"]["kind"] == "relative"
    assert found.diagnosis["noise"].found
    assert not found.diagnosis["model"].found


def test_declared_heavy_tails_hold_the_truth(room: aero_bayes.Model) -> None:
    settings = aero_bayes.FitSettings(noise=NoiseModel(outputs=(("T", "student"),)))
    found = aero_bayes.fit(with_outliers(2), room, parameters=["C", "G"], settings=settings, workers=0)
    assert found.noise_table()["T"]["kind"] == "student"
    assert abs(found["C"].value - C) < 4.0 * found["C"].sd
    assert abs(found["G"].value - G) < 4.0 * found["G"].sd


def test_engine_and_residuals_give_one_likelihood(room: aero_bayes.Model) -> None:
    found = fit(with_relative_noise(4), room)
    assert found.calibration.data.spreads
    with open_simulator(found.calibration.problem(), workers=0) as simulator:
        objective = Objective(found.calibration, simulator)
        for name, noise in [("white", found.noise), ("ou", {"T": replace(found.noise["T"], sd_ou=0.05, tau=600.0)})]:
            evaluated = objective.evaluate(objective.parameters.to_search(found.values))
            assert evaluated is not None
            white = objective.whiten(evaluated, noise)
            reduced = objective.log_likelihood(found.values[None], objective.noise_rows(noise)).sum()
            assert reduced == pytest.approx(white.log_likelihood, rel=1e-9), name


def two_sensors() -> list[aero_bayes.Recording]:
    rng = np.random.default_rng(7)
    poor = with_readings(recording(seed=6), lambda y: y + 1.0 * rng.normal(size=y.size))
    return [recording(seed=5), replace(poor, name="poor")]


def test_each_recording_has_the_noise_of_its_sensor(room: aero_bayes.Model) -> None:
    both, alone = fit(two_sensors(), room), fit(recording(seed=5), room)
    assert both.noise_table()["T"]["by_recording"] == pytest.approx({"run": 0.05, "poor": 1.0}, rel=0.1)
    assert both["G"].sd < 1.02 * alone["G"].sd
    assert not both.diagnosis["model"].found
    assert "by_recording" not in fit([recording(seed=8), replace(recording(seed=9), name="b")], room).noise_table()["T"]


def test_a_known_noise_is_not_estimated(room: aero_bayes.Model) -> None:
    settings = aero_bayes.FitSettings(noise=NoiseModel(sd={"T": {"run": 0.1, "poor": 1.0}}))
    found = aero_bayes.fit(two_sensors(), room, parameters=["C", "G"], settings=settings, workers=0)
    assert found.noise_table()["T"]["by_recording"] == pytest.approx({"run": 0.1, "poor": 1.0})
    assert [name for name in found.laplace.names if name.startswith("noise")] == []
    estimated = fit(two_sensors(), room)
    assert found["G"].sd == pytest.approx(2.0 * estimated["G"].sd, rel=0.1)
    settings = aero_bayes.FitSettings(noise=NoiseModel(sd={"T": {"run": 0.1}}))
    with pytest.raises(InputError, match="poor"):
        aero_bayes.fit(two_sensors(), room, parameters=["C", "G"], settings=settings, workers=0)
