"""The choice of a structure on models with closed forms: what is material, what is small, what the data do not tell."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import closed_form
import numpy as np
import pytest

from aero_bayes.estimate import LocalFitSettings, LocalSettings, Normal, Objective, Parameter
from aero_bayes.judge import Choice, ChoiceSettings, Chooser, Judge
from aero_bayes.judge.choose import one_of_each, worth_all_readings
from aero_bayes.laws import CandidateTerm
from aero_bayes.search import (
    CandidateModel,
    Comparison,
    FitNoise,
    Library,
    Parts,
    Structure,
    StructureSearch,
    StructureSettings,
)
from aero_bayes.sensors import OutputNoise
from aero_bayes.simulation import DelayTarget, ParameterTarget, open_simulator

pytestmark = pytest.mark.fast

TIME = np.arange(600) * 0.05
NOISE = 0.3
FIT = LocalFitSettings(LocalSettings(iterations=40, tolerance=1e-9), hold_noise=True)
#: What each parameter adds: two of the first model; three laws, of which the last two are alike; a curve of three.
SINE, BEND = np.sin(TIME), np.sin(TIME) ** 2
BASIS = np.stack(
    [np.ones(600), TIME / 30.0, SINE, np.sign(np.sin(1.7 * TIME)), np.sign(np.sin(1.7 * TIME)) + 1e-9 * SINE,
     SINE, BEND, SINE * BEND]
)  # fmt: skip
TERMS = {
    "line@u": CandidateTerm("line@u", "u", ((1.0,), (-1.0,)), (2,)),
    "square@v": CandidateTerm("square@v", "v", ((1.0,), (-1.0,)), (3,)),
    "twin@w": CandidateTerm("twin@w", "w", ((1.0,), (-1.0,)), (4,)),
    "curve@u": CandidateTerm("curve@u", "u", (), (5, 6, 7)),
}


class OneModel:
    """A cache of one model that has all its candidates at hand."""

    free_later = ()
    interpolation_is_free = False

    def __init__(self, objective):
        self.model = CandidateModel(objective, TERMS, (0, 1), open_simulator)
        self.ports = {id_: c.port for id_, c in TERMS.items()}

    def of(self, structure, extra=()):
        return self.model


def chosen(missing, seed: int, settings: ChoiceSettings | None = None, samples: int = 600, targets=None) -> Choice:
    """The choice where a signal (n,) is missing from the first model; some parameters may have other targets."""
    rng, time, targets = np.random.default_rng(seed), TIME[:samples], targets or {}
    y = BASIS[:2].T @ [1.0, 2.0] + missing + NOISE * rng.normal(size=600)
    parameters = [
        Parameter(n, "1", 0.0, -50.0, 50.0, Normal(0.0, 3.0), "linear", "", targets.get(n, ParameterTarget(n)))
        for n in "abcdefgh"
    ]
    problem = closed_form.calibration([(time, y[:samples, None])], ["y"], parameters)
    simulator = closed_form.FormulaSimulator(problem.problem(), lambda t, p: (p @ BASIS[:, :samples])[:, None])
    cache = OneModel(Objective(problem, simulator))
    searching = StructureSearch(
        cache, Library([tuple(TERMS)], {}, tuple(t for t in TERMS if t.startswith("curve"))), StructureSettings(), FIT,
        {("run 0", "y"): NOISE}, Parts(restarts=()),
    )  # fmt: skip
    root = cache.model.fit(Structure(), cache.model.coordinates_of({}, ()), FitNoise({"y": OutputNoise(NOISE)}), FIT)
    return Chooser(settings or ChoiceSettings(), FIT, searching.complete, searching.alone).choose(searching.run(root))


def test_a_law_is_named_where_it_does_as_well_as_the_curve_at_its_port():
    choice = one_missing()
    assert choice.terms == ("line@u",)
    assert choice.alike("line@u") == ("line@u",)
    assert choice.share("line@u").value < 0.4
    assert choice.share("line@u").output == "y"
    assert choice.wins > 0.9


def test_the_place_with_its_curve_is_the_answer_where_no_law_does_as_well():
    choice = chosen(2.0 * BASIS[2] + 1.5 * BASIS[6], 2)
    assert choice.terms == ("curve@u",)
    assert choice.looks_like("curve@u") == "line@u"


def test_an_approximation_error_does_not_tell_two_delays_apart(monkeypatch):
    """The second delay is off by a little, which the data show clearly and which is not material."""
    basis, terms = BASIS.copy(), {"delay@v": TERMS["square@v"], "delay@w": TERMS["twin@w"]}
    basis[4] += 0.06 * np.sin(2.3 * TIME)
    monkeypatch.setattr(f"{__name__}.BASIS", basis)
    monkeypatch.setattr(f"{__name__}.TERMS", {f: replace(t, id=f) for f, t in terms.items()})
    moving = chosen(4.0 * basis[3], 1, targets={"d": DelayTarget("v")})
    (other,) = (s for s in moving.comparison.squares if s.terms == ("delay@w",))
    assert moving.terms == ("delay@v",)
    assert moving.comparison.clearly_better(moving.structure, other)
    assert moving.alike("delay@v") == ("delay@v", "delay@w")


def test_two_missing_laws_are_named_each_for_its_class():
    choice = chosen(1.5 * BASIS[2] + 1.0 * BASIS[3], 3)
    assert set(choice.terms) in ({"line@u", "square@v"}, {"line@u", "twin@w"})
    (pulse,) = set(choice.terms) - {"line@u"}
    assert set(choice.alike(pulse)) == {"square@v", "twin@w"}


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_named_where_nothing_is_missing(seed):
    choice = chosen(0.0 * TIME, 10 + seed)
    assert choice.terms == ()
    assert choice.smaller == ()


def test_a_term_that_lowers_the_error_by_under_a_quarter_is_smaller():
    """Beside a slow wave that nothing explains, a square of half its size helps and is no cause."""
    left = 3.0 * np.sin(0.61 * TIME)
    choice = chosen(left + 1.65 * BASIS[3], 4)
    assert choice.terms == ()
    assert set(choice.smaller) & {"square@v", "twin@w"}
    small = choice.smaller[0]
    assert 0.75 < choice.share_of_smaller(small).value < 1.0
    assert choice.wins_of_smaller(small) > 0.95
    # What counts as a cause is a setting.
    assert chosen(left + 1.65 * BASIS[3], 4, ChoiceSettings(min_share=0.99)).terms


def test_a_small_term_is_named_where_only_with_it_noise_is_left():
    choice = chosen(0.2 * BASIS[2], 5)
    assert choice.terms == ("line@u",)
    assert choice.share("line@u").value > 0.75


def test_few_readings_name_nothing_that_is_not_clear():
    choice = chosen(0.5 * BASIS[2], 6, samples=15)
    assert choice.terms == ()


def test_of_two_laws_at_different_places_that_do_as_well_none_is_named():
    choice = chosen(1.5 * BASIS[3], 7)
    assert choice.told().terms == ()
    assert set(choice.told().undecided) == {"square@v", "twin@w"}
    both = chosen(1.5 * BASIS[2] + 1.0 * BASIS[3], 3).told()
    assert both.terms == ("line@u",)
    assert set(both.undecided) == {"square@v", "twin@w"}
    clear = one_missing()
    assert clear.told() is clear


def test_a_law_that_the_best_beats_by_less_than_a_quarter_is_close_to_it():
    size = np.random.default_rng(8).uniform(0.9, 1.1, (20, 1))
    errors = {(): 1.0, ("best@u",): 0.09, ("near@v",): 0.11, ("far@w",): 0.13, ("small@w",): 0.9}
    comparison = Comparison({Structure(terms): e**2 * size for terms, e in errors.items()}, ("y",), np.zeros(1))
    best, near = Structure(("best@u",)), Structure(("near@v",))
    assert comparison.clearly_better(best, near)
    explored = one_missing().explored
    assert Judge(explored, comparison, ChoiceSettings()).close_to(best) == [near]


@pytest.mark.parametrize(("fine", "taken"), [(0.198, "coarse@u"), (0.12, "fine@u")])
def test_a_refinement_replaces_a_law_only_where_it_gains_a_quarter(fine, taken):
    size = np.random.default_rng(8).uniform(0.9, 1.1, (20, 1))
    errors = {(): 1.0, ("coarse@u",): 0.2, ("fine@u",): fine}
    comparison = Comparison({Structure(terms): e**2 * size for terms, e in errors.items()}, ("y",), np.zeros(1))
    explored = replace(chosen(1.5 * BASIS[2], 1).explored, refines={"fine@u": "coarse@u"})
    explored = replace(explored, fits={s: explored.first_model for s in comparison.squares}, noise=explored.noise)
    assert comparison.clearly_better(Structure(("fine@u",)), Structure(("coarse@u",)))
    assert Judge(explored, comparison, ChoiceSettings()).near()[0].terms == (taken,)


def test_where_unseen_readings_refuse_a_pair_its_parts_are_offered_first():
    pair = chosen(1.5 * BASIS[2] + 1.0 * BASIS[3], 3)
    assert len(pair.terms) == 2
    part = pair.refuse()
    assert part.terms == ("line@u",)
    assert part.refused == (pair.structure,)
    assert part.comparison is pair.comparison


def test_nothing_is_left_where_unseen_readings_refuse_all():
    choice, offered = one_missing(), []
    while choice is not None:
        offered.append(choice.structure)
        choice = choice.refuse()
    assert offered[0].terms == ("line@u",)
    assert len(set(offered)) == len(offered)
    assert not any(s.contains(offered[0]) for s in offered[1:])


def test_a_law_that_acts_twice_is_not_told_by_a_shared_place(monkeypatch):
    laws = {"lag@u": TERMS["line@u"], "lag@v": TERMS["square@v"], "other@w": TERMS["twin@w"]}
    monkeypatch.setattr(f"{__name__}.TERMS", {f: replace(t, id=f) for f, t in laws.items()})
    told = chosen(1.5 * BASIS[2] + 1.0 * BASIS[3], 3).told()
    assert told.terms == ("lag@u",)
    assert set(told.undecided) == {"lag@v", "other@w"}


def test_a_curve_beside_a_law_tells_no_further_place():
    size = np.random.default_rng(8).uniform(0.9, 1.1, (20, 1))
    errors = {(): 1.0, ("dry@u",): 0.5, ("curve@v",): 0.6, ("curve@v", "dry@u"): 0.2}
    comparison = Comparison({Structure(terms): e**2 * size for terms, e in errors.items()}, ("y",), np.zeros(1))
    choice = one_missing()
    fits = {s: replace(choice.explored.first_model, structure=s) for s in comparison.squares}
    both = Structure(("dry@u", "curve@v"))
    explored = replace(choice.explored, fits=fits, curves=("curve@v",))
    told = replace(choice, fitted=fits[both], near=(both,), comparison=comparison, explored=explored).told()
    assert told.terms == ("dry@u",)
    assert told.undecided == ("curve@v",)


def test_finalists_have_other_laws_before_the_same_laws_elsewhere():
    laws = [Structure(t) for t in (("gain@a", "lag@b"), ("gain@b", "lag@a"), ("curve@a",), ("curve@b",), ("gain@b",))]
    assert one_of_each(laws, ("curve@a", "curve@b")) == [laws[0], *laws[2:]]


def test_a_law_at_another_place_that_does_as_well_on_a_part_is_fitted_to_all_readings(monkeypatch):
    """On the part it is too small to be material, so that nothing is chosen there."""
    laws = {"line@u": TERMS["line@u"], "gain@v": TERMS["square@v"], "gain@w": TERMS["twin@w"]}
    monkeypatch.setattr(f"{__name__}.TERMS", {f: replace(t, id=f) for f, t in laws.items()})
    choice = chosen(0.06 * BASIS[3], 6)
    assert choice.terms == ()
    worth = worth_all_readings(choice.explored, ChoiceSettings())
    assert {Structure(("gain@v",)), Structure(("gain@w",))} <= set(worth)


@pytest.mark.parametrize(("refines", "told"), [({"by_side@u": "dry@u", "soft@u": "dry@u"}, ("soft@u",)), ({}, ())])
def test_refinements_of_one_law_claim_it_beside_other_missing_terms(refines, told):
    size = np.random.default_rng(8).uniform(0.9, 1.1, (20, 1))
    errors = {(): 1.0, ("soft@u",): 0.4, ("by_side@u",): 0.5, ("soft@u", "a@v"): 0.2, ("by_side@u", "b@w"): 0.202}
    comparison = Comparison({Structure(terms): e**2 * size for terms, e in errors.items()}, ("y",), np.zeros(1))
    choice = one_missing()
    fits = {s: replace(choice.explored.first_model, structure=s) for s in comparison.squares}
    (first, other) = (Structure(("soft@u", "a@v")), Structure(("by_side@u", "b@w")))
    explored = replace(choice.explored, fits=fits, refines=refines)
    choice = replace(choice, fitted=fits[first], near=(first, other), comparison=comparison, explored=explored)
    found = choice.told()
    assert found.terms == told
    assert set(found.undecided) == {"a@v", "b@w"} if told else {"soft@u", "by_side@u"} <= set(found.undecided)


@cache
def one_missing() -> Choice:
    """The choice where one law is missing, found once for what only needs a search that ended."""
    return chosen(1.5 * BASIS[2], 1)


def judged(errors: dict[tuple[str, ...], float], curves: tuple[str, ...], structured: tuple[str, ...]) -> Judge:
    """A judge of structures whose errors on left-out readings are given, where some outputs keep structure."""
    size = np.random.default_rng(8).uniform(0.9, 1.1, (20, 1))
    comparison = Comparison({Structure(terms): e**2 * size for terms, e in errors.items()}, ("y",), np.zeros(1))
    explored = one_missing().explored
    fits = {s: replace(explored.best, structure=s) for s in comparison.squares}
    noise = replace(explored.noise, structured=structured)
    ports = {t: t.rpartition("@")[2] for s in fits for t in s.terms}
    explored = replace(explored, fits=fits, curves=curves, noise=noise, ports=ports)
    return Judge(explored, comparison, ChoiceSettings())


@pytest.mark.parametrize(("error", "structured", "named"), [
    (0.22, ("y",), True), (0.22, (), False), (0.35, ("y",), False),
])  # fmt: skip
def test_as_long_as_structure_is_left_a_law_is_named_in_place_of_a_curve(error, structured, named):
    """A curve that is clearly better, by less than a quarter, takes up what else is missing."""
    errors = {(): 1.0, ("dry@v",): 0.6, ("curve@u",): 0.6, ("line@u",): 0.7}
    curve, law = ("curve@u", "dry@v"), ("dry@v", "line@u")
    near = judged({**errors, curve: 0.2, law: error}, ("curve@u",), structured).near()
    assert near[0] == Structure(law if named else curve)
    assert (Structure(law) in near) == named


@pytest.mark.parametrize(("more", "left", "named"), [(1, False, True), (0, False, False), (1, True, False)])
def test_what_does_as_well_by_more_parameters_is_listed_beside_a_name(more, left, named):
    """By chance the one with more parameters may lead a little, which is no reason to say nothing.

    Where structure is left, a further missing effect may turn a small difference.
    """
    one, other = Structure(("gain@u",)), Structure(("pair@v",))
    judge = judged({(): 1.0, one.terms: 0.3, other.terms: 0.3}, (), ())
    squares = dict(judge.comparison.squares)
    squares[other] = squares[other] * np.tile([[0.95], [1.045]], (10, 1))
    comparison = replace(judge.comparison, squares=squares)
    assert comparison.scores[other] < comparison.scores[one]
    fits = dict(judge.explored.fits)
    free = fits[other].optimum.free
    fits[other] = replace(fits[other], optimum=replace(fits[other].optimum, free=(*free, 3)[: len(free) + more]))
    choice = replace(
        one_missing(), fitted=fits[one], near=(one, other), comparison=comparison,
        explored=replace(judge.explored, fits=fits), after=one_missing().before if left else one_missing().after,
    )  # fmt: skip
    assert choice.told().terms == (one.terms if named else ())
    assert choice.alike("gain@u") == ("gain@u", "pair@v")


@pytest.mark.parametrize(("error", "told"), [(0.61, ("dead@u",)), (0.80, ())])
def test_a_law_tells_no_name_by_another_at_its_place_that_is_not_material(error, told):
    """The dead zone is told beside an offset elsewhere only where an offset at its own place could be named, too."""
    laws = ("dead@u",), ("offset@u",), ("offset@v",)
    judge = judged({(): 1.0, laws[0]: 0.60, laws[1]: error, laws[2]: 0.62}, (), ())
    near, fits = tuple(Structure(law) for law in laws), judge.explored.fits
    choice = replace(
        one_missing(), fitted=fits[near[0]], near=near, comparison=judge.comparison, explored=judge.explored
    )
    assert choice.told().terms == told


def test_a_law_that_all_share_is_told_though_alone_it_lowers_the_error_little():
    pairs = ("curve@v", "over@u"), ("curve@w", "over@u")
    errors = {(): 1.0, ("over@u",): 0.9, ("curve@v",): 0.88, ("curve@w",): 0.88, pairs[0]: 0.4, pairs[1]: 0.41}
    judge = judged(errors, ("curve@v", "curve@w"), ("y",))
    near = tuple(Structure(p) for p in pairs)
    choice = replace(
        one_missing(), fitted=judge.explored.fits[near[0]], near=near, comparison=judge.comparison,
        explored=judge.explored,
    )  # fmt: skip
    told = choice.told()
    assert told.terms == ("over@u",)
    assert set(told.undecided) == {"curve@v", "curve@w"}
