"""Process noise of what laws leave, on a cart whose random force is drawn from its exact distribution."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from aero_bayes import FitSettings, LoopSettings, close_loop, load_model
from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.search import StructureSettings
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation import Model

CART = """model Cart
  parameter Real M(unit = "kg", min = 0.2, max = 20) = 2 "Mass";
  parameter Real d(unit = "N.s/m", min = 0.05, max = 20) = 1 "Viscous friction";
  parameter Real c(unit = "N/m", min = 0.5, max = 100) = 10 "Stiffness";
  input Real F(unit = "N"); output Real position(unit = "m") = x;
  Real x(unit = "m", start = 0, fixed = true); Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  M * der(v) = F - d * v - c * x;
end Cart;
"""
TRUTH = {"M": 1.5, "d": 1.2, "c": 12.0}
DIFFUSION, READING = 0.15, 2e-3
INTERVAL, COUNT = 0.05, 900


def driven(seed: int, diffusion: float, hardening: float = 0.0) -> Recording:
    """A recording of the cart; the restoring force of a hardening spring is held over a hundredth of a sample."""
    rng = np.random.default_rng(seed)
    pieces = 1 if hardening == 0.0 else 100
    h, (mass, friction, stiffness) = INTERVAL / pieces, TRUTH.values()
    a = np.array([[0.0, 1.0], [-stiffness / mass, -friction / mass]])
    # Van Loan (1978), IEEE Trans. Autom. Control 23, 395: transition, input and covariance of one step.
    q = np.diag([0.0, diffusion**2])
    block = expm(h * np.block([[-a, q], [np.zeros((2, 2)), a.T]]))
    phi, covariance = block[2:, 2:].T, block[2:, 2:].T @ block[:2, 2:]
    push = np.linalg.solve(a, phi - np.eye(2)) @ np.array([0.0, 1.0 / mass])
    root = np.linalg.cholesky(covariance) if diffusion else np.zeros((2, 2))
    time = np.arange(COUNT) * INTERVAL
    force = np.repeat(rng.uniform(-6.0, 6.0, COUNT // 15 + 1), 15)[:COUNT]
    state, found = np.zeros(2), np.empty(COUNT)
    for k in range(COUNT):
        found[k] = state[0]
        for _ in range(pieces):
            state = phi @ state + push * (force[k] - hardening * state[0] ** 3) + root @ rng.standard_normal(2)
    return Recording("run", time, {"F": force}, {"position": found + READING * rng.standard_normal(COUNT)})


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = tmp_path_factory.mktemp("cart") / "Cart.mo"
    path.write_text(CART)
    return load_model(path)


def with_noise(**noise):
    return FitSettings(method="local", noise=NoiseModel(**noise))


def closed(cart, recording: Recording, **settings):
    given = LoopSettings(**({"parameters": tuple(TRUTH), "laws": ("gain", "coulomb_friction")} | settings))
    return close_loop(recording, replace(recording, name="again"), model=cart, settings=given, workers=0)


@pytest.fixture(scope="module")
def pushed(cart):
    return closed(cart, driven(5, DIFFUSION))


def test_a_random_force_is_found_at_the_state_that_it_drives(pushed):
    found = pushed.process_noise
    assert pushed.outcome == "unexplained"
    assert (found.states, found.explains) == (("v",), True)
    assert found.gain > found.needed > 0.0
    # Four standard deviations: a false alarm in 16,000.
    for name, true in {**TRUTH, "process.v": DIFFUSION, "noise.position.sd_white": READING}.items():
        assert abs(found.parameters[name].value - true) < 4.0 * found.parameters[name].sd, name
    assert found.diffusions["v"].unit == "m/s/sqrt(s)"
    assert pushed.to_dict()["process_noise"]["states"] == ["v"]


def test_the_smoothed_states_hold_the_reading(pushed):
    states, recording = pushed.process_noise.smoothed["run"], pushed.recordings.train[0]
    low, high = states.band
    column = pushed.process_noise.state_names.index("position")
    off = recording.outputs["position"] - states.mean[:, column]
    assert math.sqrt(np.mean(off**2)) == pytest.approx(READING, rel=0.25)
    assert np.all(low <= high)


def test_no_random_force_is_named_where_a_law_or_nothing_is_missing(cart):
    hard = closed(cart, driven(6, 0.0, hardening=20.0))
    assert hard.outcome == "unexplained"
    assert hard.process_noise is None or not hard.process_noise.explains
    right = closed(cart, driven(7, 0.0))
    assert (right.outcome, right.process_noise) == ("adequate", None)


def test_the_engineer_says_which_states_chance_may_drive(cart):
    recording = driven(5, DIFFUSION)
    assert closed(cart, recording, fit=with_noise(process={"position": "estimated"})).process_noise.states == (
        "position",
    )
    assert closed(cart, recording, leave_out=("AddProcessNoise",)).process_noise is None
    with pytest.raises(InputError, match="w"):
        closed(cart, recording, fit=with_noise(process={"w": "estimated"}))


def test_a_random_force_is_found_beside_a_law_that_renames_a_state(cart):
    given = StructureSettings(require=("lag@position",))
    found = closed(
        cart, driven(5, DIFFUSION), laws=("lag",), structures=given, fit=with_noise(initial_sd={"position": 0.01})
    )
    assert (found.outcome, found.process_noise.states) == ("extended", ("v",))
    assert {"x", "lag.q"} <= set(found.process_noise.state_names)
    assert abs(found.process_noise.diffusions["v"].value - DIFFUSION) < 4.0 * found.process_noise.diffusions["v"].sd
