"""Simulated AEROs of the blind trial: drawn as asked for, the truth apart, effects that no catalogue lists."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import read_recording
from aero_bayes.errors import InputError
from aero_trial import draw_aero_trial
from aero_trial.outside import KINDS as OUTSIDE
from simulated_aero import KINDS, Levels, Truth, even_times, simulate_truth

pytestmark = pytest.mark.long


def test_effects_outside_the_catalogue_are_others_at_every_port() -> None:
    assert len(OUTSIDE) >= 8
    assert not set(OUTSIDE) & set(KINDS)
    assert {kind.port for kind in OUTSIDE.values()} >= {"electrical", "rotor", "thrust", "body", "moment"}


@pytest.mark.parametrize("kind", ["single", "none", "pair", "outside"])
@pytest.mark.parametrize("noise", ["white", "real"])
def test_trials_are_what_was_asked_for(kind: str, noise: str) -> None:
    nominal = {"R_a": 8.4, "c_m": 0.042, "k_d": 2.4e-8, "k_t": 2.9e-7, "D_p": 0.0071, "K_sp": 0.0375}
    seen = set()
    for seed in range(60):
        spec = draw_aero_trial(np.random.default_rng(seed), kind, noise)  # type: ignore[arg-type]
        assert spec == draw_aero_trial(np.random.default_rng(seed), kind, noise)  # type: ignore[arg-type]
        names = [effect.id for effect in spec.truth.effects]
        assert len(set(names)) == len(names) == {"single": 1, "none": 0, "pair": 2, "outside": 1}[kind]
        assert all(name in (OUTSIDE if kind == "outside" else KINDS) for name in names)
        for name, value in nominal.items():
            assert 0.85 <= getattr(spec.truth.parameters, name) / value <= 1.15
        for effect in spec.truth.effects:
            ranges = (KINDS | OUTSIDE)[effect.id].ranges
            assert all(low <= abs(effect.parameters[key]) <= high * 1.0001 for key, (low, high) in ranges.items())
        assert spec.truth.input_delay == (0.006 if noise == "real" else 0.0)
        assert spec.sensors.encoder_counts == (2048 if noise == "real" else 0)
        seen.update(names)
    assert len(seen) >= {"single": 14, "none": 0, "pair": 17, "outside": 10}[kind]


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="no trial of kind"):
        draw_aero_trial(np.random.default_rng(0), "double")  # type: ignore[arg-type]


def test_truth_stays_apart_from_the_recordings(tmp_path: Path) -> None:
    spec = draw_aero_trial(np.random.default_rng(3), "single", "real")
    train, test = spec.write(spec.record(), tmp_path / "seen", tmp_path / "hidden" / "truth.json")
    assert sorted(path.name for path in (tmp_path / "seen").iterdir()) == ["test.csv", "train.csv"]
    assert train.read_text().splitlines()[0] == "time,V_m,i_m,omega_m,theta"
    assert not np.array_equal(read_recording(train).inputs["V_m"], read_recording(test).inputs["V_m"])
    label = json.loads((tmp_path / "hidden" / "truth.json").read_text())
    assert label["simulated"] is True
    assert label["truth"]["effects"][0]["id"] == spec.truth.effects[0].id
    np.testing.assert_array_equal(
        spec.record().train[0].measured(("i_m", "omega_m", "theta")),
        read_recording(train).measured(("i_m", "omega_m", "theta")),
    )


@pytest.mark.parametrize("name", OUTSIDE)
def test_effects_outside_the_catalogue_run_show_and_vanish(name: str) -> None:
    kind = OUTSIDE[name]
    time = even_times(20.0, 100.0)
    design = Levels((0.0, 1.5, 5.0, 8.0, 12.0), (14.0, -8.0, 15.0, -14.0, 4.0))
    large = {key: high for key, (_, high) in kind.ranges.items()}
    if "time" in large:
        large["time"] = 10.0
    base = simulate_truth(Truth(), design, time)
    with_effect = simulate_truth(Truth(effects=(kind.truth(**large),)), design, time, kinds=OUTSIDE)
    without = simulate_truth(
        Truth(effects=(kind.truth(**(large | {kind.magnitude: 0.0})),)), design, time, kinds=OUTSIDE
    )
    changes = []
    for output in ("i_m", "omega_m", "theta"):
        span = np.ptp(getattr(base, output))
        assert np.isfinite(getattr(with_effect, output)).all()
        np.testing.assert_allclose(getattr(without, output), getattr(base, output), atol=3e-7 * span)
        changes.append(np.std(getattr(with_effect, output) - getattr(base, output)) / span)
    assert max(changes) > 3e-3
