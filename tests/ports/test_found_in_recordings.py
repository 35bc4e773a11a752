"""What is missing inside a model is found in recordings: between motions, in a loop, against an ambient temperature."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from closed_form import held, runge_kutta
from port_models import AXIS, CAR, CASCADE, OVEN

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.loop import LoopSettings, close_loop

M_B, M_W, K_S, C_S, K_T, K_3 = 250.0, 40.0, 16000.0, 1500.0, 160000.0, 8e6
C, G, LOSS = 300.0, 1.0, 0.02
LIMIT = 15.0
#: Standard deviation of the noise, by output.
NOISE = {"body": 2e-4, "wheel": 2e-4, "y": 0.002, "T": 0.05}


def in_lines(slope: Callable, x: np.ndarray, inputs: Iterable[tuple], step: float, parts: int) -> np.ndarray:
    """States at each sample, the inputs in straight lines from the first to the second value of each interval."""
    read, h = [x], step / parts
    for begin, end in inputs:
        for k in range(parts):
            at = tuple(begin + (end - begin) * (k + part) / parts for part in (0.0, 0.5, 1.0))
            x = runge_kutta(slope, x, at, h)
        read.append(x)
    return np.array(read)


def drive(name: str, seed: int) -> Recording:
    """A suspension whose spring stiffens."""
    rng = np.random.default_rng(seed)
    road = 1.5 * np.convolve(np.cumsum(rng.normal(0.0, 0.004, 700)), np.ones(10) / 10.0, "same")

    def slope(x, height):
        apart = x[0] - x[2]
        force = K_S * apart + C_S * (x[1] - x[3]) + K_3 * apart**3
        return np.array([x[1], -force / M_B, x[3], (force - K_T * (x[2] - height)) / M_W])

    seen = in_lines(slope, np.zeros(4), itertools.pairwise(road), 0.01, 20)[:, [0, 2]] + rng.normal(
        0.0, NOISE["body"], (700, 2)
    )
    return Recording(name, 0.01 * np.arange(700), {"road": road}, {"body": seen[:, 0], "wheel": seen[:, 1]})


def motion(name: str, seed: int) -> Recording:
    """An axis whose force is limited, the controller's integral going on."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, -0.4, 0.0, 0.4, 1.0], 8), 80)

    def slope(x, aim):
        error = aim - x[0]
        force = np.clip(40.0 * error + 10.0 * x[2] - 4.0 * x[1], -LIMIT, LIMIT)
        return np.array([x[1], (force - 2.0 * x[1]) / 0.5, error])

    y = held(slope, np.zeros(3), r, 0.01, 20)[:, 0]
    return Recording(name, 0.01 * np.arange(r.size), {"r": r}, {"y": y + rng.normal(0.0, NOISE["y"], r.size)})


def cascade(name: str, seed: int) -> Recording:
    """A first filter whose output an amplifier limits at -0.8 and 0.5 V."""
    rng = np.random.default_rng(seed)
    u, h = np.repeat(rng.uniform(-1.5, 1.5, 150), 12), 0.02

    def slope(x, level):
        return np.array([(level - x[0]) / 0.1, (np.clip(1.1 * x[0], -0.8, 0.5) - x[1]) / 0.3])

    y = held(slope, np.zeros(2), u, h, 4)[:, 1]
    return Recording(name, h * np.arange(u.size), {"u": u}, {"y": y + rng.normal(0.0, NOISE["y"], u.size)})


def bake(name: str, seed: int) -> Recording:
    """An oven that loses by the square of what it is warmer than the hall; the power in steps."""
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0.0, 120.0, 30), 20)
    hall = 20.0 + np.convolve(np.cumsum(rng.normal(0.0, 0.8, 600)), np.ones(25) / 25.0, "same")
    hall += 20.0 - hall[0]

    def slope(x, at):
        above, flow = x[0] - at[1], 2.0 * (x[0] - x[1])
        return np.array([(at[0] - flow - LOSS * above * abs(above)) / C, (flow - G * (x[1] - at[1])) / (4.0 * C)])

    intervals = zip(power, itertools.pairwise(hall), strict=False)
    inside = [(np.array([watts, begin]), np.array([watts, end])) for watts, (begin, end) in intervals]
    seen = in_lines(slope, np.full(2, 20.0), inside, 10.0, 5)[:, 0]
    inputs = {"P": power, "T_hall": hall, "T_set": np.full(600, 300.0)}
    return Recording(name, 10.0 * np.arange(600), inputs, {"T": seen + rng.normal(0.0, NOISE["T"], 600)})


@dataclass(frozen=True)
class Search:
    """A model, recordings of what it lacks, what is fitted and tried, and what is found.

    ``known`` gives fitted values with their true ones and the tolerance; ``written`` stands so often in the model."""

    source: str
    recorded: Callable[[str, int], Recording]
    seed: int
    parameters: tuple[str, ...]
    laws: tuple[str, ...]
    found: str
    known: Callable[[Sequence[Estimate], Mapping[str, Estimate]], list[tuple[float, float, float]]]
    interpolation: object = None
    max_effects: int = 2
    size: float = 3.0
    written: tuple[str, int] = ("", 0)


SEARCHES = {
    "a spring that stiffens": Search(
        CAR, drive, 51, ("k_s", "c_s"), ("cubic_stiffness", "coulomb_friction", "quadratic_drag"),
        "cubic_stiffness@v_b-v_w",
        lambda own, base: [(own[0].value, K_3, 0.02 * K_3), (base["k_s"].value, K_S, 0.02 * K_S)],
        "linear", written=("k_3 * (body - wheel) ^ 3", 2),
    ),
    "the limit of an actuator within a loop": Search(
        AXIS, motion, 61, ("J", "b"), ("saturation", "dead_zone", "coulomb_friction"), "saturation@u",
        lambda own, base: [(1.0 / own[0].value, LIMIT, 0.02 * LIMIT)], size=5.0,
    ),
    "a limit that differs by side": Search(
        CASCADE, cascade, 63, ("T_1", "T_2", "K"),
        ("saturation", "saturation_by_side", "dead_zone", "offset", "overflow"), "saturation_by_side@g",
        lambda own, base: [
            (1.0 / (own[0].value * (1.0 + own[1].value)), 0.5, 0.01),
            (1.0 / (own[0].value * (1.0 - own[1].value)), 0.8, 0.016),
        ],
        max_effects=3, size=5.0,
    ),
    "a loss to a hall": Search(
        OVEN, bake, 71, ("C", "G"), ("linear_loss", "square_loss", "radiation", "offset", "gain"),
        "square_loss@T-T_hall",
        lambda own, base: [(own[0].value, LOSS, 4 * own[0].sd), (base["C"].value, C, 4 * base["C"].sd)],
        {"T_hall": "linear"}, written=("(T - T_hall) * abs(T - T_hall)", 1),
    ),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("what", SEARCHES)
def test_what_is_missing_is_found_alone(what, modelica, tmp_path):
    given = SEARCHES[what]
    calibration = CalibrationSettings(interpolation=given.interpolation) if given.interpolation else None
    settings = LoopSettings(
        max_effects=given.max_effects, parameters=given.parameters, laws=given.laws, cache=tmp_path / "fmu",
        fit=FitSettings(method="local", calibration=calibration) if calibration else None,
    )  # fmt: skip
    train, test = [given.recorded("a", given.seed)], [given.recorded("b", given.seed + 1)]
    result = close_loop(train, test, model=modelica(given.source), settings=settings, workers=0)
    (effect,) = result.effects
    assert effect.id == given.found
    for value, true, tolerance in given.known(effect.parameters, result.parameters):
        assert value == pytest.approx(true, abs=tolerance)
    before, after = result.predicted_before.pooled("test"), result.predicted_after.pooled("test")
    assert all(rms < 1.1 * NOISE[name] for name, rms in after.items())
    first = next(iter(before))
    assert before[first] > given.size * NOISE[first]
    text, count = given.written
    assert not text or result.modelica.count(text) == count
