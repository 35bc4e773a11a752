"""Claims in words: what is said of an effect agrees with the list of what does as well; errors before and after."""

import math
import re
from types import SimpleNamespace

import pytest
from facts import facts

from aero_bayes.estimate.error_sentences import error_change, left_over
from aero_bayes.estimate.residual_tests import RecordingError, Verdict
from aero_bayes.loop.sentences import claimed, cross_validated, lacking

pytestmark = pytest.mark.fast


def effect(claim: str, *others: tuple[str, str, float], **given: object) -> SimpleNamespace:
    alternatives = [SimpleNamespace(id=id_, port=port, error_ratio=ratio) for id_, port, ratio in others]
    return SimpleNamespace(**{
        "id": "lag@T", "port": "T", "kind": "catalogue", "claim": claim, "alternatives": alternatives,
        "summary": "a lag (at T)", "looks_like": "", "tried_all": True, "share": 0.5, "share_sd": 0.1, "share_of": "T",
        **given,
    })  # fmt: skip


FEW = [(f"law{k}@T", "T", 1.05) for k in range(2)]
MANY = [(f"law{k}@v", "v", 1.05) for k in range(6)]
SECOND = "lag_of_second_order@T"
#: A claim, what is said of it, and what is not.
CLAIMED = [
    (effect("law"), ["Nothing else"], []),
    (effect("law", (SECOND, "T", 1.01)), [SECOND, "more parameters"], ["Nothing else"]),
    (effect("law", (SECOND, "T", 0.93)), [SECOND, "7 % smaller"], []),
    (effect("law", (SECOND, "T", 1.03)), [], ["smaller"]),
    (effect("one of", ("lag@Q", "Q", 0.9), ("gain@Q", "Q", 1.02)), ["10 % smaller", "2 % larger"], []),
    (effect("one of", ("lag@Q", "Q", 0.97), ("gain@Q", "Q", 0.97)), ["3 % smaller"], []),
    (effect("mechanism", ("lag@Q", "Q", 1.1)), ["lag@Q", "10 %", "T or Q"], []),
    (effect("one of", *FEW), ["law0@T", "law1@T", "5 %"], []),
    (effect("one of", *MANY), ["do not tell which", "six", "5 %"], ["law0@v"]),
    (effect("place", tried_all=False), ["not all tried"], []),
    (effect("place", ("gain@T", "T", 1.2)), [], ["not all tried"]),
]


@pytest.mark.parametrize(("given", "said", "unsaid"), CLAIMED)
def test_a_claim_agrees_with_the_list_of_what_does_as_well(
    given: SimpleNamespace, said: list[str], unsaid: list[str]
) -> None:
    told = claimed(given, "lag@T")
    assert re.search(facts(*said), told)
    assert not [words for words in unsaid if words in told]


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        ([effect("mechanism", ("lag@Q", "Q", 1.1))], ["a lag", "T or Q"]),
        ([effect("law"), effect("one of", ("gain@Q", "Q", 1.02))], ["a lag", "one more"]),
        ([effect("one of", ("gain@Q", "Q", 1.02))] * 2, ["two"]),
    ],
)
def test_what_a_model_lacks_is_named_where_it_is_known(effects: list[SimpleNamespace], said: list[str]) -> None:
    assert re.search(facts(*said), lacking(effects))


def test_a_gain_beside_other_effects_says_so() -> None:
    told = cross_validated(effect("law"), "lag@T", ["gain@u"])
    assert re.search(facts("beside gain@u", "50"), told)
    assert "beside" not in cross_validated(effect("law"), "lag@T")


def error(recording: str, output: str, before: float, after: float, verdict: Verdict = "noise") -> RecordingError:
    return RecordingError(recording, "test", output, before, after, 0.1, True, after / 0.1, math.nan, verdict)


def test_an_output_that_gets_worse_is_told_beside_the_one_that_gains_most() -> None:
    units = {"speed": "rad/s"}
    one = error_change([error("run", "speed", 1.0, 2.0), error("run", "angle", 1.0, 0.1)], units)
    assert re.search(facts("angle", "1", "0.1"), one)
    assert re.search(facts("speed", "1", "2 rad/s"), one)
    assert "speed" not in error_change([error("run", "speed", 1.0, 1.01), error("run", "angle", 1.0, 0.1)], units)


def test_a_recording_on_which_the_error_grows_is_told_although_it_falls_in_the_mean() -> None:
    one = error_change([error("slow", "speed", 0.8, 0.2), error("fast", "speed", 0.842, 0.854)], {})
    assert re.search(facts("slow", "0.8", "0.2"), one)
    assert re.search(facts("fast", "0.842", "0.854"), one)


def test_what_is_left_is_told_of_each_output_once() -> None:
    (one,) = left_over([error("a", "y", 1.0, 0.4, "too large"), error("b", "y", 1.0, 0.1, "structured"),
                        error("c", "y", 1.0, 0.1)])  # fmt: skip
    assert re.search(facts("4", "recording a", "recording b"), one)
    assert "recording c" not in one
