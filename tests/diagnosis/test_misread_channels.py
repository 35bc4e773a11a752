"""A channel in another unit than the model's is told with that unit; a model that lacks an effect is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import heated_room
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording

pytestmark = pytest.mark.fast


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> aero_bayes.Model:
    return heated_room.model(tmp_path_factory.mktemp("room"))


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


def test_a_missing_effect_is_no_unit(room: aero_bayes.Model) -> None:
    found = heated_room.fit(heated_room.recording(loss=lambda x: 9.0 * x * abs(x)), room)
    assert not found.calibration.data.recordings[0].findings
    assert found.diagnosis["model"].found
