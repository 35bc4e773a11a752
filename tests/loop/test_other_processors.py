"""The loop's answer does not hang on rounding: on another processor's linear algebra, nor on readings off by 1e-9."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import threadpoolctl

pytestmark = pytest.mark.long

#: Prints model and claims for recordings that are changed by a share (first argument) of the range of their readings.
SCRIPT = """
import json, sys, tempfile
from dataclasses import replace
from pathlib import Path
import numpy as np
from aero_bayes.loop import LoopSettings, close_loop
import test_by_side as by_side, test_load_friction as geared, test_unsigned_and_unbalance as unsigned

stops = ("end_stop", "end_stop_by_side", "coulomb_friction", "linear_stiffness", "offset")
ranges = ("saturation", "saturation_by_side", "gain", "overflow", "square_loss", "dead_zone")
signs = ("unsigned", "gain", "offset", "dead_zone", "coulomb_friction")
weights = ("unbalance", "linear_stiffness", "offset", "coulomb_friction", "gain")
cases = [
    (by_side.TRACK, ("m", "d"), stops, [by_side.track(n, s, 0.0) for n, s in (("a", 75), ("b", 76))]),
    (by_side.METER, ("T", "K"), ranges, [by_side.meter("a", 67), by_side.meter("b", 68)]),
    (geared.GEARED, ("J", "d"), geared.LAWS, [geared.turned("a", 1), geared.turned("b", 2)]),
    (unsigned.MOTOR, ("T", "k"), signs, [unsigned.turned("a", 71), unsigned.turned("b", 72)]),
    (unsigned.ARM, ("J", "d"), weights, [unsigned.swung("a", 81), unsigned.swung("b", 82)]),
]
share, rng = float(sys.argv[1]), np.random.default_rng(5)
for text, free, laws, recordings in cases:
    moved = [
        replace(r, outputs={o: y + share * np.ptp(y) * rng.normal(size=y.size) for o, y in r.outputs.items()})
        for r in recordings
    ]
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / f"{text.split()[1]}.mo"
        source.write_text(text)
        settings = LoopSettings(max_effects=2, parameters=free, laws=laws)
        found = close_loop(moved[:1], moved[1:], model=source, settings=settings, workers=0)
    print(json.dumps([source.stem, [[e.id, e.claim, [a.id for a in e.alternatives]] for e in found.effects]]))
"""


def answers(share: float, kernel: str = "") -> list[object]:
    here = Path(__file__).parent
    paths = os.pathsep.join(map(str, (here, here.parent)))
    env = {**os.environ, "PYTHONPATH": paths, **({"OPENBLAS_CORETYPE": kernel} if kernel else {})}
    command = [sys.executable, "-c", SCRIPT, str(share)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=600)
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def plain() -> list[object]:
    found = answers(0.0)
    assert len(found) == 5
    return found


@pytest.mark.parametrize("kernel", ["Nehalem", "Haswell", "Zen", "Prescott"])
def test_another_processor_gives_the_same_answer(kernel, plain):
    if not any(lib["internal_api"] == "openblas" for lib in threadpoolctl.threadpool_info()):
        pytest.skip("the linear algebra here is not OpenBLAS, which is told its processor")
    assert answers(0.0, kernel) == plain


def test_readings_off_by_a_billionth_of_their_range_give_the_same_answer(plain):
    assert answers(1e-9) == plain
