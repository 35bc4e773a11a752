"""The cart of ``examples/cart``, read, fitted, sampled and closed as the documentation does it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree, ignore_patterns
from types import SimpleNamespace
from typing import Any

import pytest

import aero_bayes
from aero_bayes.cli import main
from aero_bayes.data import Layout
from aero_bayes.estimate import ParameterSpec, parameters_from_model

CART = Path(__file__).parents[2] / "examples" / "cart"


@pytest.fixture(scope="session")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    """What an example may name: ``model``, ``recording`` (for training), ``test``, ``fit``."""
    folder = Path(copytree(CART, tmp_path_factory.mktemp("cart") / "cart", ignore=ignore_patterns("out*")))
    layout = Layout.of(["F"], ["position"])
    with contextlib.chdir(folder):
        model = aero_bayes.load_model("Rig", sources=[Path("Rig.mo")])
        recording, test = (aero_bayes.read_recording(f"{name}.csv", layout=layout) for name in ("train", "test"))
        free = parameters_from_model(model, overrides={"k": ParameterSpec(), "d": ParameterSpec()})
        fit = aero_bayes.fit(recording, model, parameters=free, workers=0)
    return SimpleNamespace(folder=folder, model=model, recording=recording, test=test, free=free, fit=fit)


@pytest.fixture(scope="session")
def posterior(cart: SimpleNamespace) -> aero_bayes.Posterior:
    return aero_bayes.sample(cart.fit, settings=aero_bayes.SampleSettings(max_steps=40), workers=0)


@pytest.fixture(scope="session")
def loop(cart: SimpleNamespace) -> aero_bayes.LoopResult:
    settings = aero_bayes.LoopSettings(laws=("coulomb_friction", "gain"))
    return aero_bayes.close_loop(cart.fit, cart.test, settings=settings, workers=0)


@pytest.fixture(scope="session")
def run(cart: SimpleNamespace, loop: Any) -> aero_bayes.RunDirectory:
    """The same loop by the command line, in ``out/loop``."""
    text = (cart.folder / "rig.toml").read_text("utf-8")
    (cart.folder / "few.toml").write_text(text + '\n[loop]\nlaws = ["coulomb_friction", "gain"]\n', "utf-8")
    with contextlib.chdir(cart.folder), pytest.raises(SystemExit) as end:
        main(["close-loop", "--config", "few.toml", "--train", "train.csv", "--test", "test.csv", "--out", "out/loop",
              "--quiet", "--workers", "1"])  # fmt: skip
    assert end.value.code == 0
    return aero_bayes.load_result(cart.folder / "out" / "loop")
