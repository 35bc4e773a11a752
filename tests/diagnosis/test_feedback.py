"""An input that a controller sets by an output is told where something disturbs the output, and no other input."""

from __future__ import annotations

import heated_room
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording

pytestmark = pytest.mark.fast
INTERVAL, ROWS = 120.0, 480


def disturbed(seed: int, computed: int | None = None, load: float = 300.0, curve: float = 0.0) -> Recording:
    """The room, exact from reading to reading, under a load of an hour's memory that nobody records.

    The heater is set by a PI controller from the reading ``computed`` samples ago, or by chance. With ``curve``
    (W/K3), the loss is more than proportional."""
    rng = np.random.default_rng(seed)
    decay, memory = np.exp(-heated_room.G / heated_room.C * INTERVAL), np.exp(-INTERVAL / 3600.0)
    wanted = 293.15 + np.repeat(rng.choice([0.0, 2.0, 4.0], ROWS // 60), 60)
    power, read = rng.choice([500.0, 1300.0, 2100.0, 3000.0], ROWS), np.empty(ROWS)
    x, disturbance, total = 293.15, 0.0, 0.0
    for k in range(ROWS):
        read[k] = x + 0.02 * rng.standard_normal()
        if computed is not None:
            error = wanted[k] - read[max(k - computed, 0)]
            total += error * INTERVAL / 3600.0
            power[k] = 1800.0 + 800.0 * (error + total)
        end = 278.0 + (power[k] + disturbance - curve * (x - 288.0) ** 3) / heated_room.G
        x = end + (x - end) * decay
        disturbance = memory * disturbance + load * np.sqrt(1.0 - memory**2) * rng.standard_normal()
    inputs = {"P": power, "T_amb": np.full(ROWS, 278.0)}
    return Recording("run", INTERVAL * np.arange(ROWS), inputs, {"T": read}, heated_room.UNITS)


def told(given: Recording, room: aero_bayes.Model) -> tuple[aero_bayes.Fit, list[tuple[str, str]]]:
    fit = heated_room.fit(given, room)
    return fit, [(f.kind, f.signal) for f in fit.calibration.data.recordings[0].findings]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("computed", [0, 1])
def test_a_controller_that_answers_a_load(room: aero_bayes.Model, seed: int, computed: int) -> None:
    fit, found = told(disturbed(seed, computed), room)
    assert found == [("feedback", "P")]
    assert (f"residual of T {computed * INTERVAL:.0f} s before" in fit.diagnosis["data"].what) == (computed > 0)
    assert fit.diagnosis.explanation is None  # an effect may be missing, too


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_load_without_a_controller(room: aero_bayes.Model, seed: int) -> None:
    assert told(disturbed(seed), room)[1] == []


def test_a_controller_without_a_load(room: aero_bayes.Model) -> None:
    """White noise of the readings alone does not bias: an input acts on later readings only."""
    fit, found = told(disturbed(1, computed=0, load=0.0), room)
    assert found == []
    assert fit["C"].value == pytest.approx(heated_room.C, rel=0.01)


def test_a_loss_that_the_model_lacks_is_no_feedback(room: aero_bayes.Model) -> None:
    fit, found = told(disturbed(1, load=0.0, curve=0.5), room)
    assert fit.noise["T"].model_error
    assert found == []
