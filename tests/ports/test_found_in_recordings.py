"""What acts between two motions is found in recordings, and written into both balances."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from closed_form import runge_kutta
from port_models import CAR

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.loop import LoopSettings, close_loop

M_B, M_W, K_S, C_S, K_T, K_3 = 250.0, 40.0, 16000.0, 1500.0, 160000.0, 8e6


def drive(name: str, seed: int) -> Recording:
    """A suspension whose spring stiffens: fourth-order Runge-Kutta, the road in straight lines."""
    rng = np.random.default_rng(seed)
    road = 1.5 * np.convolve(np.cumsum(rng.normal(0.0, 0.004, 700)), np.ones(10) / 10.0, "same")
    steps = 20

    def slope(x, height):
        apart = x[0] - x[2]
        force = K_S * apart + C_S * (x[1] - x[3]) + K_3 * apart**3
        return np.array([x[1], -force / M_B, x[3], (force - K_T * (x[2] - height)) / M_W])

    x, h, read = np.zeros(4), 0.01 / steps, [np.zeros(4)]
    for begin, end in itertools.pairwise(road):
        for k in range(steps):
            at = tuple(begin + (end - begin) * (k + part) / steps for part in (0.0, 0.5, 1.0))
            x = runge_kutta(slope, x, at, h)
        read.append(x)
    seen = np.array(read)[:, [0, 2]] + rng.normal(0.0, 2e-4, (700, 2))
    return Recording(name, 0.01 * np.arange(700), {"road": road}, {"body": seen[:, 0], "wheel": seen[:, 1]})


@pytest.mark.long
def test_a_stiffening_spring_is_found_and_written_into_both_balances(tmp_path):
    (tmp_path / "Car.mo").write_text(CAR, encoding="utf-8")
    settings = LoopSettings(
        max_effects=2, parameters=("k_s", "c_s"),
        laws=("cubic_stiffness", "coulomb_friction", "quadratic_drag"), cache=tmp_path / "fmu",
        fit=FitSettings(method="local", calibration=CalibrationSettings(interpolation="linear")),
    )  # fmt: skip
    result = close_loop([drive("a", 51)], [drive("b", 52)], model=tmp_path / "Car.mo", settings=settings, workers=0)
    assert [effect.id for effect in result.effects] == ["cubic_stiffness@v_b-v_w"]
    assert result.effects[0].parameters[0].value == pytest.approx(K_3, rel=0.02)
    assert result.parameters["k_s"].value == pytest.approx(K_S, rel=0.02)
    assert all(rms < 1.1 * 2e-4 for rms in result.predicted_after.pooled("test").values())
    assert result.predicted_before.pooled("test")["body"] > 3.0 * 2e-4
    assert result.modelica.count("k_3 * (body - wheel) ^ 3") == 2
