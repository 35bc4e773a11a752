"""The rigs' laws and integration against closed forms and against equations written out and integrated elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulated_rigs.kinds import KINDS
from simulated_rigs.signals import command_with_play, delayed_command, faded_command
from simulated_rigs.truth import LawPlace, LawTruth, assembled, simulate_rig

pytestmark = pytest.mark.long

CART, HEAT, RESERVOIRS, SHAFT, TANKS = (KINDS[name] for name in ("cart", "heat", "reservoirs", "shaft", "tanks"))


def times(kind, rows: int) -> np.ndarray:
    return np.arange(rows, dtype=float) * kind.step


def steps(kind, rows: int, seed: int = 0) -> np.ndarray:
    """Levels within each drive, held for its clock."""
    rng, columns = np.random.default_rng(seed), []
    for drive in kind.inputs.values():
        levels = rng.uniform(-1.0, 1.0, rows)
        columns.append(drive.centre + drive.height * levels[(times(kind, rows) / drive.clock).astype(int)])
    return np.column_stack(columns)


def balance(law: str, name: str, **parameters: float) -> LawTruth:
    return LawTruth(law, LawPlace("balance", name), parameters)


def test_dry_friction_takes_the_same_from_every_swing_until_it_sticks() -> None:
    """Without damping each half swing is shorter by 2 F_c / k, and the last ends within F_c / k of rest."""
    p = {"mass.m": 1.5, "spring.k": 60.0, "damper.d": 0.0}
    time = times(CART, 601)
    outputs, states = simulate_rig(
        CART, p, [balance("coulomb_friction", "mass.v", F_c=0.9)], time, np.zeros((601, 1)), (0.2, 0.0)
    )
    half = np.pi * np.sqrt(1.5 / 60.0)
    reach, place = 0.9 / 60.0, 0.2
    for count in range(1, 20):
        place = -(place - np.copysign(2.0 * reach, place))
        if abs(place) < reach or count * half > time[-1]:
            break
        # Towards a turning point the spring's rest is shifted against the motion.
        rest = -np.copysign(reach, place)
        near = np.flatnonzero(np.abs(time - (count - 0.1) * half) < 0.1 * half)
        expected = rest + (place - rest) * np.cos(np.sqrt(40.0) * (time[near] - count * half))
        np.testing.assert_allclose(outputs[near, 0], expected, atol=1e-6)
    assert abs(place) < reach
    np.testing.assert_allclose(outputs[time > count * half + 0.01, 0], place, atol=1e-7)
    assert (states[time > count * half + 0.01, 1] == 0.0).all()


def test_an_end_stop_throws_the_cart_back_after_half_a_contact_period() -> None:
    p = {"mass.m": 1.5, "spring.k": 1e-9, "damper.d": 0.0}
    law = balance("end_stop", "mass.v", x_s=0.5, k_s=600.0)
    time = times(CART, 301)
    outputs, _ = simulate_rig(CART, p, [law], time, np.zeros((301, 1)), (0.0, 1.0))
    contact = np.pi / np.sqrt(400.0)
    np.testing.assert_allclose(outputs[time < 0.5, 0], time[time < 0.5], atol=1e-7)
    back = (time > 0.5 + contact) & (time < 1.4 + contact)
    np.testing.assert_allclose(outputs[back, 0], 0.5 - (time[back] - 0.5 - contact), atol=2e-6)


def test_within_its_play_a_shaft_transmits_nothing() -> None:
    p = {**SHAFT.parameters, "bearing.d": 0.0}
    law = LawTruth("backlash", LawPlace("coupling", "shaft.phi"), {"gap": 0.4})
    time = times(SHAFT, 201)
    _, states = simulate_rig(SHAFT, p, [law], time, np.zeros((201, 1)), (0.5, 0.1, -0.2 + 1e-6))
    crossing = 0.4 / 0.4
    free = time < crossing - 0.02
    np.testing.assert_allclose(states[free, :2], [[0.5, 0.1]] * free.sum(), atol=1e-12)
    np.testing.assert_allclose(states[free, 2], -0.2 + 1e-6 + 0.4 * time[free], atol=1e-9)
    momentum = 0.02 * states[:, 0] + 0.05 * states[:, 1]
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-9)
    assert states[-1, 0] < 0.45


def test_a_full_tank_spills_what_does_not_run_off() -> None:
    p = RESERVOIRS.parameters
    law = balance("overflow", "first.h", rim=0.9, share=0.25)
    time = times(RESERVOIRS, 1001)
    flow = 4.5e-4
    _, states = simulate_rig(RESERVOIRS, p, [law], time, np.full((1001, 1), flow), (0.8, 0.5))
    assert states[:, 0].max() == pytest.approx(0.9, abs=1e-9)
    full = np.flatnonzero(states[:, 0] > 0.9 - 1e-9)[0]
    np.testing.assert_allclose(states[full:, 0], 0.9, atol=1e-9)
    # The second gets the pipe's flow and a quarter of the rest: linear in its level.
    c, a = p["pipe.c"], p["second.A"]
    rate = (0.75 * c + p["outlet.c"]) / a
    end = (0.25 * flow + 0.75 * c * 0.9) / a / rate
    expected = end + (states[full, 1] - end) * np.exp(-rate * (time[full:] - time[full]))
    np.testing.assert_allclose(states[full:, 1], expected, atol=1e-9)


def test_actuators_and_sensors_by_closed_form() -> None:
    time, values = np.arange(0.0, 5.0), np.array([0.0, 2.0, 2.0, -1.0, -1.0])
    grid = np.linspace(0.0, 4.9, 50)

    breaks, late = delayed_command(time, values, 0.35)
    np.testing.assert_allclose(
        late[np.maximum(np.searchsorted(breaks, grid + 1e-9, "right") - 1, 0)],
        values[np.maximum(np.floor(grid - 0.35), 0).astype(int)],
    )

    def applied(law: str, **parameters: float) -> np.ndarray:
        rig = assembled(CART, CART.parameters, [LawTruth(law, LawPlace("input", "F"), parameters)])
        return rig.run(grid, values[np.floor(grid + 1e-9).astype(int)][:, None], (0.0, 0.0))[1][:, 2]

    lag = solve_ivp(
        lambda t, x: (values[min(int(t), 4)] - x) / 0.4, (0.0, 5.0), [0.0], t_eval=grid, max_step=0.01, rtol=1e-9
    )
    np.testing.assert_allclose(applied("lag", T=0.4), lag.y[0], atol=2e-3)
    np.testing.assert_allclose(
        applied("rate_limit", r_max=1.25),
        np.interp(grid, [0.0, 1.0, 2.6, 3.0, 5.0], [0.0, 0.0, 2.0, 2.0, -0.5]),
        atol=1e-8,
    )
    # Play of half-width 1: it moves only when the command has taken it up.
    np.testing.assert_allclose(command_with_play(time, values, 1.0, 1.0)[1], [0.0, 1.0, 0.0])
    # Half of the input is lost once its square has been the size's for long.
    held = np.full(100, 2.0)
    lost = faded_command(np.arange(100.0), held, 10.0, 0.5, 2.0)[1]
    np.testing.assert_allclose(lost, 2.0 - np.cumsum(np.append(0.0, np.exp(-np.arange(99) / 10.0))) * -np.expm1(-0.1))
    rows = times(CART, 801)
    command = steps(CART, 801)
    plain, _ = simulate_rig(CART, CART.parameters, [], rows, command, (0.0, 0.0))
    late, slow = (
        simulate_rig(
            CART, CART.parameters, [LawTruth(law, LawPlace("output", "position"), {"T": T})], rows, command, (0.0, 0.0)
        )[0]
        for law, T in (("delay", 0.03), ("lag", 0.004))
    )
    np.testing.assert_allclose(late[3:, 0], plain[:-3, 0], atol=1e-7)

    def rates(t: float, x: np.ndarray, force: float) -> list[float]:
        return [x[1], (force - 60.0 * x[0] - 2.0 * x[1]) / 1.5, (x[0] - x[2]) / 0.004]

    exact = [np.zeros(3)]
    for force in command[:-1]:
        exact.append(solve_ivp(rates, (0.0, 0.01), exact[-1], args=force, rtol=1e-9, atol=1e-12).y[:, -1])
    np.testing.assert_allclose(slow[:, 0], np.array(exact)[:, 2], atol=1e-6 * np.ptp(plain))


def test_rates_of_change_by_textbook_formulas() -> None:
    """Laws that only add a smooth term, against the right-hand sides written out here."""
    ambient = 293.15

    def heat(x, u):
        return [
            (u - 1.5 * (x[0] - x[1]) - 2e-9 * (x[0] ** 4 - ambient**4)) / 300.0,
            (1.5 * (x[0] - x[1]) - 0.8 * (x[1] - ambient) - 0.004 * (x[1] - ambient) ** 2) / 900.0,
        ]

    def tanks(x, u):
        a, b = np.sqrt(x)
        return [
            0.03 * u - 0.05 * a - 0.002 * x[0] + 0.01 * (x[1] - x[0]),
            0.05 * (a - b) - 0.01 * (x[1] - x[0]) - 0.003,
        ]

    def motor(x, u):
        i, w, rise = x
        return [
            (u - (2.0 + rise) * i - 0.08 * w) / 0.02,
            (0.08 * i - 2e-4 * w - 1e-6 * w * abs(w)) / 2e-4,
            (0.3 * i * i - rise) / 0.5,
        ]

    cases = [
        (HEAT, heat, [balance("radiation", "heater.T", k=2e-9), balance("square_loss", "plate.T", k=0.004)], 400),
        (TANKS, tanks, [balance("linear_loss", "h1", k=0.002), balance("exchange", "h1", k=0.01),
                        balance("offset", "h2", b=-0.003)], 300),
        (KINDS["motor"], motor, [balance("heating", "i", r_h=0.3, T_h=0.5), balance("quadratic_drag", "w", c=1e-6)],
         600),
    ]  # fmt: skip
    for kind, rates, laws, rows in cases:
        start = kind.rest(kind.parameters)
        commands = steps(kind, rows)
        _, states = simulate_rig(kind, kind.parameters, laws, times(kind, rows), commands, start)
        x = np.array([*start, *([0.0] if rates is motor else [])])
        for k in range(rows - 1):
            u = commands[k, 0]
            x = solve_ivp(lambda t, x, u=u: rates(x, u), (0.0, kind.step), x, "DOP853", rtol=1e-9, atol=1e-9).y[:, -1]  # noqa: B023
        assert (np.abs(states[-1] - x[: len(start)]) < 1e-6 * np.ptp(states, axis=0)).all()
