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

#: The model, the claim of each of its terms, what may be told besides by name, and the error on unseen recordings that
#: the model has at most. What is right comes from the literature of each rig (../shared/rigs).
RIGHT = {
    "aero_pitch_pulse_500hz": (
        {"body_angle_curve@body": "place", "pivot_presliding_friction": "law"}, {"theta": 0.0041},
    ),
    "aero_step_16v5_1khz": ({"body_rate_curve@body": "one of"}, {"theta": 0.0016}),
    "battery": ({"polarisation_of_two_pairs@v": "law"}, {"v": 0.007}),
    "cartpendulum": ({}, {}),
    "coastdown": ({"coulomb_friction@v": "one of"}, {"speed": 0.7}),
    "coil": ({"curve@i": "one of"}, {"i": 0.009}),
    "damper": ({"curve@output_F": "place", "rounded_friction@F": "law"}, {"F": 10.0}),
    "drives": ({"delay@y": "one of", "unsigned@y": "law"}, {"y": 0.69}),
    "drives2": ({"coulomb_friction@m": "one of", "lag@y": "one of", "unsigned@y": "law"}, {"y": 0.52}),
    "emps": ({"curve@v": "place"}, {"q": 0.0051}),
    "motor": ({"curve@omega": "place", "offset@w": "place", "square_law@tau": "place"}, {"w": 16.5}),
    "paramecium": ({"offset@N": "one of"}, {}),
    "servo": ({"curve@command": "one of", "rate_limit@command": "one of"}, {"angle": 0.13}),
    "silverbox": ({"cubic_stiffness@v": "law"}, {"y": 0.00092}),
    "tank2006": ({"curve@u": "place"}, {"y1": 0.2, "y2": 0.152}),
    "tanks": ({"curve@y": "one of", "overflow@h1": "law"}, {"y": 0.4}),
    "tclab": ({"exchange@x1": "law", "lag@Q1": "law", "lag@Q2": "place"}, {"T2": 1.7}),
    "whiffle": ({"viscous_friction@v": "place"}, {"height": 1.0}),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(RIGHT))
def test_the_model_and_the_claims_on_a_real_rig(name):
    table = Table.of(TABLES[name])
    claims, unseen = RIGHT[name]
    found = decide(table)
    assert {term: claim.kind for term, claim in found.claims.items()} == claims
    assert found.model == tuple(sorted(claims))
    for output, most in unseen.items():
        assert table.rows[found.model].unseen[output] <= most


def test_what_is_right_but_not_told_stands_among_the_alternatives():
    coil, step = (decide(Table.of(TABLES[name])) for name in ("coil", "aero_step_16v5_1khz"))
    assert "square_law@u" in dict(coil.claims["curve@i"].alternatives)
    assert "pivot_coulomb_friction" in dict(step.claims["body_rate_curve@body"].alternatives)


def table(errors, unseen=None, **given):
    """A table of one output and ten blocks; errors by terms as RMS."""
    spread = np.linspace(0.9, 1.1, 10)
    rows = {}
    for k, (terms, error) in enumerate(errors.items()):
        key = tuple(sorted(terms.split()))
        jitter = 1.0 + 0.02 * np.cos(np.arange(10) * (k + 1.7))
        seen = {"y": (unseen or {}).get(terms, error)}
        rows[key] = Row(key, (error**2 * spread * jitter)[:, np.newaxis], len(key), True, seen)
    terms = {t for key in rows for t in key}
    ports = {t: t.partition("@")[2] for t in terms}
    curves = {t for t in terms if t.startswith("curve")}
    return Table(("y",), np.array([1e-12]), ports, given.get("refines", {}), curves, rows)


def test_the_smallest_size_that_no_larger_one_materially_beats_is_the_model():
    found = decide(table({"": 1.0, "a@u": 0.5, "b@v": 0.9, "a@u b@v": 0.3}))
    assert found.model == ("a@u", "b@v")
    assert decide(table({"": 1.0, "a@u": 0.5, "b@v": 0.9, "a@u b@v": 0.45})).model == ("a@u",)
    assert decide(table({"": 1.0, "a@u": 0.8, "b@v": 0.9})).model == ()


def test_a_term_is_no_law_where_another_one_does_as_well():
    assert decide(table({"": 1.0, "a@u": 0.5, "b@v": 0.9})).claims["a@u"].kind == "law"
    assert decide(table({"": 1.0, "a@u": 0.5, "b@u": 0.6})).claims["a@u"].kind == "place"
    found = decide(table({"": 1.0, "a@u": 0.5, "b@u": 0.6, "c@v": 0.65})).claims["a@u"]
    assert found.kind == "one of"
    assert dict(found.alternatives) == {"b@u": pytest.approx(1.2, abs=0.01), "c@v": pytest.approx(1.3, abs=0.01)}


def test_a_finer_law_and_a_curve_at_its_port_say_the_same():
    finer = table({"": 1.0, "a@u": 0.5, "fine@u": 0.499, "curve@u": 0.495}, refines={"fine@u": "a@u"})
    found = decide(finer)
    assert found.model == ("a@u",)
    assert found.claims["a@u"].kind == "law"


def test_a_law_that_helps_beside_a_curve_only_is_no_law():
    errors = {"": 1.0, "curve@v": 0.5, "curve@v b@u": 0.2}
    assert decide(table({**errors, "b@u": 1.05})).claims["b@u"].kind == "place"
    assert decide(table({**errors, "b@u": 0.6})).claims["b@u"].kind == "law"
    assert decide(table({**errors, "b@u": 0.6})).claims["curve@v"].kind == "place"


def test_unseen_recordings_refuse_and_do_not_choose():
    errors = {"": 1.0, "a@u": 0.40, "b@v": 0.41, "c@w": 0.6}
    better = decide(table(errors, {"": 1.0, "a@u": 0.9, "b@v": 0.2, "c@w": 0.2}))
    assert (better.model, better.refused) == (("a@u",), ())
    refused = decide(table(errors, {"": 1.0, "a@u": 1.3, "b@v": 0.9, "c@w": 0.2}))
    assert (refused.model, refused.refused) == (("b@v",), (("a@u",),))
    none = decide(table(errors, {"": 1.0, "a@u": 1.3, "b@v": 1.3, "c@w": 1.3}))
    assert (none.model, len(none.refused)) == ((), 3)


def test_what_is_required_stays_and_is_not_claimed():
    found = decide(table({"": 1.0, "a@u": 0.98, "b@v": 0.5, "a@u b@v": 0.4}), ["a@u"])
    assert found.model == ("a@u", "b@v")
    assert set(found.claims) == {"b@v"}


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
    assert "curve@i" in told
    assert "one of" in told
