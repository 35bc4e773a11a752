"""Cutting recordings and turning them into experiments."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import ColumnMap, Layout, Recording, read_recording, to_experiment, write_csv
from aero_bayes.errors import InputError

pytestmark = pytest.mark.fast

AT_REST = ("omega_m", "i_m")


def recording(volts: list[float], omega: list[float] | None = None, start: float = 0.0) -> Recording:
    n = len(volts)
    outputs = {"theta": np.linspace(0.0, 1.0, n)}
    if omega is not None:
        outputs["omega_m"] = np.array(omega)
    return Recording("r", start + np.arange(n) / 10.0, {"V_m": np.array(volts)}, outputs)


@pytest.mark.parametrize("header", ["x [mm]", "x (mm)", "x_mm", "x/mm", "x mm"])
def test_a_header_with_another_unit_than_the_given_one_or_the_models_is_asked_about(tmp_path, header: str) -> None:
    path = tmp_path / "axis.csv"
    path.write_text(f"time,{header},u\n" + "".join(f"{k},{k},{k}\n" for k in range(8)), encoding="utf-8")
    layout = Layout.of(["u"], ["x"], {"x": "m", "u": "V"})

    def notes(**column: object) -> tuple[str, ...]:
        return read_recording(path, {"x": ColumnMap(header, **column)}, layout=layout).notes  # type: ignore[arg-type]

    for given in ({"unit": "m"}, {}):
        (asked,) = notes(**given)
        assert "read in m" in asked
        assert "header says mm" in asked
    assert notes(unit="mm") == ()
    assert notes(scale=1e-3) == ()


@pytest.mark.parametrize("seed", range(25))
def test_writing_and_reading_gives_the_same_numbers(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(4, 200))
    values = rng.choice([-1.0, 1.0], (3, rows)) * 10.0 ** rng.uniform(-300.0, 300.0, (3, rows))
    values[:, rng.random(rows) < 0.1] = 0.0
    outputs = {"y": values[1], "z": np.where(rng.random(rows) < 0.3, np.nan, values[2])}
    outputs["z"][:4] = (1.0, -1e-320, 5e-324, 2.0)
    time = np.cumsum(rng.uniform(1e-6, 2.0, rows)) - rng.uniform(0.0, 100.0)
    path = write_csv(Recording("r", time, {"u": values[0]}, outputs), tmp_path / "r.csv")
    after = read_recording(path, layout=Layout.of(["u"], ["y", "z"]))
    np.testing.assert_array_equal([after.time, after.inputs["u"]], [time, values[0]])
    np.testing.assert_array_equal(after.measured(("y", "z")), np.column_stack(list(outputs.values())))
    assert list(tmp_path.iterdir()) == [path]
    assert after.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_slice_and_holding_back() -> None:
    whole = recording([0.0] * 5 + [10.0] * 5, start=2.0)
    assert whole.slice(2.2, 2.5).time.tolist() == pytest.approx([2.2, 2.3, 2.4])
    held = whole.without(after=2.5)
    assert held.rows == whole.rows
    assert np.isfinite(held.outputs["theta"]).sum() == 5
    np.testing.assert_array_equal(held.inputs["V_m"], whole.inputs["V_m"])
    assert len({whole.sha256, held.sha256, whole.slice(2.2, 2.5).sha256}) == 3


@pytest.mark.parametrize(
    "use",
    [
        lambda r: r.slice(50.0, 60.0),
        lambda r: r.measured(("i_m",)),
        lambda r: to_experiment(r, ["i_m"]),
        lambda r: Recording("r", r.time[1:], {}, r.outputs),
    ],
)
def test_misuse_is_an_input_error(use) -> None:
    with pytest.raises(InputError, match="r: "):
        use(recording([0.0] * 10))


@pytest.mark.parametrize("seed", range(10))
def test_compressed_input_is_the_recorded_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    original = recording(rng.choice([0.0, 1.0, -2.5], 50).tolist())
    (signal,) = to_experiment(original).inputs
    assert np.all(np.diff(signal.values) != 0.0)
    held = signal.values[np.searchsorted(signal.time, original.time, side="right") - 1]
    np.testing.assert_array_equal(held, original.inputs["V_m"])


def test_a_step_at_the_first_sample_can_be_delayed() -> None:
    rising = recording([10.0] * 10, omega=[0.05, 0.1, 5, 9, 14, 18, 22, 25, 28, 30])
    (signal,) = to_experiment(rising, zero_at_rest=AT_REST).inputs
    assert signal.values.tolist() == [0.0, 10.0]
    assert signal.time[0] < -0.5
    assert signal.time[1] == 0.0
    (signal,) = to_experiment(rising).inputs
    assert signal.values.tolist() == [10.0], "nothing is known of what reads zero at rest"


def test_a_turning_rotor_was_driven_before() -> None:
    (signal,) = to_experiment(recording([10.0] * 10, omega=[30.0] * 10), zero_at_rest=AT_REST).inputs
    assert signal.values.tolist() == [10.0]
