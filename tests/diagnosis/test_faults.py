"""Fits of recordings with one fault of the data, or none: the fault is told, and only where it is there.

A fault is told as findings of the first recording; ``explains`` says whether no missing effect is looked for then."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import heated_room
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.data.recording import with_means
from aero_bayes.estimate import CalibrationSettings, LogNormal
from aero_bayes.estimate.diagnosis import CAUSES, Diagnosis, DiagnosisRow
from aero_bayes.estimate.outliers import outlier_rows
from aero_bayes.plain import plain
from aero_bayes.report.schema_run import RunJson, VerdictJson
from aero_bayes.report.words import verdict

pytestmark = pytest.mark.fast
HOUR, INTERVAL, ROWS = 3600.0, 120.0, 480
M, D, LEVER, TICK = 2.0, 0.8, 0.3, 0.05
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


def scaled(channel: str, factor: float) -> Recording:
    given = heated_room.recording()
    inputs, outputs = (
        {n: factor * v if n == channel else v for n, v in columns.items()} for columns in (given.inputs, given.outputs)
    )
    return replace(given, inputs=inputs, outputs=outputs)


def lossy() -> Recording:
    """The room with a loss that its model lacks."""
    return heated_room.recording(loss=lambda x: 9.0 * x * abs(x))


def added(given: Recording, noise: np.ndarray | float) -> Recording:
    return heated_room.with_readings(given, lambda v: v + noise)


def slow(sd: float = 0.05, memory: float = 8.0) -> Recording:
    """The room with noise that is correlated over ``memory`` samples, beside the white one."""
    rng, left = np.random.default_rng(5), np.exp(-1.0 / memory)
    noise = np.zeros(600)
    for k in range(1, 600):
        noise[k] = left * noise[k - 1] + sd * np.sqrt(1.0 - left**2) * rng.standard_normal()
    return added(heated_room.recording(), noise)


def averaged(readings_too: bool = False) -> Recording:
    """The room with the heater's means of an hour, and the temperature at its end or its mean; both exact."""
    rng = np.random.default_rng(1)
    rows, a = 400, heated_room.G / heated_room.C
    power = rng.choice([0.0, 1500.0, 3000.0], rows)
    ends, means, x = np.empty(rows), np.empty(rows), 293.15
    for k in range(rows):
        rest = 278.0 + power[k] / heated_room.G
        decay = np.exp(-a * HOUR)
        means[k] = rest + (x - rest) * (1.0 - decay) / (a * HOUR)
        x = ends[k] = rest + (x - rest) * decay
    read = (means if readings_too else ends) + heated_room.SD * rng.standard_normal(rows)
    inputs = {"P": power, "T_amb": np.full(rows, 278.0)}
    return Recording("run", HOUR * np.arange(1, rows + 1), inputs, {"T": read}, heated_room.UNITS)


def disturbed(seed: int, computed: int | None = None, load: float = 300.0, curve: float = 0.0) -> Recording:
    """The room, exact from reading to reading, under a load of an hour's memory that nobody records.

    The heater is set by a PI controller from the reading ``computed`` samples ago, or by chance. With ``curve``
    (W/K3), the loss is more than proportional."""
    rng = np.random.default_rng(seed)
    decay, memory = np.exp(-heated_room.G / heated_room.C * INTERVAL), np.exp(-INTERVAL / HOUR)
    wanted = 293.15 + np.repeat(rng.choice([0.0, 2.0, 4.0], ROWS // 60), 60)
    power, read = rng.choice([500.0, 1300.0, 2100.0, 3000.0], ROWS), np.empty(ROWS)
    x, disturbance, total = 293.15, 0.0, 0.0
    for k in range(ROWS):
        read[k] = x + 0.02 * rng.standard_normal()
        if computed is not None:
            error = wanted[k] - read[max(k - computed, 0)]
            total += error * INTERVAL / HOUR
            power[k] = 1800.0 + 800.0 * (error + total)
        end = 278.0 + (power[k] + disturbance - curve * (x - 288.0) ** 3) / heated_room.G
        x = end + (x - end) * decay
        disturbance = memory * disturbance + load * np.sqrt(1.0 - memory**2) * rng.standard_normal()
    inputs = {"P": power, "T_amb": np.full(ROWS, 278.0)}
    return Recording("run", INTERVAL * np.arange(ROWS), inputs, {"T": read}, heated_room.UNITS)


def pushed(rate: float = 0.0, ahead: int = 0, drag: float = 0.0, seed: int = 1) -> Recording:
    """A cart that two forces push in steps, read on a clock that is slow by ``rate`` and ``ahead`` samples early."""
    rng, fine, rows = np.random.default_rng(seed), 10, 1000
    time = TICK * np.arange(rows)
    forces = {n: np.repeat(rng.choice([-1.0, 0.0, 1.0], rows // 25 + 1), 25)[:rows] for n in "ab"}
    ticks = TICK / fine * np.arange(fine * rows + 600)
    at = np.minimum(np.floor(ticks / TICK + 1e-9).astype(int), rows - 1)
    v, x, h = np.zeros(ticks.size), np.zeros(ticks.size), ticks[1]
    for k in range(ticks.size - 1):
        force = forces["a"][at[k]] - LEVER * forces["b"][at[k]]
        middle = v[k] + 0.5 * h * (force - D * v[k] - drag * v[k] * abs(v[k])) / M
        v[k + 1] = v[k] + h * (force - D * middle - drag * middle * abs(middle)) / M
        x[k + 1] = x[k] + h * middle
    stamps = time * (1.0 + rate)
    read = {"v": np.interp(stamps + ahead * TICK, ticks, v), "x": np.interp(stamps, ticks, x)}
    outputs = {n: y + 0.002 * rng.standard_normal(rows) for n, y in read.items()}
    return Recording("run", time, forces, outputs, {"time": "s", "a": "N", "b": "N", "v": "m/s", "x": "m"})


def with_forces(a: str, b: str, sign: float = 1.0) -> Recording:
    given = pushed()
    return replace(given, inputs={"a": sign * given.inputs[a], "b": given.inputs[b]})


def two_rooms(capacity: float) -> list[Recording]:
    """The room, and the same room with another heat capacity."""
    first = heated_room.recording(seed=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(heated_room, "C", capacity)
        return [replace(first, name="empty"), replace(heated_room.recording(seed=2), name="loaded")]


def with_prior(factor: float, tolerance: float) -> dict[str, Any]:
    prior = LogNormal.tolerance(factor * heated_room.C, tolerance)
    return {"C": aero_bayes.ParameterSpec(prior=prior), "G": (1.0, 1e4)}


@dataclass(frozen=True)
class Case:
    """A recording, the findings that it has, what they state, and the causes that the diagnosis finds beside them."""

    given: Callable[[], Recording | list[Recording]]
    findings: list[tuple[str, str]] = field(default_factory=list)
    states: tuple[str, ...] = ()
    explains: bool = False
    model: str = "room"
    free: list[str] | Mapping[str, Any] = field(default_factory=lambda: ["C", "G"])
    fixed: Mapping[str, float] = field(default_factory=dict)
    blamed: bool | None = None


CART_CASE: dict[str, Any] = {"model": "cart", "free": ["m", "d", "g"]}
CASES = {
    "power in kW": Case(lambda: scaled("P", 1e-3), [("unit", "P")], ('unit = "kW"',), explains=True),
    "power in mW": Case(lambda: scaled("P", 1e3), [("unit", "P")], ('unit = "mW"',), explains=True),
    "a missing loss": Case(lossy, blamed=True),
    "a zero that is off": Case(lambda: added(heated_room.recording(), 4.0), [("offset", "T")]),
    "a wrong prior": Case(heated_room.recording, [("prior", "C")], explains=True, free=with_prior(1.3, 0.005)),
    "a right prior": Case(heated_room.recording, free=with_prior(1.005, 0.01)),
    "slow noise": Case(slow),
    "slow noise and a wrong prior": Case(slow, [("prior", "C")], explains=True, free=with_prior(1.3, 0.001)),
    "slow noise and a zero that is off": Case(lambda: added(slow(), 4.0), [("offset", "T")]),
    "an input that is a mean": Case(averaged, [("mean", "P")], ('stamp = "end"',), explains=True),
    "an input that is a mean, read so": Case(lambda: with_means(averaged(), {"P": "end"}), blamed=False),
    "a controller, at once": Case(lambda: disturbed(1, 0), [("feedback", "P")]),
    "a controller, late": Case(lambda: disturbed(2, 1), [("feedback", "P")], ("residual of T 120 s before",)),
    "a load alone": Case(lambda: disturbed(1)),
    "another load alone": Case(lambda: disturbed(2)),
    "a controller without a load": Case(lambda: disturbed(1, computed=0, load=0.0)),
    "a missing loss beside no load": Case(lambda: disturbed(1, load=0.0, curve=0.5), blamed=True),
    "a capacity that differs by recording": Case(
        lambda: two_rooms(3.5e6), [("value", "C")], ("C = {free = true, per_recording = true}",)
    ),
    "one capacity for both": Case(lambda: two_rooms(heated_room.C)),
    "a wrong value that is held": Case(heated_room.recording, [("value", "G")], free=["C"], fixed={"G": 60.0}),
    "a missing loss and a held value": Case(lossy, free=["G"], fixed={"C": 2.0e6}, blamed=True),
    "a sign": Case(lambda: with_forces("a", "b", -1.0), [("sign", "a")], explains=True, **CART_CASE),
    "exchanged forces": Case(lambda: with_forces("b", "a"), [("swap", "a")], explains=True, **CART_CASE),
    "a speed that is ahead": Case(
        lambda: pushed(ahead=3), [("clock", "v")], ("3 samples",), explains=True, **CART_CASE
    ),
    "a slow clock": Case(lambda: pushed(rate=0.01), [("clock", "")], ("slow",), explains=True, **CART_CASE),
    "milliseconds": Case(
        lambda: replace(pushed(), time=1e3 * pushed().time), [("unit", "time")], explains=True, **CART_CASE
    ),
    "a right cart": Case(lambda: pushed(seed=2), **CART_CASE),
    "a missing drag": Case(lambda: pushed(drag=1.0, seed=3), **CART_CASE),
}


@pytest.mark.parametrize("name", CASES)
def test_the_fault_of_a_recording_is_told_and_no_other(
    name: str, room: aero_bayes.Model, exported: Callable[[str], aero_bayes.Model]
) -> None:
    case = CASES[name]
    settings = aero_bayes.FitSettings(fixed=dict(case.fixed))
    model = room if case.model == "room" else exported(CART)
    fit = aero_bayes.fit(case.given(), model, parameters=case.free, settings=settings, workers=0)
    row = fit.diagnosis["data"]
    assert [(f.kind, f.signal) for f in fit.calibration.data.recordings[0].findings] == case.findings
    assert (fit.diagnosis.explanation is row) == case.explains
    for words in case.states:
        assert words in f"{row.what} {row.done}"
    if case.blamed is not None:
        assert fit.diagnosis["model"].found == case.blamed


def test_other_readings_that_are_fitted_side_by_side_tell_the_same(room: aero_bayes.Model) -> None:
    alone, beside = (heated_room.fit(scaled("P", 1e-3), room, workers=n) for n in (0, 2))
    assert beside.calibration.data.recordings[0].findings == alone.calibration.data.recordings[0].findings
    assert np.array_equal(beside.values, alone.values)


def test_a_zero_that_is_off_is_told_with_its_size(room: aero_bayes.Model) -> None:
    told = heated_room.fit(added(heated_room.recording(), 4.0), room).diagnosis["data"].what
    assert float(told.split("with ")[1].split(" K")[0]) == pytest.approx(-4.0, abs=0.1)


def test_an_input_that_acts_before_it_is_logged(exported: Callable[[str], aero_bayes.Model]) -> None:
    given = pushed()
    later = replace(given, inputs={n: np.concatenate([np.zeros(4), v[:-4]]) for n, v in given.inputs.items()})
    settings = aero_bayes.FitSettings(calibration=CalibrationSettings(max_input_delay=-0.5))
    found = aero_bayes.fit(later, exported(CART), parameters=["m", "d", "g"], settings=settings, workers=0)
    assert found["input_delay"].value == pytest.approx(-4 * TICK, abs=0.01)
    assert found["m"].value == pytest.approx(M, rel=0.02)


def test_readings_and_input_that_are_means(room: aero_bayes.Model) -> None:
    fit = heated_room.fit(with_means(averaged(readings_too=True), {"P": "end", "T": "end"}), room)
    assert_right(fit, set(), 0.01)
    assert fit.noise["T"].sd == pytest.approx(heated_room.SD, rel=0.2)


def test_a_heater_that_switches_within_the_samples(room: aero_bayes.Model) -> None:
    """Both channels are means and read as such; when the heater was on within an hour is not known."""
    rng, rows, minutes, a = np.random.default_rng(4), 400, 60, heated_room.G / heated_room.C
    power = np.repeat(rng.choice([0.0, 1500.0, 3000.0], rows * minutes // 28 + 1), 28)[: rows * minutes]
    x, means, decay = 293.15, np.empty(rows * minutes), np.exp(-60.0 * a)
    for k, now in enumerate(power):
        rest = 278.0 + now / heated_room.G
        means[k] = rest + (x - rest) * (1.0 - decay) / (60.0 * a)
        x = rest + (x - rest) * decay
    hourly = (values.reshape(rows, minutes).mean(axis=1) for values in (power, means))
    inputs = {"P": next(hourly), "T_amb": np.full(rows, 278.0)}
    readings = next(hourly) + heated_room.SD * rng.standard_normal(rows)
    given = Recording("run", HOUR * np.arange(rows), inputs, {"T": readings}, heated_room.UNITS)
    fit = heated_room.fit(with_means(given, {"T": "beginning"}), room)
    assert fit["C"].value == pytest.approx(heated_room.C, rel=0.05)
    assert fit["G"].value == pytest.approx(heated_room.G, rel=0.01)
    assert fit.rms["T"] > 2.0 * heated_room.SD
    assert fit.diagnosis.explanation is fit.diagnosis["noise"]
    assert "alternate" in fit.diagnosis["noise"].what


def assert_right(found: aero_bayes.Fit, kinds: set[str], share: float) -> None:
    assert found["C"].value == pytest.approx(heated_room.C, rel=share)
    assert found["G"].value == pytest.approx(heated_room.G, rel=share)
    assert {f.kind for r in found.calibration.data.recordings for f in r.findings} == kinds
    assert [row.cause for row in found.diagnosis if row.found] == (["data"] if kinds else [])


def test_outliers_are_told_with_their_times_and_not_fitted(room: aero_bayes.Model) -> None:
    rng = np.random.default_rng(3)
    rows, given = rng.choice(600, 18, replace=False), heated_room.recording()
    given.outputs["T"][rows] += rng.choice([-3.0, 3.0], rows.size)
    found = heated_room.fit(given, room)
    assert_right(found, {"outliers"}, 0.01)
    hidden = np.flatnonzero(np.isnan(found.calibration.data.recordings[0].outputs["T"]))
    assert set(hidden.tolist()) <= set(rows.tolist())
    assert hidden.size >= 0.9 * rows.size
    assert f"{120.0 * hidden[0]:g}" in found.diagnosis["data"].where


@pytest.mark.parametrize("every", [40, 85])
def test_few_readings_among_many_rows(room: aero_bayes.Model, every: int) -> None:
    given = heated_room.recording()
    given.outputs["T"][np.arange(given.rows) % every != 0] = np.nan
    assert_right(heated_room.fit(given, room), set(), 0.15)


def test_crests_of_what_a_model_lacks_near_a_resonance_are_no_outliers() -> None:
    # ten readings a period, in bursts: most of the time there is far less
    rng = np.random.default_rng(5)
    k = np.arange(4000)
    residual = np.sin(0.63 * k) * np.sin(0.004 * k) ** 8 + rng.normal(0.0, 0.02, k.size)
    assert not outlier_rows(residual, np.zeros(k.size), {}).any()


def test_outliers_are_told_from_heavy_tails_and_delays() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        noise = rng.standard_normal(2000)
        assert not outlier_rows(noise, np.zeros(2000), {}).any()
        assert not outlier_rows(rng.standard_t(3.0, 2000), np.zeros(2000), {}).any()
    # A step that the fit has one sample too early leaves one large residual.
    step = (np.arange(2000) // 100 % 2).astype(float)
    late = np.roll(step, 1) + 0.01 * noise
    assert not outlier_rows(late, step, {"u": np.roll(step, -1)}).any()
    spikes = 0.01 * noise
    spikes[[150, 750, 1550]] += 1.0
    assert np.flatnonzero(outlier_rows(spikes + step, step, {"u": step})).tolist() == [150, 750, 1550]


def judged(diagnosis: Diagnosis) -> VerdictJson:
    return verdict(RunJson.model_validate({"diagnosis": plain(diagnosis.rows)}))


def test_a_fit_without_a_fault_is_clear(room: aero_bayes.Model) -> None:
    found = heated_room.fit(heated_room.recording(), room)
    assert tuple(row.cause for row in found.diagnosis) == CAUSES
    assert found.diagnosis.first is None
    assert judged(found.diagnosis).level == "good"
    assert [row["cause"] for row in found.to_dict()["diagnosis"]] == list(CAUSES)  # type: ignore[attr-defined]


@pytest.mark.parametrize("cause", CAUSES[:-1])
def test_the_model_is_blamed_last(cause: str) -> None:
    rows = tuple(DiagnosisRow(c, c in (cause, "model"), f"Something of the {c}.", explains=True) for c in CAUSES)
    diagnosis = Diagnosis(rows)
    assert diagnosis.first is not None
    assert diagnosis.explanation is not None
    assert (diagnosis.first.cause, diagnosis.explanation.cause) == (cause, cause)
    text = judged(diagnosis).text
    assert f"Something of the {cause}" in text
    assert "misses something" not in text


def test_a_fault_that_was_mended_explains_nothing_that_is_left() -> None:
    rows = tuple(DiagnosisRow(c, c in ("data", "model"), "A sentence.", explains=c == "model") for c in CAUSES)
    assert Diagnosis(rows).explanation is None
