"""Channels in another unit, with another sign, exchanged or on another clock are told; what a model lacks is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import heated_room
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings

pytestmark = pytest.mark.fast


def changed(channel: str, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    given = heated_room.recording()
    inputs = {n: change(v) if n == channel else v for n, v in given.inputs.items()}
    return replace(
        given, inputs=inputs, outputs={n: change(v) if n == channel else v for n, v in given.outputs.items()}
    )


@pytest.mark.parametrize(
    ("channel", "unit", "change"), [("P", "kW", lambda v: v / 1e3), ("P", "mW", lambda v: v * 1e3)]
)
def test_a_channel_in_another_unit(
    room: aero_bayes.Model, channel: str, unit: str, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    found = heated_room.fit(changed(channel, change), room)
    (finding,) = found.calibration.data.recordings[0].findings
    assert (finding.kind, finding.signal) == ("unit", channel)
    assert f'unit = "{unit}"' in finding.done
    cause = found.diagnosis.explanation
    assert cause is not None
    assert cause.cause == "data"


def test_other_readings_that_are_fitted_side_by_side_tell_the_same(room: aero_bayes.Model) -> None:
    alone, beside = (heated_room.fit(changed("P", lambda v: v / 1e3), room, workers=n) for n in (0, 2))
    assert beside.calibration.data.recordings[0].findings == alone.calibration.data.recordings[0].findings
    assert np.array_equal(beside.values, alone.values)


def test_a_missing_effect_is_no_unit(room: aero_bayes.Model) -> None:
    found = heated_room.fit(heated_room.recording(loss=lambda x: 9.0 * x * abs(x)), room)
    assert not found.calibration.data.recordings[0].findings
    assert found.diagnosis["model"].found


CART = """model Cart
  parameter Real m(unit = "kg", min = 0.1, max = 10.0) = 1.0 "Mass";
  parameter Real d(unit = "N.s/m", min = 0.01, max = 10.0) = 1.0 "Damping";
  parameter Real g(unit = "1", min = 0.05, max = 5.0) = 1.0 "Leverage of the second force";
  input Real a(unit = "N") "First force";
  input Real b(unit = "N") "Second force";
  output Real v(unit = "m/s", start = 0.0, fixed = true);
  output Real x(unit = "m", start = 0.0, fixed = true);
equation
  m * der(v) = a - g * b - d * v;
  der(x) = v;
end Cart;
"""
M, D, LEVER, INTERVAL, ROWS = 2.0, 0.8, 0.3, 0.05, 1000


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> aero_bayes.Model:
    path = tmp_path_factory.mktemp("cart") / "Cart.mo"
    path.write_text(CART)
    return aero_bayes.load_model(path)


def pushed(rate: float = 0.0, ahead: int = 0, drag: float = 0.0, seed: int = 1) -> Recording:
    """A cart that two forces push in steps, read on a clock that is slow by ``rate`` and ``ahead`` samples early."""
    rng = np.random.default_rng(seed)
    fine, time = 10, INTERVAL * np.arange(ROWS)
    forces = {n: np.repeat(rng.choice([-1.0, 0.0, 1.0], ROWS // 25 + 1), 25)[:ROWS] for n in "ab"}
    ticks = INTERVAL / fine * np.arange(fine * ROWS + 600)
    at = np.minimum(np.floor(ticks / INTERVAL + 1e-9).astype(int), ROWS - 1)
    v, x = np.zeros(ticks.size), np.zeros(ticks.size)
    for k in range(ticks.size - 1):

        def slope(u: float, row: int = int(at[k])) -> float:
            return (forces["a"][row] - LEVER * forces["b"][row] - D * u - drag * u * abs(u)) / M

        h = ticks[1]
        middle = v[k] + 0.5 * h * slope(v[k])
        v[k + 1], x[k + 1] = v[k] + h * slope(middle), x[k] + h * middle
    stamps = time * (1.0 + rate)
    outputs = {n: np.interp(stamps, ticks, y) + 0.002 * rng.standard_normal(ROWS) for n, y in (("v", v), ("x", x))}
    if ahead:
        early = np.interp(stamps + ahead * INTERVAL, ticks, v)
        outputs["v"] = early + 0.002 * rng.standard_normal(ROWS)
    return Recording("run", time, forces, outputs, {"time": "s", "a": "N", "b": "N", "v": "m/s", "x": "m"})


def told(given: Recording, cart: aero_bayes.Model) -> tuple[aero_bayes.Fit, list[tuple[str, str]]]:
    found = aero_bayes.fit(given, cart, parameters=["m", "d", "g"], workers=0)
    return found, [(f.kind, f.signal) for f in found.calibration.data.recordings[0].findings]


def test_a_sign(cart: aero_bayes.Model) -> None:
    given = pushed()
    turned = replace(given, inputs={**given.inputs, "a": -given.inputs["a"]})
    found, findings = told(turned, cart)
    assert findings == [("sign", "a")]
    assert found.diagnosis.explanation is found.diagnosis["data"]


def test_exchanged_channels(cart: aero_bayes.Model) -> None:
    given = pushed()
    _, findings = told(replace(given, inputs={"a": given.inputs["b"], "b": given.inputs["a"]}), cart)
    assert findings == [("swap", "a")]


def test_an_output_that_is_ahead(cart: aero_bayes.Model) -> None:
    found, findings = told(pushed(ahead=3), cart)
    assert findings == [("clock", "v")]
    assert "3 samples" in found.diagnosis["data"].what


def test_a_clock_that_is_slow(cart: aero_bayes.Model) -> None:
    found, findings = told(pushed(rate=0.01), cart)
    assert findings == [("clock", "")]
    assert "slow" in found.diagnosis["data"].what


def test_milliseconds(cart: aero_bayes.Model) -> None:
    given = pushed()
    _, findings = told(replace(given, time=1e3 * given.time), cart)
    assert findings == [("unit", "time")]


def test_neither_a_right_recording_nor_a_missing_drag_is_a_fault_of_the_channels(cart: aero_bayes.Model) -> None:
    assert told(pushed(seed=2), cart)[1] == []
    assert told(pushed(drag=1.0, seed=3), cart)[1] == []


def test_an_input_that_acts_before_it_is_logged(cart: aero_bayes.Model) -> None:
    given = pushed()
    later = replace(given, inputs={n: np.concatenate([np.zeros(4), v[:-4]]) for n, v in given.inputs.items()})
    settings = aero_bayes.FitSettings(calibration=CalibrationSettings(max_input_delay=-0.5))
    found = aero_bayes.fit(later, cart, parameters=["m", "d", "g"], settings=settings, workers=0)
    assert found["input_delay"].value == pytest.approx(-4 * INTERVAL, abs=0.01)
    assert found["m"].value == pytest.approx(M, rel=0.02)
