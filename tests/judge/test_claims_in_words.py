"""Claims in words: what is said of an effect agrees with the list of what does as well."""

import re
from types import SimpleNamespace

import pytest
from facts import facts

from aero_bayes.loop.sentences import claimed, cross_validated, lacking

pytestmark = pytest.mark.fast


def effect(claim: str, *others: tuple[str, str, float], **given: object) -> SimpleNamespace:
    alternatives = [SimpleNamespace(id=id_, port=port, error_ratio=ratio) for id_, port, ratio in others]
    return SimpleNamespace(**{
        "id": "lag@T", "port": "T", "kind": "catalogue", "claim": claim, "alternatives": alternatives,
        "summary": "a lag (at T)", "looks_like": "", "tried_all": True, "share": 0.5, "share_sd": 0.1, "share_of": "T",
        **given,
    })  # fmt: skip


def test_nothing_else_does_as_well_only_where_the_list_is_empty() -> None:
    assert "Nothing else" in claimed(effect("law"), "lag@T")
    told = claimed(effect("law", ("lag_of_second_order@T", "T", 1.01)), "lag@T")
    assert "Nothing else" not in told
    assert re.search(facts("lag_of_second_order@T", "more parameters"), told)


def test_a_list_that_has_smaller_errors_is_told_so() -> None:
    law = claimed(effect("law", ("lag_of_second_order@T", "T", 0.93)), "lag@T")
    assert re.search(facts("lag_of_second_order@T", "7 % smaller"), law)
    assert "smaller" not in claimed(effect("law", ("lag_of_second_order@T", "T", 1.03)), "lag@T")
    both = claimed(effect("one of", ("lag@Q", "Q", 0.9), ("gain@Q", "Q", 1.02)), "lag@T")
    assert re.search(facts("10 % smaller", "2 % larger"), both)
    alike = claimed(effect("one of", ("lag@Q", "Q", 0.97), ("gain@Q", "Q", 0.97)), "lag@T")
    assert re.search(facts("3 % smaller"), alike)


def test_a_law_whose_place_is_not_known_is_told_with_its_places() -> None:
    one = effect("mechanism", ("lag@Q", "Q", 1.1))
    assert re.search(facts("lag@Q", "10 %", "T or Q"), claimed(one, "lag@T"))
    assert re.search(facts("a lag", "T or Q"), lacking([one]))


def test_a_law_that_is_known_is_named_beside_one_that_is_not() -> None:
    one, other = effect("law"), effect("one of", ("gain@Q", "Q", 1.02))
    assert re.search(facts("a lag", "one more"), lacking([one, other]))
    assert re.search(facts("two"), lacking([other, other]))


def test_what_does_as_well_is_told_by_name_up_to_five() -> None:
    few = [(f"law{k}@T", "T", 1.05) for k in range(2)]
    many = [(f"law{k}@v", "v", 1.05) for k in range(6)]
    assert re.search(facts("law0@T", "law1@T", "5 %"), claimed(effect("one of", *few), "lag@T"))
    told = claimed(effect("one of", *many), "lag@T")
    assert re.search(facts("do not tell which", "six", "5 %"), told)
    assert "law0@v" not in told


def test_what_was_not_tried_is_said() -> None:
    assert "not all tried" in claimed(effect("place", tried_all=False), "lag@T")
    assert "not all tried" not in claimed(effect("place", ("gain@T", "T", 1.2)), "lag@T")


def test_a_gain_beside_other_effects_says_so() -> None:
    told = cross_validated(effect("law"), "lag@T", ["gain@u"])
    assert re.search(facts("beside gain@u", "50"), told)
    assert "beside" not in cross_validated(effect("law"), "lag@T")
