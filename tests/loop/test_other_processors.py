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
from rigs import RIGS

share, rng = float(sys.argv[1]), np.random.default_rng(5)

def moved(recorded):
    def read(name, seed):
        r = recorded(name, seed)
        return replace(r, outputs={o: y + share * np.ptp(y) * rng.normal(size=y.size) for o, y in r.outputs.items()})
    return read

for name in ("tank", "meter", "geared", "motor", "body"):
    with tempfile.TemporaryDirectory() as folder:
        found = replace(RIGS[name], recorded=moved(RIGS[name].recorded), most=2).closed(Path(folder))
    print(json.dumps([name, [[e.id, e.claim, [a.id for a in e.alternatives]] for e in found.effects]]))
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
