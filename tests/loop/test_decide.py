"""The decision on tables of real rigs, and its rules one by one on small tables."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.loop.decide import decide
from aero_bayes.loop.table import Row, Table

TABLES = json.loads((Path(__file__).parent / "tables.json").read_text())

#: The model, the claim of each of its terms, and the error on test readings that it has at most. Tables hold what
#: a search found: errors on left-out, validation and test readings of all structures.
DECIDED = {
    "aero_2dof": ({}, {"omega_m": 0.0588, "omega_t": 0.0588, "theta": 0.0282, "psi": 0.207}),
    "aero_pulse": ({"body_angle_curve@body": "place", "pivot_presliding_friction": "law"}, {"theta": 0.00485}),
    "aero_step": ({"pivot_presliding_friction": "law"}, {"i_m": 0.00805, "omega_m": 1.89, "theta": 0.00125}),
    "battery": ({"polarisation_of_two_pairs@v": "law"}, {"v": 0.00551}),
    "cartpendulum": ({}, {"z": 0.00126, "phi": 0.00426}),
    "coastdown": ({"coulomb_friction@v": "one of"}, {"speed": 0.66}),
    "coil": ({"curve@output_i": "place", "delay@u": "one of"}, {"i": 0.0052}),
    "damper": ({"curve@output_F": "one of", "rounded_friction@F": "law"}, {"F": 8.72}),
    "drives": ({}, {"y": 0.552}),
    "drives2": ({"square_law@u": "place", "unsigned@y": "law"}, {"y": 0.324}),
    "emps": ({"linear_stiffness@v": "one of"}, {"q": 0.00595}),
    "franka": ({"presliding_friction@tau": "place"}, {"tau": 0.0929}),
    "hotend": ({"lag_of_second_order@output_T": "one of"}, {"T": 3.72}),
    "motor": ({"hysteresis@tau": "one of"}, {"w": 18.8}),
    "paramecium": ({}, {}),
    "propeller": ({"quadratic_drag@w": "law", "square_law@V": "law"}, {"omega": 56.8}),
    "servo": ({"rate_limit@command": "law"}, {"angle": 0.0537}),
    "servo_steps": ({"offset@angle": "one of", "rate_limit@command": "law"}, {"angle": 0.16}),
    "silverbox": ({"cubic_stiffness@v": "law"}, {"y": 0.00117}),
    "tank2006": ({"curve@u": "place"}, {"y1": 0.189, "y2": 0.133}),
    "tanks": ({"curve@y": "place", "overflow@h1+h2": "law"}, {"y": 0.27}),
    "tclab": ({}, {"T1": 0.738, "T2": 8.76}),
    "well": ({"overflow@x": "one of"}, {"h": 0.109}),
    "whiffle": ({"viscous_friction@v": "place"}, {}),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(DECIDED))
def test_the_model_and_the_claims_on_a_real_rig(name):
    table = Table.of(TABLES[name])
    claims, errors = DECIDED[name]
    found = decide(table)
    assert {term: claim.kind for term, claim in found.claims.items()} == claims
    assert found.model == tuple(sorted(claims))
    for output, most in errors.items():
        assert table.rows[found.model].test[output] <= most


def test_the_error_on_test_readings_falls_over_all_rigs_and_rises_on_none():
    """No rule sees it: the logarithm of its ratio to that of the first model, its mean over outputs and rigs."""
    means = []
    for name, stored in TABLES.items():
        table = Table.of(stored)
        before, after = table.rows[()].test, table.rows[decide(table).model].test
        logs = [np.log(after[o] / before[o]) for o in before]
        assert max(logs, default=0.0) < 0.005, name
        means += [np.mean(logs)] if logs else []
    assert np.mean(means) < -0.8


def table(errors, validation=None, **given):
    """A table of one output and ten blocks of each witness; errors by terms as RMS.

    Validation readings show what left-out readings do, where nothing else is given."""
    spread = np.linspace(0.9, 1.1, 10)
    rows = {}
    for k, (terms, error) in enumerate(errors.items()):
        key = tuple(sorted(terms.split()))
        jitter = spread * (1.0 + 0.02 * np.cos(np.arange(10) * (k + 1.7)))
        confirmed = {**errors, **(validation or {})}[terms]
        squares = [(e**2 * jitter)[:, np.newaxis] for e in (error, confirmed)]
        rows[key] = Row(key, squares[0], len(key), True, None if given.get("alone") else squares[1], {"y": confirmed})
    terms = {t for key in rows for t in key}
    ports = {t: t.partition("@")[2] for t in terms}
    curves = {t for t in terms if t.startswith("curve")}
    return Table(("y",), np.array([1e-12]), ports, given.get("refines", {}), curves, rows)


TWO = {"": 1.0, "a@u": 0.5, "b@v": 0.9}
CURVED = {"": 1.0, "curve@v": 0.5, "curve@v b@u": 0.2}
THREE = {"": 1.0, "a@u": 0.5, "b@v": 0.9, "c@w": 0.9, "a@u b@v": 0.48, "a@u c@w": 0.48, "b@v c@w": 0.8}
#: Errors of structures, those on validation readings where they differ, and the model.
MODELS = {
    "two terms that explain more": ({**TWO, "a@u b@v": 0.3}, {}, "a@u b@v"),
    "two terms that explain little more": ({**TWO, "a@u b@v": 0.45}, {}, "a@u"),
    "nothing material": ({"": 1.0, "a@u": 0.8, "b@v": 0.9}, {}, ""),
    "a law nearly as good as a curve": ({"": 1.0, "curve@u": 0.4, "a@v": 0.47}, {}, "a@v"),
    "a curve far better than a law": ({"": 1.0, "curve@u": 0.4, "a@v": 0.7}, {}, "curve@u"),
    "the other witness is against the best": ({"": 1.0, "a@u": 0.40, "b@v": 0.5}, {"a@u": 1.3}, "b@v"),
    "the other witness is against all": ({"": 1.0, "a@u": 0.40, "b@v": 0.5}, {"a@u": 0.95, "b@v": 0.95}, ""),
    "one witness alone": ({"": 1.0, "a@u": 0.95}, {"a@u": 0.3}, ""),
    "the best by both": ({"": 1.0, "a@u": 0.5, "b@v": 0.55}, {}, "a@u"),
    "the best by both, not by one": ({"": 1.0, "a@u": 0.5, "b@v": 0.55}, {"a@u": 0.7, "b@v": 0.3}, "b@v"),
    "two alone and together": ({"": 1.0, "a@u": 0.5, "b@v": 0.45, "a@u b@v": 0.2}, {}, "a@u b@v"),
    "one within it validates better": (
        {"": 1.0, "a@u": 0.5, "b@v": 0.45, "a@u b@v": 0.2}, {"a@u": 0.3, "b@v": 0.5, "a@u b@v": 0.31}, "a@u",
    ),
    "three terms of which no two explain": ({**THREE, "a@u b@v c@w": 0.2}, {}, "a@u"),
    "three terms of which two explain": ({**THREE, "a@u b@v": 0.3, "a@u b@v c@w": 0.2}, {}, "a@u b@v c@w"),
}  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_the_model_is_chosen_by_size_and_both_witnesses(name):
    errors, validation, model = MODELS[name]
    assert decide(table(errors, validation)).model == tuple(model.split())


#: Errors of structures, those on validation readings where they differ, and the kind of claim of a term.
CLAIMS = {
    "nothing else does as well": (TWO, {}, "a@u", "law"),
    "another law at the place does": ({"": 1.0, "a@u": 0.5, "b@u": 0.6}, {}, "a@u", "place"),
    "the law at another place does": ({"": 1.0, "a@u": 0.5, "a@v": 0.6}, {}, "a@u", "mechanism"),
    "one witness prefers another": ({"": 1.0, "a@u": 0.3, "b@v": 0.8}, {"a@u": 0.6, "b@v": 0.5}, "a@u", "one of"),
    "a law that helps beside a curve only": ({**CURVED, "b@u": 1.05}, {}, "b@u", "place"),
    "a law that helps without the curve": ({**CURVED, "b@u": 0.6}, {}, "b@u", "law"),
    "the curve beside it": ({**CURVED, "b@u": 0.6}, {}, "curve@v", "place"),
}


@pytest.mark.parametrize("name", CLAIMS)
def test_a_claim_says_what_else_does_as_well(name):
    errors, validation, term, kind = CLAIMS[name]
    assert decide(table(errors, validation)).claims[term].kind == kind


def test_what_does_as_well_is_listed_with_its_error():
    found = decide(table({"": 1.0, "a@u": 0.5, "b@u": 0.6, "c@v": 0.65})).claims["a@u"]
    assert found.kind == "one of"
    assert dict(found.alternatives) == {"b@u": pytest.approx(1.2, abs=0.01), "c@v": pytest.approx(1.3, abs=0.01)}


def test_a_finer_law_and_a_curve_at_its_port_say_the_same():
    finer = table({"": 1.0, "a@u": 0.5, "fine@u": 0.499, "curve@u": 0.495}, refines={"fine@u": "a@u"})
    assert (decide(finer).model, decide(finer).claims["a@u"].kind) == (("a@u",), "law")
    better = decide(table({"": 1.0, "a@u": 0.5, "fine@u": 0.3}, refines={"fine@u": "a@u"})).claims["fine@u"]
    assert better.share == pytest.approx(0.3, abs=0.01)  # of the error without the term, not with its coarser form


def test_what_left_out_readings_prefer_and_validation_does_not_is_refused():
    found = decide(table({"": 1.0, "a@u": 0.3, "b@v": 0.5, "c@w": 0.2}, {"a@u": 1.3, "c@w": 1.1}))
    assert found.model == ("b@v",)
    assert found.refused == (("c@w",), ("a@u",))


def test_a_structure_needs_ten_readings_for_each_parameter():
    small = table({"": 1.0, "a@u": 0.5, "a@u b@v": 0.1})
    small.readings = 19
    assert decide(small).model == ("a@u",)
    small.readings = 20
    assert decide(small).model == ("a@u", "b@v")


def test_without_validation_the_left_out_readings_decide_alone():
    assert decide(table({"": 1.0, "a@u": 0.5, "b@v": 0.9}, alone=True)).model == ("a@u",)


def test_what_is_required_stays_and_is_not_claimed():
    found = decide(table({"": 1.0, "a@u": 0.98, "b@v": 0.5, "a@u b@v": 0.4}), ["a@u"])
    assert found.model == ("a@u", "b@v")
    assert set(found.claims) == {"b@v"}


def test_a_term_may_not_make_an_output_worse():
    one, other = table({"": 1.0, "a@u": 0.5}), table({"": 1.0, "a@u": 1.0}, {"a@u": 1.05})

    def beside(k):
        parts = [one.rows[k], other.rows[k]]
        return Row(k, np.hstack([p.errors for p in parts]), 1, True, np.hstack([p.validation for p in parts]))

    both = Table(("y", "z"), np.full(2, 1e-12), one.ports, {}, set(), {k: beside(k) for k in one.rows})
    assert decide(one).model == ("a@u",)
    assert decide(both).model == ()


def test_few_blocks_make_nothing_clear():
    small = table({"": 1.0, "a@u": 0.6})
    rows = {k: Row(k, np.array([[1.0], [0.2]]) if not k else np.array([[0.1], [0.25]]), 1) for k in small.rows}
    small.rows = rows
    assert decide(small).model == ()


def test_a_table_is_written_and_read_and_decided_again_by_a_command(tmp_path):
    whole = Table.of(TABLES["coil"])
    path = tmp_path / "structures.json"
    path.write_text(json.dumps(whole.to_dict()))
    assert decide(Table.of(json.loads(path.read_text()))) == decide(whole)
    command = [sys.executable, "-m", "aero_bayes.loop.decide", str(path)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "curve@output_i" in told
    assert "one of" in told
