"""The search over structures on models with closed forms: linear ones, and formulas with a threshold."""

from __future__ import annotations

from dataclasses import replace

import closed_form
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from aero_bayes.estimate import (
    LocalFitSettings,
    LocalSettings,
    NoiseModel,
    Normal,
    Objective,
    Parameter,
    Stop,
    local_fit,
)
from aero_bayes.laws import CandidateTerm
from aero_bayes.search import (
    START_RULES,
    CandidateModel,
    FitNoise,
    Library,
    Parts,
    SearchControl,
    Structure,
    StructureSearch,
    StructureSettings,
    common_noise,
    likely_pairs,
    starting_points,
    term_directions,
)
from aero_bayes.search.edits import AddCurve, AddTerm, EditContext, InputInterpolation
from aero_bayes.sensors import OutputNoise
from aero_bayes.sensors.noise_estimation import is_model_error
from aero_bayes.sensors.whiteness import residual_correlation_time
from aero_bayes.simulation import Experiment, ParameterTarget, Problem, Trajectories, open_simulator

pytestmark = pytest.mark.fast

TIME = np.arange(600) * 0.05
#: Response to each parameter: two of the base, three of effects (the last is a twin of the first effect).
BASIS = np.stack(
    [np.ones(600), TIME / 30.0, np.sin(TIME), np.sign(np.sin(1.7 * TIME)), np.sin(TIME) + 1e-9 * np.cos(TIME)]
)
NOISE = OutputNoise(0.3, 0.2, 0.2)
EXACT = LocalFitSettings(LocalSettings(iterations=40, tolerance=1e-9), hold_noise=True)


class LinearSimulator:
    """Answers ``y = basis' p`` with exact sensitivities: a second implementation of the simulators' contract."""

    def __init__(self, measured, basis):
        self.basis = basis
        self.problem = Problem(None, (Experiment(TIME, ("y",), measured=measured[:, None]),), ((None,) * 5,))

    def simulate(self, values, *, active=None):
        outputs = (values @ self.basis)[:, :, None]
        slopes = None
        if active is not None:
            slopes = (np.repeat(self.basis[list(active)].T[None, :, None, :], len(values), axis=0),)
        return Trajectories((outputs,), slopes, np.zeros((len(values), 1), dtype=np.uint8))

    def close(self):
        pass


def parameter(name, low=-50.0):
    return Parameter(name, "1", 0.0, low, 50.0, Normal(0.0, 3.0), "linear", "", ParameterTarget(name))


def covariance():
    apart = np.abs(TIME[:, None] - TIME[None, :])
    return NOISE.sd_white**2 * np.eye(600) + NOISE.sd_ou**2 * np.exp(-apart / NOISE.tau)


def study(truth, seed, basis=BASIS, low=-50.0):
    rng = np.random.default_rng(seed)
    noise = np.linalg.cholesky(covariance()) @ rng.normal(size=600)
    measured = np.asarray(truth) @ basis + noise
    problem = closed_form.calibration(
        [(TIME, measured[:, None])], ["y"], [parameter(name, low) for name in "abcde"], NoiseModel()
    )
    return Objective(problem, LinearSimulator(measured, basis))


CANDIDATES = {
    "sine": CandidateTerm("sine", "one", ((1.0,), (-1.0,)), (2,)),
    "square": CandidateTerm("square", "two", ((1.0,), (-1.0,)), (3,)),
    "twin": CandidateTerm("twin", "three", ((1.0,), (-1.0,)), (4,)),
}


class OneModel:
    """A cache of one model that has all its candidates at hand, whatever is asked for."""

    free_later = ()
    interpolation_is_free = False

    def __init__(self, objective, candidates=None):
        self.model = CandidateModel(objective, candidates or CANDIDATES, (0, 1), open_simulator)
        self.ports = {id_: c.port for id_, c in self.model.candidates.items()}

    def of(self, structure, extra=()):
        assert {*structure.terms, *extra} <= self.model.candidates.keys()
        return self.model

    def root(self, values=None, noise=NOISE):
        return self.model.fit(Structure(), self.model.coordinates_of(values or {}, ()), FitNoise({"y": noise}), EXACT)


FLOORS = {("run 0", "y"): 0.36}


def searched(cache, settings=None, refines=None, parts=None, work=None, floors=None, **root):
    refines = refines or {}
    library = Library([tuple(cache.model.candidates)], refines, ())
    search = StructureSearch(
        cache, library, settings or StructureSettings(), LocalFitSettings(), FLOORS if floors is None else floors,
        parts or Parts(restarts=()), work or SearchControl(),
    )  # fmt: skip
    return search.run(cache.root(**root))


def found(truth, seed, settings=None, refines=None, **given):
    return searched(OneModel(study(truth, seed, **given)), settings, refines)


def test_the_missing_term_is_found_under_the_noise_of_the_best():
    explored = found([1.0, 2.0, 0.6, 0.0, 0.0], 2)
    assert explored.best.terms in (("sine",), ("twin",))
    sine, twin = (explored.fits[Structure((t,))] for t in ("sine", "twin"))
    assert abs(sine.log_posterior - twin.log_posterior) < 0.1
    assert all(f.optimum.noise == explored.best.optimum.noise for f in explored.fits.values())


def test_two_missing_terms_are_both_found():
    assert set(found([1.0, 2.0, 0.0, 0.5, 0.7], 3).best.terms) in ({"square", "sine"}, {"square", "twin"})


def test_nothing_is_found_where_nothing_is_missing():
    for seed in range(8):
        assert not found([1.0, 2.0, 0.0, 0.0, 0.0], 100 + seed).best.terms


def test_a_term_that_is_fitted_to_a_magnitude_of_zero_is_off():
    """Its magnitude cannot be negative, and the one that acts is."""
    for size, off in ((-0.6, ("sine",)), (0.6, ())):
        cache = OneModel(study([1.0, 2.0, size, 0.0, 0.0], 2, low=0.0))
        both = Structure(("sine",))
        assert (
            cache.model.fit(
                both, cache.model.coordinates_of({"c": 0.5}, ("sine",)), cache.root().noise, EXACT
            ).off_terms
            == off
        )


def test_when_the_time_is_up_what_was_found_by_then_is_kept():
    ended, counts = set(), set()
    for limit in (*range(12), 1000):
        asked = iter(range(limit))
        work = SearchControl(time_is_up=lambda asked=asked: next(asked, None) is None)
        explored = searched(OneModel(study([1.0, 2.0, 0.0, 0.5, 0.7], 3)), work=work)
        ended.add(explored.ended)
        counts.add(len(explored.best.terms))
    assert "the search" in ended
    assert "" in ended
    assert {0, 2} <= counts


def test_two_take_the_place_of_one_that_does_a_little_of_both():
    """The third is the sum of both and of something else, and nothing can be less than zero."""
    basis = BASIS.copy()
    basis[4] = BASIS[2] + BASIS[3] + 0.5 * np.cos(2.3 * TIME)
    for seed in range(4):
        explored = found([1.0, 2.0, 0.6, 0.6, 0.0], 200 + seed, basis=basis, low=0.0)
        assert explored.best.terms == ("sine", "square")


def test_a_pair_that_does_little_alone_is_foretold_in_closed_form():
    """Each of two is mostly what the other takes away; what is missing is what both have in common."""
    basis = BASIS.copy()
    missing, strange = np.cos(2.3 * TIME), np.sin(TIME)
    basis[2], basis[3], basis[4] = strange + 0.1 * missing, -strange + 0.1 * missing, np.sign(np.sin(1.7 * TIME))
    cache = OneModel(study([1.0, 2.0, 4.0, 4.0, 0.0], 5, basis=basis, low=0.0))
    root = cache.root()
    assert set(likely_pairs(term_directions(root))[0]) == {"sine", "square"}
    both = Structure(("sine", "square"))
    (best, *_) = starting_points(START_RULES, root, both)
    end = cache.model.fit(both, best.point, FitNoise({"y": NOISE}), EXACT)
    assert best.expected_gain == pytest.approx(end.optimum.log_likelihood - root.optimum.log_likelihood, rel=0.02)
    assert searched(cache).best.terms == ("sine", "square")


def test_a_term_that_the_free_parameters_imitate_is_not_offered():
    basis = BASIS.copy()
    basis[2] = 0.3 * BASIS[0] - 2.0 * BASIS[1]
    cache = OneModel(study([1.0, 2.0, 0.0, 1.0, 0.0], 6, basis=basis))
    assert [d.id for d in term_directions(cache.root()) if d.confounded] == ["sine"]
    assert not any("sine" in s.terms for s in searched(cache).fits)


@pytest.mark.parametrize(("size", "scale", "offered"), [(0.0, 1.0, False), (0.6, 1.0, True), (0.0, 1e-4, True)])
def test_beside_a_term_only_what_slopes_promise_or_cannot_tell_is_offered(size, scale, offered):
    """What slopes promise is what a fit gains; a term that they hardly show may act elsewhere."""
    basis = BASIS.copy()
    basis[2] *= scale
    model = OneModel(study([1.0, 2.0, size, 0.8, 0.0], 7, basis=basis)).model
    one, both, noise = Structure(("square",)), Structure(("square", "sine")), FitNoise({"y": NOISE})
    fitted, larger = (model.fit(s, model.coordinates_of({"d": 0.8}, s.terms), noise, EXACT) for s in (one, both))
    directions = tuple(term_directions(fitted))
    (promised,) = [d.gain for d in directions if d.id == "sine"]
    gained = larger.optimum.log_likelihood - fitted.optimum.log_likelihood
    assert promised == (pytest.approx(gained, rel=0.02, abs=0.02) if scale == 1.0 else np.inf)
    context = EditContext(fitted, False, ("sine", "square"), {}, (), (), (), directions, False, True)
    assert (both in set(AddTerm().neighbours(context))) is offered


def test_inputs_are_read_the_other_way_with_the_best_structures_of_a_size():
    """Else a law would be compared with a coarser one that reads the inputs wrongly."""
    fitted = OneModel(study([1.0, 2.0, 0.0, 0.8, 0.0], 7)).root()
    one, other = Structure(("square",)), Structure(("sine",))
    context = EditContext(replace(fitted, structure=one), False, (), {}, (), (), (), (), True, True, (one, other))
    found = set(InputInterpolation().neighbours(context))
    assert {replace(s, other_interpolation=True) for s in (one, other, Structure())} == found
    assert not list(InputInterpolation().neighbours(replace(context, best=False)))


def test_a_required_term_stays_and_the_missing_one_is_found_beside_it():
    settings = StructureSettings(require=("square",))
    alone = found([1.0, 2.0, 0.0, 0.0, 0.0], 100, settings)
    assert alone.best.terms == ("square",)
    beside = found([1.0, 2.0, 0.6, 0.0, 0.0], 2, settings)
    assert set(beside.best.terms) in ({"square", "sine"}, {"square", "twin"})


def test_a_refinement_is_found_where_what_it_refines_shows_nothing():
    refines = {"square": "sine"}
    assert found([1.0, 2.0, 0.0, 0.9, 0.0], 5, refines=refines).best.terms == ("square",)
    assert found([1.0, 2.0, 0.6, 0.0, 0.0], 2, refines=refines).best.terms in (("sine",), ("twin",))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.98])
def test_the_autocorrelation_time_of_a_first_order_process_is_known(rho):
    """Of ``x' = rho x + e`` it is ``(1 + rho) / (1 - rho)``; the sum ends at a twentieth."""
    rng = np.random.default_rng(7)
    x = lfilter([1.0], [1.0, -rho], rng.standard_normal((4, 40_000)))
    assert residual_correlation_time(list(x)) == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.2)


def test_noise_with_structure_left_counts_effective_samples():
    """A sine that no parameter explains is no noise: its readings count for few; white noise counts in full."""
    cache = OneModel(study([1.0, 2.0, 3.0, 0.0, 0.0], 4))
    root = cache.root()
    left = common_noise(root, FLOORS)
    assert left.structured == ("y",)
    assert left.noise.temperature > 6.0  # of 600 readings fewer than 100 count
    assert left.noise.outputs["y"].sd == pytest.approx(np.sqrt(np.mean(root.optimum.evaluation.residual[0] ** 2)))
    assert left.noise.temperature > 6.0
    right = cache.model.fit(Structure(("sine",)), root.optimum.coordinates, FitNoise({"y": NOISE}), EXACT)
    assert common_noise(right, FLOORS).noise.temperature == 1.0


def formula_cache(formula, measured, candidate):
    """One candidate on a model that is a formula of five parameters."""
    problem = closed_form.calibration([(TIME, measured[:, None])], ["y"], [parameter(name) for name in "abcde"])
    simulator = closed_form.FormulaSimulator(problem.problem(), formula)
    return OneModel(Objective(problem, simulator), {candidate.id: candidate})


def clipped(time, p):
    """The third parameter acts only beyond one: then it clips the line that the second one makes."""
    return np.minimum(p[0] + p[1] * time / 30.0, 1.0 / np.maximum(p[2], 1e-12))[:, None]


def test_the_limit_of_what_is_clipped_at_its_very_end_is_closed_in_on():
    rng = np.random.default_rng(8)
    limit, noise = 2.85, OutputNoise(0.02, 0.0, 1.0)
    measured = np.minimum(1.0 + 2.0 * TIME / 30.0, limit) + noise.sd_white * rng.normal(size=600)
    starts = tuple((share / 2.4,) for share in (1.0, 0.1, 0.3, 0.6, 0.75, 0.9, 1.2, 2.5))
    cache = formula_cache(clipped, measured, CandidateTerm("clip", "in", starts, (2,)))
    explored = searched(cache, floors={}, values={"a": 1.0, "b": 2.0}, noise=noise)
    assert explored.best.terms == ("clip",)
    assert 1.0 / explored.best.values["c"] == pytest.approx(limit, abs=0.02)


LEVELS = np.where(np.arange(600) < 10, 3.0, np.where(np.random.default_rng(1).random(600) < 0.5, 1.2, 4.8))


def limited(time, p):
    """A power law, its factor and exponent the first two parameters, of an input that the third limits."""
    return (np.exp(p[0]) * np.minimum(LEVELS, 1.0 / np.maximum(p[2], 1e-12)) ** p[1])[:, None]


def test_a_limit_is_found_though_other_parameters_readjust_along_no_line():
    limit, noise = 3.5, OutputNoise(0.01, 0.0, 1.0)
    exact = limited(TIME, np.array([0.3, 0.7, 1.0 / limit]))[:, 0]
    measured = exact + noise.sd_white * np.random.default_rng(8).normal(size=600)
    starts = tuple((share / 3.8,) for share in (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0))
    cache = formula_cache(limited, measured, CandidateTerm("limit", "in", starts, (2,)))
    explored = searched(cache, floors={}, values={"a": 0.3, "b": 0.7}, noise=noise)
    # One block of readings alone shows it, so that left-out ones need not.
    assert 1.0 / explored.fits[Structure(("limit",))].values["c"] == pytest.approx(limit, abs=0.02)


def just_limited(time, p):
    """A gain, the first parameter, of an input of two values that the third parameter limits."""
    return (p[0] * np.minimum(np.where(LEVELS < 2.0, 1.2, 4.8), 1.0 / np.maximum(p[2], 1e-12)))[:, None]


def test_a_limit_just_below_an_input_of_two_values_is_found_where_it_was_simulated():
    """Every limit promises the same to first order, but one that is far beyond the input has no effect."""
    limit, noise = 4.7, OutputNoise(0.01, 0.0, 1.0)
    exact = just_limited(TIME, np.array([1.0, 0.0, 1.0 / limit]))[:, 0]
    measured = exact + noise.sd_white * np.random.default_rng(8).normal(size=600)
    starts = tuple((1.25 * share / 4.8,) for share in (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0))
    cache = formula_cache(just_limited, measured, CandidateTerm("limit", "in", starts, (2,)))
    explored = searched(cache, floors={}, values={"a": 1.0}, noise=noise)
    assert explored.best.terms == ("limit",)
    assert 1.0 / explored.best.values["c"] == pytest.approx(limit, abs=0.02)


def damped(time, p):
    """A wave, its height and frequency the first two parameters; the third damps it."""
    return (p[0] * np.exp(-(p[2] ** 2) * time) * np.sin(p[1] * time))[:, None]


class FromElsewhere:
    """A restart of a user's own: from a frequency of 3.72."""

    def refit(self, fitted, settings):
        start = fitted.model.coordinates_of(fitted.values | {"b": 3.72}, fitted.terms)
        return fitted.model.fit(fitted.structure, start, fitted.noise, settings)


def test_what_only_led_the_fit_out_of_a_local_optimum_is_no_missing_term():
    noise = OutputNoise(0.1)
    exact = damped(TIME, np.array([1.0, 3.7, 0.0]))[:, 0]
    measured = exact + noise.sd_white * np.random.default_rng(4).normal(size=600)
    cache = formula_cache(damped, measured, CandidateTerm("damping", "in", ((0.7,), (0.5,)), (2,)))
    assert abs(cache.root({"a": 1.0, "b": 3.0}, noise).values["b"] - 3.7) > 0.1
    parts = Parts(restarts=((FromElsewhere(), 1),))
    explored = searched(cache, parts=parts, floors={}, values={"a": 1.0, "b": 3.0}, noise=noise)
    assert not explored.best.terms
    assert explored.best.values["b"] == pytest.approx(3.7, abs=0.01)


def test_a_required_term_begins_off_if_it_can_begin_nowhere_else():
    def breaks(time, p):
        """A line and a wave, which breaks as soon as it is seen."""
        wave = p[2] * np.sin(time) if np.real(p[2]) < 0.5 else np.nan * time
        return (p[0] + p[1] * time / 30.0 + wave)[:, None]

    rng = np.random.default_rng(11)
    noise = OutputNoise(0.02, 0.0, 1.0)
    measured = 1.0 + 2.0 * TIME / 30.0 + 0.1 * np.sin(TIME) + noise.sd_white * rng.normal(size=TIME.size)
    cache = formula_cache(breaks, measured, CandidateTerm("wave", "in", ((1.0,), (2.0,)), (2,)))
    settings = StructureSettings(require=("wave",), max_effects=1)
    explored = searched(cache, settings, floors={}, values={"a": 1.0, "b": 2.0}, noise=noise)
    assert explored.fits[Structure(("wave",))].values["c"] == pytest.approx(0.1, abs=0.02)


def test_a_fit_that_converges_to_another_optimum_goes_on_whatever_is_known():
    noise = OutputNoise(0.1)
    measured = damped(TIME, np.array([1.0, 3.7, 0.0]))[:, 0] + 0.1 * np.random.default_rng(4).normal(size=600)
    objective = formula_cache(damped, measured, CandidateTerm("damping", "in", ((0.7,), (0.5,)), (2,))).model.objective
    right, wrong = (objective.parameters.to_search(np.array([0.8, w, 0.0, 0.0, 0.0])) for w in (3.72, 4.15))
    best = local_fit(objective, right, (0, 1), noise={"y": noise})
    alone, beside = (local_fit(objective, wrong, (0, 1), noise={"y": noise}, known=known) for known in ([], [best]))
    assert alone.log_likelihood < best.log_likelihood - 100.0
    assert beside.reason is not Stop.KNOWN_OPTIMUM
    np.testing.assert_array_equal(beside.coordinates, alone.coordinates)


def test_an_optimum_under_another_noise_is_what_a_fit_under_it_finds():
    """Where there is one output and hardly a prior, another noise moves no optimum."""
    objective = study([1.0, 2.0, 0.0, 0.0, 0.0], 1)
    one = local_fit(objective, np.zeros(5), (0, 1), noise={"y": OutputNoise(0.3)}, settings=EXACT)
    other = local_fit(objective, np.zeros(5), (0, 1), noise={"y": OutputNoise(0.9)}, settings=EXACT)
    moved = one.with_noise(objective, {"y": OutputNoise(0.9)})
    assert moved.log_evidence == pytest.approx(other.log_evidence, abs=1e-3)
    np.testing.assert_allclose(moved.covariance, other.covariance, rtol=1e-6)


def test_climb_has_the_exact_posterior_and_evidence():
    held = study([1.0, 2.0, 0.0, 0.0, 0.0], 1)
    found = local_fit(held, np.zeros(5), (0, 1), noise={"y": NOISE}, settings=EXACT)
    design, inner = BASIS[:2], np.linalg.inv(covariance())
    precision = design @ inner @ design.T + np.eye(2) / 9.0
    measured = held.series[0].measured
    mean = np.linalg.solve(precision, design @ inner @ measured)
    values = held.parameters.from_search(found.coordinates)[:2]
    np.testing.assert_allclose(values, mean, rtol=1e-3, atol=2e-3 * np.sqrt(1 / precision[0, 0]))
    np.testing.assert_allclose(found.covariance * 100.0**2, np.linalg.inv(precision), rtol=1e-4)
    evidence = multivariate_normal(np.zeros(600), covariance() + 9.0 * design.T @ design).logpdf(measured)
    assert found.reason.converged
    assert found.log_evidence == pytest.approx(evidence, abs=0.05)


def test_a_second_climb_into_the_same_valley_is_given_up_at_once():
    held = study([1.0, 2.0, 0.6, 0.0, 0.0], 2)
    first = local_fit(held, np.zeros(5), (0, 1, 2), noise={"y": NOISE})
    far = held.parameters.to_search(np.array([5.0, -3.0, 4.0, 0.0, 0.0]))
    before = held.simulations
    again = local_fit(held, far, (0, 1, 2), noise={"y": NOISE}, known=[first])
    assert again.reason is Stop.KNOWN_OPTIMUM
    assert held.simulations - before == 1


def test_laws_take_the_place_of_each_curve_beside_the_other():
    """Only curves were tried: what is fitted beside the chosen ones is each law at the port of one of them."""
    candidates = {
        "sine@one": CandidateTerm("sine@one", "one", ((1.0,), (-1.0,)), (2,)),
        "curve@one": CandidateTerm("curve@one", "one", (), (2,)),
        "square@two": CandidateTerm("square@two", "two", ((1.0,), (-1.0,)), (3,)),
        "curve@two": CandidateTerm("curve@two", "two", (), (3,)),
    }
    cache = OneModel(study([1.0, 2.0, 1.5, 1.0, 0.0], 12), candidates)
    search = StructureSearch(
        cache, Library([tuple(candidates)], {}, ("curve@one", "curve@two")), StructureSettings(), LocalFitSettings(),
        FLOORS, Parts(edits=(AddCurve(),), restarts=()),
    )  # fmt: skip
    curves = Structure(("curve@one", "curve@two"))
    explored = search.run(cache.root())
    assert curves in explored.fits
    assert not any({"sine@one", "square@two"} & set(s.terms) for s in explored.fits)
    beside = search.complete(explored.fits[curves]).fits
    for named in (Structure(("sine@one", "curve@two")), Structure(("curve@one", "square@two"))):
        assert beside[named].log_posterior == pytest.approx(beside[curves].log_posterior, abs=0.1)


def test_refinements_at_its_port_are_compared_with_a_law_before_it_is_named():
    """Where only noise is left they are not offered, so that another law there would be named without a rival."""
    candidates = {
        "sine@one": CandidateTerm("sine@one", "one", ((1.0,), (-1.0,)), (2,)),
        "step@one": CandidateTerm("step@one", "one", ((1.0,), (-1.0,)), (3,)),
        "twin@one": CandidateTerm("twin@one", "one", ((1.0,), (-1.0,)), (4,)),
    }
    cache = OneModel(study([1.0, 2.0, 0.1, 0.0, 0.0], 3), candidates)
    library = Library([tuple(candidates)], {"twin@one": "step@one"}, ())
    search = StructureSearch(
        cache, library, StructureSettings(), LocalFitSettings(), FLOORS, Parts(edits=(AddTerm(),), restarts=())
    )
    chosen, twin = Structure(("sine@one",)), Structure(("twin@one",))
    explored = search.run(cache.root())
    assert chosen in explored.fits
    assert twin not in explored.fits
    beside = search.complete(explored.fits[chosen]).fits
    assert beside[twin].log_posterior == pytest.approx(beside[chosen].log_posterior, abs=0.1)


def test_noise_that_is_correlated_up_to_the_limit_is_model_error():
    """A sensor's noise is correlated for at most a fiftieth of the recording, unless it is small beside the white."""
    assert is_model_error(OutputNoise(0.1, 0.3, 0.6), 30.0)
    assert not is_model_error(OutputNoise(0.1, 0.3, 0.5), 30.0)
    assert not is_model_error(OutputNoise(0.3, 0.1, 0.6), 30.0)
    rng, slow = np.random.default_rng(3), np.exp(-0.05 / 1.5)
    drift = lfilter([np.sqrt(1.0 - slow**2)], [1.0, -slow], rng.normal(size=600))
    problem = closed_form.calibration(
        [(TIME, (drift + 0.05 * rng.normal(size=600))[:, None])], ["y"], [parameter(n) for n in "abcde"], NoiseModel()
    )
    root = OneModel(Objective(problem, LinearSimulator(problem.data.measured[0][:, 0], BASIS))).root()
    assert common_noise(root, {}).structured == ("y",)
