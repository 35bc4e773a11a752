"""The library's calls as one types them, and what a wrong type is answered with."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import arviz
import numpy as np
import pandas as pd
import pytest

import aero_bayes
from aero_bayes import InputError, LoopSettings, Recording


def test_leave_one_out_counts_the_parameters(cart: SimpleNamespace):
    """The likelihood of each reading is that of the posterior, also where a residual is no noise."""
    posterior = aero_bayes.sample(cart.fit, chains=4, seed=1, workers=0)
    found = arviz.loo(posterior.to_arviz(), var_name="train")
    assert posterior.to_arviz().log_likelihood["train"].shape[-1] == 2000
    p_loo = found.p_loo if hasattr(found, "p_loo") else found.p
    assert 0.5 < p_loo < 2.0 * len(cart.fit.free)
    assert float(posterior.to_arviz().prior["k"].std()) > 100.0 * float(posterior.to_arviz().posterior["k"].std())


MISTAKES: dict[str, tuple[Callable[[SimpleNamespace], object], str]] = {
    "recording by its file": (
        lambda c: aero_bayes.fit("train.csv", c.model, parameters="k"),
        "recordings: expected a Recording, as aero_bayes.read_recording or Recording.from_frame gives one; got str",
    ),
    "model by its file": (
        lambda c: aero_bayes.fit(c.recording, "Rig.mo", parameters="k"),
        "model: expected a Model, as aero_bayes.load_model gives one; got str 'Rig.mo'",
    ),
    "nothing said of parameters": (lambda c: aero_bayes.fit(c.recording, c.model), "it has m, k, d"),
    "a parameter that is none": (
        lambda c: aero_bayes.fit(c.recording, c.model, parameters=["kk"]), "model Rig has no parameter kk",
    ),
    "fit without a parameter": (lambda c: c.fit["K"], "no parameter 'K', found k, d; did you mean k?"),
    "sampling a recording": (lambda c: aero_bayes.sample(c.recording), "expected a Fit, as aero_bayes.fit gives"),
    "loop with a dict": (
        lambda c: aero_bayes.close_loop(c.recording, model=c.model, settings={"free": ["k"]}),
        "settings: expected a LoopSettings; got dict",
    ),
    "a frame without the column": (
        lambda c: Recording.from_frame(c.recording.to_frame(), inputs="f", outputs="position"),
        "frame: no column f, found F, position; did you mean F?",
    ),
    "a frame that knows no times": (
        lambda c: Recording.from_frame(
            pd.DataFrame({"Zeit": [0.0, 0.5, 1.0, 1.5], "F": 1.0, "y": 1.0}), inputs="F", outputs="y"
        ),
        'give its times, as by frame.set_index("Zeit")',
    ),
    "a frame in a unit of something else": (
        lambda c: aero_bayes.fit(
            Recording.from_frame(c.recording.to_frame(), inputs="F", outputs="position", units={"position": "kg"}),
            c.model, parameters="k",
        ),
        "column position: unit kg cannot become m",
    ),
    "a setting elsewhere": (
        lambda c: aero_bayes.FitSettings(initial_states="auto"),
        "no setting 'initial_states'; it is in calibration=CalibrationSettings(initial_states=...)",
    ),
    "a setting of a setting's setting": (
        lambda c: LoopSettings(initial_states="auto"), "fit=FitSettings(calibration=CalibrationSettings(initial_sta",
    ),
    "a number that is a word": (lambda c: aero_bayes.SampleSettings(draws="many"), "draws: expected a whole number"),
    "a number saved": (lambda c: aero_bayes.save(3, "three"), "expected a Fit, a Posterior, a LoopResult"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_that_says_what_is_expected(mistake: str, cart: SimpleNamespace):
    call, words = MISTAKES[mistake]
    with contextlib.chdir(cart.folder), pytest.raises(InputError) as refused:
        call(cart)
    line = str(refused.value)
    assert words in line
    assert "\n" not in line
    assert "[data" not in line
    assert "--" not in line


def test_a_fit_is_the_same_whatever_the_number_of_workers(cart: SimpleNamespace):
    again = aero_bayes.fit(cart.recording, cart.model, parameters=cart.free, workers=2)
    assert again.values.tolist() == cart.fit.values.tolist()


def test_a_frame_in_other_units_is_fitted_as_one_in_the_models(cart: SimpleNamespace):
    """A unit that is said is enough: fit, prediction and simulation convert to the model's."""
    frame = cart.recording.to_frame()
    frame = pd.DataFrame({"time": 1e3 * frame.index, "F": frame["F"], "position": 1e3 * frame["position"].to_numpy()})
    given = {"time": "ms", "position": "mm"}
    recording = Recording.from_frame(frame, inputs="F", outputs="position", units=given)
    settings = aero_bayes.FitSettings(method="local")
    plain, converted = (
        aero_bayes.fit(r, cart.model, parameters=["k", "d"], settings=settings, workers=0)
        for r in (cart.recording, recording)
    )
    assert converted["k"].value == pytest.approx(plain["k"].value, rel=1e-6)
    assert converted.calibration.data.recordings[0].units["position"] == "m"
    assert converted.predict(recording, draws=20).rms == pytest.approx(plain.predict(cart.recording, draws=20).rms)
    moved = [f.simulate(r).outputs["position"] for f, r in ((plain, cart.recording), (converted, recording))]
    assert np.allclose(*moved, rtol=0.0, atol=1e-9)


def test_a_run_that_is_opened_again_predicts_and_simulates_as_its_fit(
    cart: SimpleNamespace, posterior: aero_bayes.Posterior, tmp_path: Path
):
    """From the folder alone: the FMU, values and their covariance stand there."""
    run = aero_bayes.load_result(aero_bayes.save(cart.fit, tmp_path / "saved"))
    for recording in (cart.recording, cart.test):
        simulated = [one.simulate(recording).outputs["position"] for one in (run, cart.fit)]
        assert np.allclose(*simulated, rtol=0.0, atol=1e-9)
        told = [one.predict(recording, draws=30).to_frame().to_numpy() for one in (run, cart.fit)]
        assert np.allclose(*told, rtol=1e-6, atol=1e-9)
    stiffer = [one.simulate(cart.test, parameters={"k": 100.0}).outputs["position"] for one in (run, cart.fit)]
    assert np.allclose(*stiffer, rtol=0.0, atol=1e-9)
    assert not np.allclose(stiffer[0], simulated[0], atol=1e-3)
    sampled = aero_bayes.load_result(aero_bayes.save(posterior, tmp_path / "sampled"))
    told = [one.predict(cart.test, draws=30).to_frame().to_numpy() for one in (sampled, posterior)]
    assert np.allclose(*told, rtol=1e-4, atol=1e-9)  # the file has draws in single precision at the least
    (tmp_path / "saved" / "fit.npz").unlink()
    with pytest.raises(InputError, match="cannot be run again"):
        aero_bayes.load_result(tmp_path / "saved").predict(cart.test)


def test_what_is_printed_says_first_whether_the_model_explains_the_data(cart: SimpleNamespace):
    first = str(cart.fit).splitlines()[0]
    assert first == cart.fit.verdict == cart.fit.summary().splitlines()[0]
    assert cart.fit.diagnosis["model"].found == ("does not explain the recordings" in first)
    assert cart.fit.diagnosis["model"].found  # the cart lacks friction
    short = aero_bayes.SampleSettings(max_steps=20, max_rounds=1)
    posterior = aero_bayes.sample(cart.fit, settings=short, workers=0)
    said = str(posterior).splitlines()[0]
    assert said.endswith(cart.fit.verdict)
    assert said.startswith("The sampling has not converged") != posterior.converged


def test_a_column_is_named_by_its_text_alone(cart: SimpleNamespace):
    with contextlib.chdir(cart.folder):
        frame = pd.read_csv("train.csv").rename(columns={"F": "Kraft"})
        frame.to_csv("renamed.csv", index=False)
        read = aero_bayes.read_recording("renamed.csv", {"F": "Kraft"}, model=cart.model)
    assert np.array_equal(read.inputs["F"], cart.recording.inputs["F"])


def test_what_is_to_be_done_is_said_in_the_callers_language(cart: SimpleNamespace):
    """In Python a message speaks of arguments, on the command line of the configuration."""
    bare = Recording("r", [0, 1, 2, 3], {}, {"position": range(4)})
    with pytest.raises(InputError, match="name it among the inputs that are read") as refused:
        aero_bayes.fit(bare, cart.model, parameters="k")
    assert "[data" not in str(refused.value)
    assert "[data] constants = {F = ...}" in refused.value.configured
