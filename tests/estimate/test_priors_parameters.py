"""Priors against SciPy's densities and quadrature; the change of variables against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_form import parameter
from scipy import integrate, stats

from aero_bayes import load_model
from aero_bayes.errors import InputError
from aero_bayes.estimate import LogNormal, LogUniform, Normal, ParameterSpec, Uniform, parameters_from_model
from aero_bayes.estimate.parameters import ParameterSet

pytestmark = pytest.mark.fast

PRIORS = [
    Uniform(-1.0, 3.0),
    LogUniform(1e-3, 1e2),
    Normal(1.0, 2.0),
    Normal(1.0, 0.5, 0.2, 1.4),
    Normal(-3.0, 0.4, 0.5, 2.0),
    LogNormal(0.042, 0.1),
    LogNormal(2.0, 0.8, 0.5, 3.0),
    LogNormal(1.0, 0.3, 4.0, 9.0),
]


@pytest.mark.parametrize("prior", PRIORS, ids=repr)
def test_density_is_normalised_and_draws_follow_it(prior: object) -> None:
    low, high = max(prior.lower, -50.0), min(prior.upper, 200.0)
    if isinstance(prior, LogUniform | LogNormal):
        low = max(low, 1e-6)
        mass = integrate.quad(lambda u: math.exp(float(prior.log_pdf(math.exp(u))) + u), math.log(low), math.log(high))
    else:
        mass = integrate.quad(lambda x: math.exp(float(prior.log_pdf(x))), low, high, points=[min(max(1.0, low), high)])
    assert mass[0] == pytest.approx(1.0, abs=1e-6)
    draws = prior.sample(np.random.default_rng(3), 4000)
    assert draws.min() >= prior.lower
    assert draws.max() <= prior.upper
    grid = np.geomspace(low, high, 20001) if low > 0 else np.linspace(low, high, 20001)
    density = np.exp(prior.log_pdf(grid))
    cdf = np.concatenate([[0.0], np.cumsum(np.diff(grid) * 0.5 * (density[1:] + density[:-1]))])
    assert stats.kstest(draws, lambda x: np.interp(x, grid, cdf / cdf[-1])).pvalue > 1e-4


def test_far_tail_keeps_its_digits() -> None:
    prior = Normal(0.0, 1.0, 30.0, 31.0)
    reference = stats.norm.logpdf(30.2) - stats.norm.logsf(30.0)
    assert float(prior.log_pdf(30.2)) == pytest.approx(reference, rel=1e-9)


@pytest.mark.parametrize(
    ("prior", "reference"),
    [
        (Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
        (Normal(1.0, 0.5, 0.2, 1.4), stats.truncnorm(-1.6, 0.8, 1.0, 0.5)),
        (LogNormal(0.042, 0.1), stats.lognorm(0.1, scale=0.042)),
        (LogUniform(1e-3, 1e2), stats.loguniform(1e-3, 1e2)),
    ],
)
def test_density_agrees_with_scipy(prior: object, reference: object) -> None:
    x = reference.ppf(np.linspace(0.01, 0.99, 25))
    np.testing.assert_allclose(prior.log_pdf(x), reference.logpdf(x), rtol=1e-10, atol=1e-10)


def sample_set() -> ParameterSet:
    return ParameterSet(
        (
            parameter("a", 2.0, 0.5, 8.0, LogNormal(2.0, 0.5), "log"),
            parameter("b", 2.0, 0.5, 8.0, Normal(3.0, 1.0), "log"),
            parameter("c", 0.0, -4.0, 6.0, Normal(0.5, 2.0), "linear"),
            parameter("d", 1.0, 0.1, 10.0, LogUniform(0.1, 10.0), "log"),
            parameter("e", 1.0, 0.1, 10.0, LogNormal(1.0, 0.4), "linear"),
        )
    )


def test_round_trip_and_jacobian() -> None:
    s = sample_set()
    values = s.sample_prior(np.random.default_rng(4), 50)
    u = s.to_search(values)
    np.testing.assert_allclose(s.from_search(u), values, rtol=1e-13)
    h = 1e-6
    for j in range(len(s)):
        step = np.zeros(len(s))
        step[j] = h
        slope = (s.from_search(u + step) - s.from_search(u - step))[:, j] / (2 * h)
        inside = (values[:, j] > 1.01 * s.items[j].lower) & (values[:, j] < 0.99 * s.items[j].upper)
        np.testing.assert_allclose(slope[inside], s.jacobian(values)[inside, j], rtol=1e-6)


def test_a_prior_integrates_to_one_and_its_derivatives_are_right() -> None:
    s = sample_set()
    low, high = s.box
    centre = s.to_search(s.start)
    total = 0.0
    for j in range(len(s)):
        grid = np.linspace(low[j], high[j], 4001)
        points = np.tile(centre, (grid.size, 1))
        points[:, j] = grid
        rest = s.log_prior(centre[None])[0]
        relative = integrate.simpson(np.exp(s.log_prior(points) - rest), x=grid)
        item = s.items[j]
        own = float(item.prior.log_pdf(item.start)) + math.log(s.jacobian(s.start)[j])
        assert relative * math.exp(own) == pytest.approx(1.0, abs=1e-6)
        total += own
    assert s.log_prior(centre[None])[0] == pytest.approx(total)
    rng = np.random.default_rng(5)
    for _ in range(20):
        u = low + (0.1 + 0.8 * rng.random(len(s))) * (high - low)
        first, second = s.prior_derivatives(u)
        h = 1e-4
        for j in range(len(s)):
            e = np.zeros(len(s))
            e[j] = h
            up, mid, down = s.log_prior(np.stack([u + e, u, u - e]))
            assert first[j] == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-5)
            assert second[j] == pytest.approx((up - 2 * mid + down) / h**2, rel=1e-4, abs=1e-4)


def test_outside_the_box_has_no_density() -> None:
    s = sample_set()
    low, high = s.box
    points = np.tile(s.to_search(s.start), (4, 1))
    points[0, 0], points[1, 2] = low[0] - 1e-9, high[2] + 1e-9
    points[2:] = [[-1e4], [1e4]]  # beyond any number: no warning either
    with np.errstate(all="raise"):
        assert np.all(s.log_prior(points) == -np.inf)


@pytest.mark.parametrize(
    ("start", "lower", "upper", "scale", "says"),
    [(9.0, 0.5, 8.0, "linear", "outside"), (1.0, 8.0, 0.5, "linear", "interval"), (1.0, -1.0, 8.0, "log", "positive")],
)
def test_bad_bounds_are_one_clear_line(start: float, lower: float, upper: float, scale: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        parameter("R_a", start, lower, upper, Uniform(-10.0, 10.0), scale)
    assert "R_a" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_widest_logarithmic_range_has_a_finite_density() -> None:
    tiny = float(np.finfo(float).tiny)
    sd = ParameterSet((parameter("T", 0.5, tiny, 500.0, LogUniform(tiny, 500.0), "log"),)).prior_sd()
    assert sd[0] == pytest.approx((math.log(500.0) - math.log(tiny)) / math.sqrt(12.0), rel=1e-3)


def test_a_bound_small_beyond_measure_says_only_the_sign(tmp_path) -> None:
    source = tmp_path / "Lag.mo"
    source.write_text(
        "model Lag\n  parameter Real T(unit=\"s\", min=2.2e-308) = 0.5;\n  parameter Real g(min=0.1) = 2;\n"
        "  input Real u;\n  output Real y(start=0, fixed=true);\nequation\n  T*der(y) = g*u - y;\nend Lag;\n", "utf-8",
    )  # fmt: skip
    model = load_model("Lag", sources=[source])
    found = parameters_from_model(model, ["T", "g"])
    assert (found["T"].lower, found["g"].lower) == (0.5e-3, 0.1)
    asked = parameters_from_model(model, ["T"], {"T": ParameterSpec(lower=1e-13)})
    assert asked["T"].lower == 1e-13
