"""A model that is a Python function: fitted, sampled and predicted with as any other, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import aero_bayes
from aero_bayes.errors import InputError
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import DelayTarget, Experiment, InputSignal, Outcome, ParameterTarget, Problem

pytestmark = pytest.mark.fast

SD, GAIN, RATE = 0.05, 2.0, 0.7


def heating(parameters, inputs, times):
    """The exact answer of T' = gain u - rate T to an input that is held, from T = 0."""
    temperature, found = 0.0, [0.0]
    for level, step in zip(inputs["u"](times[:-1]), np.diff(times), strict=True):
        rest = parameters["gain"] * level / parameters["rate"]
        temperature = rest + (temperature - rest) * np.exp(-parameters["rate"] * step)
        found.append(temperature)
    return {"T": np.array(found)}


MODEL = aero_bayes.FunctionModel(
    heating, parameters={"gain": 1.0, "rate": 1.0}, inputs=["u"], outputs=["T"], units={"T": "K", "rate": "1/s"}
)


@pytest.fixture(scope="module")
def recording():
    time = np.linspace(0.0, 20.0, 201)
    u = np.where(np.sin(0.9 * time) > 0.0, 1.0, 0.0)
    given = {"u": lambda t: np.interp(t, time, u)}
    clean = heating({"gain": GAIN, "rate": RATE}, given, time)["T"]
    noise = SD * np.random.default_rng(1).standard_normal(time.size)
    return aero_bayes.Recording("room", time, inputs={"u": u}, outputs={"T": clean + noise})


@pytest.fixture(scope="module")
def fit(recording):
    wanted = {"gain": (0.1, 10.0), "rate": (0.1, 10.0)}
    settings = aero_bayes.FitSettings(method="local")
    return aero_bayes.fit(recording, MODEL, parameters=wanted, settings=settings, workers=0)


def test_a_fit_finds_the_truth_with_the_spread_of_least_squares(fit, recording):
    def run(gain, rate):
        return heating({"gain": gain, "rate": rate}, {"u": lambda t: recording.inputs["u"][: len(t)]}, recording.time)

    slopes = [
        (run(GAIN + h, RATE + k)["T"] - run(GAIN - h, RATE - k)["T"]) / 2e-5 for h, k in ((1e-5, 0.0), (0.0, 1e-5))
    ]
    s = np.stack(slopes, axis=1)
    expected = SD * np.sqrt(np.diag(np.linalg.inv(s.T @ s)))
    for name, truth, sd in zip(("gain", "rate"), (GAIN, RATE), expected, strict=True):
        assert abs(fit[name].value - truth) < 4.5 * sd
        assert fit[name].sd == pytest.approx(sd, rel=0.25)
    assert fit.rms["T"] == pytest.approx(SD, rel=0.2)


def test_a_posterior_and_a_prediction(fit, recording):
    posterior = aero_bayes.sample(fit, settings=aero_bayes.SampleSettings(max_steps=8), seed=1, workers=0)
    assert abs(np.mean(posterior.samples("rate")) - fit["rate"].value) < 4.0 * fit["rate"].sd
    assert fit.predict(recording).rms["T"] == pytest.approx(SD, rel=0.2)


def test_slopes_and_delays_are_those_of_the_formula():
    time = np.linspace(0.0, 1.0, 11)
    signal = InputSignal("u", time, time**2, "linear")
    model = aero_bayes.FunctionModel(
        lambda p, inputs, t: {"y": np.exp(p["a"] * t) + inputs["u"](t)},
        parameters={"a": 0.5}, inputs=["u"], outputs=["y"],
    )  # fmt: skip
    problem = Problem(model, (Experiment(time, ("y",), (signal,)),), ((ParameterTarget("a"), DelayTarget()),))
    with open_simulator(problem) as simulator:
        found = simulator.simulate(np.array([[0.5, 0.15]]), active=[0, 1])
    delayed = np.interp(time - 0.15, time, time**2)
    np.testing.assert_allclose(found.outputs[0][0, :, 0], np.exp(0.5 * time) + delayed, rtol=1e-12)
    np.testing.assert_allclose(found.sensitivities[0][0, :, 0, 0], time * np.exp(0.5 * time), rtol=1e-6)
    np.testing.assert_allclose(found.sensitivities[0][0, 3:, 0, 1], -(2.0 * time[3:] - 0.3), atol=1e-6)


def failing(parameters, inputs, times):
    if parameters["a"] < 0.0:
        raise ValueError("a is negative")
    return {"y": np.full(times.shape, np.inf if parameters["a"] > 1.0 else parameters["a"])}


def test_what_the_function_raises_is_a_counted_outcome():
    model = aero_bayes.FunctionModel(failing, parameters={"a": 0.5}, outputs=["y"])
    problem = Problem(model, (Experiment(np.arange(3.0), ("y",)),), ((ParameterTarget("a"),),))
    with open_simulator(problem) as simulator:
        found = simulator.simulate(np.array([[0.5], [-1.0], [2.0]]))
    assert found.outcomes[:, 0].tolist() == [Outcome.OK, Outcome.MODEL_ERROR, Outcome.NOT_FINITE]
    assert np.isnan(found.outputs[0][1:]).all()


@pytest.mark.parametrize(("answer", "says"), [({"z": np.zeros(3)}, "no y"), ({"y": np.zeros(2)}, "shape")])
def test_an_answer_of_the_wrong_form_is_refused(answer, says):
    model = aero_bayes.FunctionModel(lambda *_: answer, parameters={"a": 0.5}, outputs=["y"])
    problem = Problem(model, (Experiment(np.arange(3.0), ("y",)),), ((ParameterTarget("a"),),))
    with open_simulator(problem) as simulator, pytest.raises(InputError, match=says):
        simulator.simulate(np.array([[0.5]]))


def test_the_loop_is_refused_in_one_line(recording):
    with pytest.raises(InputError, match="Python function"):
        aero_bayes.close_loop(recording, model=MODEL)
