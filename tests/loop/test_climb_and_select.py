"""Climbs and the choice between effects on a linear model, whose posterior and evidence have closed forms."""

from __future__ import annotations

import closed_form
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aero_bayes.estimate.climb import ClimbSettings, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.priors import Normal
from aero_bayes.estimate.search import LocalSettings, Stop
from aero_bayes.loop.attribute import Search
from aero_bayes.loop.pairs import likely_pairs
from aero_bayes.loop.prospect import prospect, score
from aero_bayes.loop.rounds import threshold, with_odds
from aero_bayes.loop.settings import AttributeSettings
from aero_bayes.loop.stand import Stand
from aero_bayes.physics.kin import Candidate
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Experiment, ParameterTarget, Problem, Trajectories

TIME = np.arange(600) * 0.05
#: Response to each parameter: two of the base, three of effects (the last is a twin of the first effect).
BASIS = np.stack(
    [np.ones(600), TIME / 30.0, np.sin(TIME), np.sign(np.sin(1.7 * TIME)), np.sin(TIME) + 1e-9 * np.cos(TIME)]
)
NOISE = OutputNoise(0.3, 0.2, 0.5)
EXACT = ClimbSettings(LocalSettings(max_iterations=40, tolerance=1e-9), hold_noise=True)


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
    problem = closed_form.calibration([(TIME, measured[:, None])], ["y"], [parameter(name, low) for name in "abcde"])
    return Objective(problem, LinearSimulator(measured, basis))


CANDIDATES = {
    "sine": Candidate("sine", "one", ((1.0,), (-1.0,)), (2,)),
    "square": Candidate("square", "two", ((1.0,), (-1.0,)), (3,)),
    "twin": Candidate("twin", "three", ((1.0,), (-1.0,)), (4,)),
}


class OneStand:
    """The stands of a model that has all its candidates at once."""

    def __init__(self, truth, seed, **given):
        self.stand = Stand(study(truth, seed, **given), CANDIDATES, (0, 1), open_simulator)

    def of(self, ids):
        assert set(ids) <= CANDIDATES.keys()
        return self.stand

    undecided = ()

    def read_otherwise(self):
        return None

    def finer(self, held):
        return None


def selected(truth, seed, structured=False, require=(), finer=None, **given):
    stands, finer = OneStand(truth, seed, **given), finer or {}
    search = Search(stands, [tuple(CANDIDATES)], finer, AttributeSettings(require=require), ClimbSettings())
    base = stands.stand.fit({}, (), {"y": NOISE}, ClimbSettings())
    ids = tuple(id_ for id_ in CANDIDATES if id_ not in finer)
    return search.select(base, ids, lambda held: structured, lambda what, share: None)


class TwoReadings(OneStand):
    """Stands whose inputs can be read the other way, in which the recording is another."""

    def __init__(self, truth, other, seed):
        super().__init__(truth, seed)
        self.other = OneStand(other, seed)
        self.other.forget = lambda: None

    def read_otherwise(self):
        return self.other

    def forget(self):
        self.forgotten = True


def test_inputs_are_read_the_other_way_where_a_first_effect_shows_it():
    rough = [1.0, 2.0, 3.0, 2.0, 0.0]
    for truth, other, turned in ((rough, [1.0, 2.0, 3.0, 0.0, 0.0], True), (rough, [1.0, 2.0, 3.0, 6.0, 0.0], False)):
        stands = TwoReadings(truth, other, 3)
        ids = ("sine",)
        search = Search(stands, [tuple(CANDIDATES)], {}, AttributeSettings(), ClimbSettings())
        base = stands.stand.fit({}, (), {"y": NOISE}, ClimbSettings())
        found = search.select(base, ids, lambda held: False, lambda what, share: None)
        assert found.effects == ("sine",)
        assert (found.base.stand is stands.other.stand) == turned == (search.stands is stands.other)
        assert found.held.stand is search.stands.stand
        assert len(found.rounds) == 2


@pytest.mark.parametrize(("square", "require", "turned"), [(0.0, (), True), (6.0, (), False), (0.0, ("sine",), False)])
def test_inputs_are_read_the_other_way_where_that_does_what_a_second_effect_does(square, require, turned):
    """The first effect was not quite what is missing, so that beside it the reading was not seen to be wrong."""
    stands = TwoReadings([1.0, 2.0, 3.0, 2.0, 0.0], [1.0, 2.0, 3.0, square, 0.0], 3)
    search = Search(stands, [tuple(CANDIDATES)], {}, AttributeSettings(require=require), ClimbSettings())
    both = stands.stand.fit({"c": 2.5, "d": 2.5}, ("sine", "square"), {"y": NOISE}, ClimbSettings())
    found = search._reread(both)
    assert (found is not None) == turned == (search.stands is stands.other)
    if found is not None:
        assert not found.effects
        assert found.stand is stands.other.stand
        assert search._reread(both) is None  # once


def test_climb_has_the_exact_posterior_and_evidence():
    held = study([1.0, 2.0, 0.0, 0.0, 0.0], 1)
    found = climb(held, np.zeros(5), (0, 1), noise={"y": NOISE}, settings=EXACT)
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


def test_the_missing_effect_is_chosen_and_its_twin_reported():
    found = selected([1.0, 2.0, 0.6, 0.0, 0.0], 2)
    assert len(found.effects) == 1
    assert set(found.equivalent[0]) == {"sine", "twin"}
    assert found.rounds[0].scores[2].candidate.id == "square"


def test_two_missing_effects_are_both_found():
    found = selected([1.0, 2.0, 0.0, 0.5, 0.7], 3)
    assert set(found.effects) in ({"square", "sine"}, {"square", "twin"})


def test_when_the_time_is_up_what_was_found_by_then_is_kept():
    """Two effects are missing; whenever the clock stops the search, it says where, and never has more than they."""
    ended, counts = {}, {}
    for limit in (*range(1, 24), 1000):
        stands, asked = OneStand([1.0, 2.0, 0.0, 0.5, 0.7], 3), iter(range(limit))
        late = lambda asked=asked: next(asked, None) is None  # noqa: E731
        search = Search(stands, [tuple(CANDIDATES)], {}, AttributeSettings(), ClimbSettings(), late)
        base = stands.stand.fit({}, (), {"y": NOISE}, ClimbSettings())
        found = search.select(base, tuple(CANDIDATES), lambda held: False, lambda what, share: None)
        ended[limit], counts[limit] = found.ended, len(found.effects)
        assert len(found.rounds) <= 3
    assert ended[1000] == ""
    assert counts[1000] == 2
    assert ended[1] == "round 1"
    assert counts[1] == 0
    assert {"round 1", "drop and swap"} <= set(ended.values())
    assert any(where.startswith("round 2 beside ") for where in ended.values())
    assert set(counts.values()) == {0, 1, 2}


def test_two_take_the_place_of_one_that_does_a_little_of_both():
    """The third is the sum of both and of something else, and nothing can be less than zero."""
    basis = BASIS.copy()
    basis[4] = BASIS[2] + BASIS[3] + 0.5 * np.cos(2.3 * TIME)
    for seed in range(4):
        found = selected([1.0, 2.0, 0.45, 0.45, 0.0], 200 + seed, structured=True, basis=basis, low=0.0)
        assert found.rounds[0].chosen.candidate.id == "twin"
        assert set(found.effects) == {"sine", "square"}
        alone = selected([1.0, 2.0, 0.45, 0.45, 0.0], 200 + seed, structured=False, basis=basis, low=0.0)
        assert alone.effects == ("twin",)


def test_a_pair_that_does_little_alone_is_foretold_in_closed_form():
    """Each of two is mostly what the other takes away; what is missing is what both have in common."""
    basis = BASIS.copy()
    missing, strange = np.cos(2.3 * TIME), np.sin(TIME)
    basis[2], basis[3], basis[4] = strange + 0.1 * missing, -strange + 0.1 * missing, np.sign(np.sin(1.7 * TIME))
    stand = OneStand([1.0, 2.0, 2.0, 2.0, 0.0], 5, basis=basis, low=0.0).stand
    base = stand.fit({}, (), {"y": NOISE}, ClimbSettings(hold_noise=True))
    alone = score(prospect(base, stand.candidates["sine"], AttributeSettings(), EXACT), EXACT)
    (best, *_) = likely_pairs([(base.around, list(stand.candidates.values()))], 5)
    assert set(best.ids) == {"sine", "square"}
    point = best.start(stand, base.around)
    both = climb(stand.study, point, stand.free(best.ids), noise={"y": NOISE}, settings=EXACT)
    gain = both.log_likelihood - base.optimum.log_likelihood
    assert gain > 10.0 * max(alone.gain, 1.0)
    assert best.promise == pytest.approx(gain, rel=0.02)
    np.testing.assert_allclose(point, both.coordinates, atol=0.3)


def test_nothing_is_found_where_nothing_is_missing():
    for seed in range(8):
        assert not selected([1.0, 2.0, 0.0, 0.0, 0.0], 100 + seed).effects


def test_what_is_required_comes_first_and_stays_whatever_it_gains():
    found = selected([1.0, 2.0, 0.0, 0.0, 0.0], 100, require=("square",))
    assert found.effects == ("square",)
    assert found.held.log_evidence - found.base.log_evidence < threshold(len(CANDIDATES), AttributeSettings())
    assert "square is required" in found.rounds[0].why


def test_beside_what_is_required_the_missing_effect_is_still_found():
    found = selected([1.0, 2.0, 0.6, 0.0, 0.0], 2, require=("square",))
    assert found.rounds[0].chosen.candidate.id == "square"
    assert set(found.effects) in ({"square", "sine"}, {"square", "twin"})


def test_pairs_are_tried_only_where_structure_is_left():
    quiet = selected([1.0, 2.0, 0.0, 0.0, 0.0], 100, structured=True)
    assert not quiet.effects
    assert "together" not in quiet.rounds[-1].why


def test_odds_add_up_and_an_effect_that_is_plainly_there_has_most_of_them_with_its_twin():
    found = selected([1.0, 2.0, 0.6, 0.0, 0.0], 2).rounds[0]
    odds = {s.candidate.id: s.odds for s in found.scores}
    assert sum(odds.values()) + found.nothing + found.untried == pytest.approx(1.0)
    assert odds["sine"] + odds["twin"] > 0.9
    assert with_odds([])[1:] == (pytest.approx(0.98), pytest.approx(0.02))


def test_threshold_pays_for_every_candidate():
    settings = AttributeSettings(margin=4.0)
    assert threshold(18, settings) == pytest.approx(4.0 + np.log(18.0))
    assert threshold(1, settings) == 4.0


def test_a_finer_law_is_found_where_what_it_refines_shows_nothing():
    truth, finer = [1.0, 2.0, 0.0, 0.7, 0.0], {"square": "sine"}
    assert selected(truth, 5, structured=True, finer=finer).effects == ("square",)
    assert not selected(truth, 5, structured=False, finer=finer).effects
    assert set(selected([1.0, 2.0, 0.6, 0.0, 0.0], 2, structured=True, finer=finer).effects) & {"sine", "twin"}


def clipped(time, p):
    """The third parameter acts only beyond one: then it clips the line that the second one makes."""
    return np.minimum(p[0] + p[1] * time / 30.0, 1.0 / np.maximum(p[2], 1e-12))[:, None]


def formula_stand(formula, measured, candidate):
    """A stand with one candidate, on a model that is a formula of five parameters."""
    problem = closed_form.calibration([(TIME, measured[:, None])], ["y"], [parameter(name) for name in "abcde"])
    simulator = closed_form.FormulaSimulator(problem.problem(), formula)
    return Stand(Objective(problem, simulator), {candidate.id: candidate}, (0, 1), open_simulator)


def test_the_limit_of_what_is_clipped_at_its_very_end_is_closed_in_on():
    rng = np.random.default_rng(8)
    limit, noise = 2.85, OutputNoise(0.02, 0.0, 1.0)
    measured = np.minimum(1.0 + 2.0 * TIME / 30.0, limit) + noise.sd_white * rng.normal(size=600)
    starts = tuple((share / 2.4,) for share in (1.0, 0.1, 0.3, 0.6, 0.75, 0.9, 1.2, 2.5))
    stand = formula_stand(clipped, measured, Candidate("clip", "in", starts, (2,)))
    base = stand.fit({"a": 1.0, "b": 2.0}, (), {"y": noise}, ClimbSettings())
    found = score(prospect(base, stand.candidates["clip"], AttributeSettings(), ClimbSettings()), ClimbSettings())
    assert found.gain > 20.0
    assert 1.0 / found.held.values["c"] == pytest.approx(limit, abs=0.02)


LEVELS = np.where(np.arange(600) < 60, 3.0, np.where(np.random.default_rng(1).random(600) < 0.5, 1.2, 4.8))


def limited(time, p):
    """A power law, its factor and exponent the first two parameters, of an input that the third limits."""
    return (np.exp(p[0]) * np.minimum(LEVELS, 1.0 / np.maximum(p[2], 1e-12)) ** p[1])[:, None]


def test_a_limit_is_found_though_the_other_parameters_readjust_to_it_along_no_line():
    limit, noise = 3.5, OutputNoise(0.01, 0.0, 1.0)
    exact = limited(TIME, np.array([0.3, 0.7, 1.0 / limit]))[:, 0]
    measured = exact + noise.sd_white * np.random.default_rng(8).normal(size=600)
    starts = tuple((share / 3.8,) for share in (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0))
    stand = formula_stand(limited, measured, Candidate("limit", "in", starts, (2,)))
    base = stand.fit({"a": 0.3, "b": 0.7}, (), {"y": noise}, ClimbSettings())
    found = score(prospect(base, stand.candidates["limit"], AttributeSettings(), ClimbSettings()), ClimbSettings())
    assert found.gain > 100.0
    assert 1.0 / found.held.values["c"] == pytest.approx(limit, abs=0.02)


def test_an_aim_within_reach_changes_nothing():
    stand = OneStand([1.0, 2.0, 0.6, 0.0, 0.0], 2).stand
    base = stand.fit({}, (), {"y": NOISE}, ClimbSettings())
    found = prospect(base, stand.candidates["sine"], AttributeSettings(), ClimbSettings())
    free = score(found, ClimbSettings())
    again = score(found, ClimbSettings(), base.log_evidence + free.gain + 10.0)
    assert again.gain == free.gain


def test_a_second_climb_into_the_same_valley_is_given_up_at_once():
    held = study([1.0, 2.0, 0.6, 0.0, 0.0], 2)
    first = climb(held, np.zeros(5), (0, 1, 2), noise={"y": NOISE})
    far = held.parameters.to_search(np.array([5.0, -3.0, 4.0, 0.0, 0.0]))
    before = held.simulations
    again = climb(held, far, (0, 1, 2), noise={"y": NOISE}, known=[first])
    assert again.reason is Stop.MET
    assert held.simulations - before == 1


def test_a_climb_into_another_valley_goes_on_whatever_is_known():
    noise = OutputNoise(0.1)
    measured = damped(TIME, np.array([1.0, 3.7, 0.0]))[:, 0] + 0.1 * np.random.default_rng(4).normal(size=600)
    held = formula_stand(damped, measured, Candidate("damping", "in", ((0.7,), (0.5,)), (2,))).study
    right, wrong = (held.parameters.to_search(np.array([0.8, w, 0.0, 0.0, 0.0])) for w in (3.72, 4.15))
    best = climb(held, right, (0, 1), noise={"y": noise})
    alone, beside = (climb(held, wrong, (0, 1), noise={"y": noise}, known=known) for known in ([], [best]))
    assert alone.log_likelihood < best.log_likelihood - 100.0
    assert beside.reason is not Stop.MET
    np.testing.assert_array_equal(beside.coordinates, alone.coordinates)


def test_a_law_that_promises_next_to_nothing_of_what_it_has_to_gain_is_not_climbed():
    stand = OneStand([1.0, 2.0, 0.6, 0.0, 0.0], 2).stand
    base = stand.fit({}, (), {"y": NOISE}, ClimbSettings())
    found = prospect(base, stand.candidates["sine"], AttributeSettings(), ClimbSettings())
    before = stand.study.simulations
    forlorn = score(found, ClimbSettings(), base.log_evidence + 300.0 * found.promise)
    assert forlorn.held is None
    assert stand.study.simulations == before


def test_ends_of_lines_that_lead_nowhere_are_not_simulated():
    stand = OneStand([1.0, 2.0, 0.6, 0.0, 0.0], 6).stand
    base = stand.fit({}, ("sine",), {"y": NOISE}, ClimbSettings())
    start = stand.study.simulations
    nothing = prospect(base, stand.candidates["square"], AttributeSettings(), ClimbSettings())
    spent = stand.study.simulations - start
    assert not nothing.starts
    assert spent == len(stand.candidates["square"].starts) + 1  # and a small dose


def damped(time, p):
    """A wave, its height and frequency the first two parameters; the third damps it."""
    return (p[0] * np.exp(-(p[2] ** 2) * time) * np.sin(p[1] * time))[:, None]


def test_what_only_led_the_fit_out_of_a_wrong_valley_is_no_effect():
    noise = OutputNoise(0.1)
    exact = damped(TIME, np.array([1.0, 3.7, 0.0]))[:, 0]
    measured = exact + noise.sd_white * np.random.default_rng(4).normal(size=600)
    stand = formula_stand(damped, measured, Candidate("damping", "in", ((0.7,), (0.5,)), (2,)))

    class Stands:
        undecided = ()

        def of(self, ids):
            return stand

        def read_otherwise(self):
            return None

        def finer(self, held):
            return None

    base = stand.fit({"a": 1.0, "b": 3.0}, (), {"y": noise}, ClimbSettings())
    assert abs(base.values["b"] - 3.7) > 0.1
    search = Search(Stands(), [("damping",)], {}, AttributeSettings(), ClimbSettings())
    found = search.select(base, ("damping",), lambda held: True, lambda what, share: None)
    assert not found.effects
    assert found.base.values["b"] == pytest.approx(3.7, abs=0.01)


def test_what_is_required_begins_where_it_is_off_if_it_can_begin_nowhere_else():
    def breaks(time, p):
        """A line and a wave, which breaks as soon as it is seen."""
        wave = p[2] * np.sin(time) if np.real(p[2]) < 0.5 else np.nan * time
        return (p[0] + p[1] * time / 30.0 + wave)[:, None]

    rng = np.random.default_rng(11)
    noise = OutputNoise(0.02, 0.0, 1.0)
    measured = 1.0 + 2.0 * TIME / 30.0 + 0.1 * np.sin(TIME) + noise.sd_white * rng.normal(size=TIME.size)
    stand = formula_stand(breaks, measured, Candidate("wave", "in", ((1.0,), (2.0,)), (2,)))

    class Stands:
        undecided = ()

        def of(self, ids):
            return stand

        def read_otherwise(self):
            return None

        def finer(self, held):
            return None

    base = stand.fit({"a": 1.0, "b": 2.0}, (), {"y": noise}, ClimbSettings())
    settings = AttributeSettings(require=("wave",), max_effects=1)
    found = Search(Stands(), [("wave",)], {}, settings, ClimbSettings()).select(
        base, ("wave",), lambda held: True, lambda what, share: None
    )
    assert found.effects == ("wave",)
    assert found.held.values["c"] == pytest.approx(0.1, abs=0.02)
